"""`World`, perdure's vector environment: independent lanes, no autoreset, separate `terminated` and `truncated`.

A *lane* is one sub-environment, and the episode that runs in it. Its start states depend on its seed and on its own
earlier episodes, never on its place in the batch nor on its neighbors. Two arrays say how an episode ended: by the task
(`terminated`) or by a limit of the engine (`truncated`). A world has no horizon: the learner counts it
(`ppo/rollout.py`), and for other learners the wrappers of `perdure.horizon` do.
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
    """The description of a task that a policy depends on."""

    name: str
    """Name of the task for `make_world`."""
    suite: str
    """Suite of the task, as in `list_tasks`."""
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
    has_step_limit: bool = True
    """Whether `default_horizon` is the environment's own step limit, and not an assumption."""
    hides_divergence: bool = False
    """Whether a simulation that diverged may be put back to its start without a report, as MuJoCo does in EnvPool."""

    def __post_init__(self) -> None:
        """Keep read-only copies of the bounds, so that no caller can move the box of a running world."""
        for field in ("action_low", "action_high"):
            bound = np.array(getattr(self, field), dtype=np.float64)
            bound.flags.writeable = False
            object.__setattr__(self, field, bound)

    @property
    def action_size(self) -> int:
        """Return the number of action components."""
        return len(self.action_low)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The result of one step; row i belongs to the i-th lane that was stepped. All arrays belong to the caller."""

    observations: FloatArray
    """Shape (n, observation_size): the last observation of the step, never one from after a reset."""
    rewards: FloatArray
    """Shape (n,)."""
    terminated: BoolArray
    """Shape (n,): the task itself ended the episode (a fall)."""
    truncated: BoolArray
    """Shape (n,): the engine ended the episode for another reason; never a training horizon."""
    elapsed: IntArray
    """Shape (n,): steps since the lane's reset, this one included."""
    diverged: BoolArray
    """Shape (n,): the engine reports that the simulation diverged in this step. False if the engine cannot report it,
    as in EnvPool; observation and reward then show what the engine did (such as an autoreset)."""

    @property
    def ended(self) -> BoolArray:
        """Shape (n,): the lane must be reset before it can be stepped again."""
        return self.terminated | self.truncated


class World(Protocol):
    """Many lanes of one task. Implementations never reset a lane by themselves."""

    @property
    def spec(self) -> TaskSpec:
        """Description of the task."""

    @property
    def spaces(self) -> tuple[Any, Any]:
        """Gymnasium's observation and action space of one lane; (None, None) if both are flat vectors."""

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""

    @property
    def elapsed(self) -> IntArray:
        """A copy of each lane's steps since its reset, shape (num_lanes,)."""

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """Start a new episode in these lanes; the others are unaffected.

        Args:
            lanes: Lane numbers, shape (n,), each at most once; None for all. Running lanes may be reset too.

        Returns:
            First observations, shape (n, observation_size), rows as in `lanes`.

        Raises:
            WorldError: If a lane is not legal; nothing was reset.
        """

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """Move these lanes by one step; the others are unaffected.

        Args:
            actions: Shape (n, action_size), rows as in `lanes`; values outside the box are clipped to it. Discrete
                actions are whole numbers in range.
            lanes: Lane numbers, shape (n,), each at most once; None for all.

        Returns:
            Result of the step, rows as in `lanes`.

        Raises:
            WorldError: If a lane has ended or was never reset, or an action is NaN or has the wrong shape; nothing
                was stepped.
        """

    def abandon(self, lanes: IntArray) -> None:
        """End the episodes of these lanes from outside; they must be reset before they are stepped again.

        Args:
            lanes: Lane numbers, shape (n,), each at most once. Lanes that have ended already may be among them.

        Raises:
            WorldError: If a lane does not exist.
        """

    def close(self) -> None:
        """Release the simulators; the world cannot be used afterwards. Closing twice is allowed."""
