"""The vector contract every world keeps: independent lanes, no reset that was not asked for, two separate ends.

A *lane* is one running episode. Its start states depend on its seed and on its own earlier episodes, never on its
place in the batch nor on its neighbors. How an episode ended stays in two arrays: the task's own end (`terminated`) and
an end that the engine imposed (`truncated`). A world knows no horizon: the learner counts it (`ppo/rollout.py`), and so
do the wrappers of `perdure.horizon` for other learners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TaskSpec:
    """What a policy must know about a task before it meets it."""

    name: str
    """The name `make_world` knows the task by."""
    suite: str
    """The suite the task comes from, as `list_tasks` groups it."""
    engine: str
    """Simulator and version, e.g. "EnvPool 1.2.5, MuJoCo 3.6.0": returns are comparable only under the same one."""
    observation_size: int
    """Length of one observation, after flattening."""
    action_low: FloatArray
    """Lowest action per component, shape (action_size,); read-only."""
    action_high: FloatArray
    """Highest action per component, shape (action_size,); read-only."""
    default_horizon: int
    """Steps per episode the suite itself would use. A fact about the suite: no world applies it."""
    discrete_actions: bool = False
    """Each action component is a whole number from its lowest to its highest (Gymnasium's Discrete, MultiDiscrete and
    MultiBinary); otherwise actions are a box."""

    def __post_init__(self) -> None:
        """Takes read-only copies of the bounds, so that no caller can move the box of a running world."""
        for field in ("action_low", "action_high"):
            bound = np.array(getattr(self, field), dtype=np.float64)
            bound.flags.writeable = False
            object.__setattr__(self, field, bound)

    @property
    def action_size(self) -> int:
        """Number of action components."""
        return len(self.action_low)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What one step did; row i belongs to the i-th lane that was stepped. All arrays belong to the caller."""

    observations: FloatArray
    """Shape (n, observation_size): the last observation of the step, never one from after a reset."""
    rewards: FloatArray
    """Shape (n,)."""
    terminated: BoolArray
    """Shape (n,): the task itself ended the episode (a fall)."""
    truncated: BoolArray
    """Shape (n,): the engine cut the episode for a reason of its own; never a training horizon."""
    elapsed: IntArray
    """Shape (n,): steps since the lane's reset, this one included."""
    diverged: BoolArray
    """Shape (n,): the engine itself says that the simulation blew up in this step. False where it cannot be asked, as
    in EnvPool; what it did then (a reset nobody asked for) is in the observation and the reward."""

    @property
    def ended(self) -> BoolArray:
        """Shape (n,): the lane must be reset before it can be stepped again."""
        return self.terminated | self.truncated


class World(Protocol):
    """Many lanes of one task behind one interface. Implementations never reset a lane by themselves."""

    @property
    def spec(self) -> TaskSpec:
        """What is being simulated."""

    @property
    def spaces(self) -> tuple[Any, Any]:
        """Gymnasium's observation and action space of one lane; (None, None) where both are flat vectors already."""

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""

    @property
    def elapsed(self) -> IntArray:
        """A copy of each lane's steps since its reset, shape (num_lanes,)."""

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """Starts a new episode in these lanes and leaves the others untouched.

        Args:
            lanes: Lane numbers, shape (n,), each at most once; None for all. Running lanes may be reset too.

        Returns:
            First observations, shape (n, observation_size), rows as in `lanes`.

        Raises:
            WorldError: If a lane is not legal; nothing was reset.
        """

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """Moves these lanes by one step and leaves the others untouched.

        Args:
            actions: Shape (n, action_size), rows as in `lanes`; values outside the box are clipped to it. Discrete
                actions are whole numbers in range.
            lanes: Lane numbers, shape (n,), each at most once; None for all.

        Returns:
            What happened, rows as in `lanes`.

        Raises:
            WorldError: If a lane has ended or was never reset, or an action is NaN or has the wrong shape; nothing
                was stepped.
        """

    def abandon(self, lanes: IntArray) -> None:
        """Ends the episodes of these lanes from outside; they must be reset before they are stepped again.

        Args:
            lanes: Lane numbers, shape (n,), each at most once. Lanes that have ended already may be among them.

        Raises:
            WorldError: If a lane does not exist.
        """

    def close(self) -> None:
        """Gives the simulators back; the world cannot be used afterwards. Closing twice is allowed."""
