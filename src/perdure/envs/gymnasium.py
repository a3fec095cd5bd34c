"""One Gymnasium environment a lane as a `World`, its spaces as vectors, and checks of what third-party code returns."""

from __future__ import annotations

import math
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from perdure.envs.suites import unknown_task
from perdure.envs.world import FloatArray, IntArray, Step, TaskSpec, TrackedWorld, checked_actions, checked_seeds
from perdure.errors import PerdureError, note_call
from perdure.schema import LARGEST

if TYPE_CHECKING:
    import gymnasium

NEVER = 2**62
"""A step limit that is never reached."""
T = TypeVar("T")
UNLIMITED_TASK_HORIZON = 1000
"""`TaskSpec.default_horizon` of an environment without a step limit."""
BAD_STATE_WARNINGS = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")
"""Names; the numbers differ between versions of MuJoCo."""


class GymnasiumWorld(TrackedWorld):
    """Lanes of one Gymnasium environment (see `World`), stepped one after the other in this thread.

    A lane's seed goes into its first `reset`; later resets continue the environment's own generator, as Gymnasium
    intends. Stepping some lanes steps only their environments.

    Args:
        factories: One per lane, each returns a new environment of the same task. It should not be wrapped in
            Gymnasium's TimeLimit, because lanes have no horizon; if it is, the limit is reported as `truncated`.
        seeds: One per lane, see `checked_seeds`.
        name: Goes into the spec.
        default_horizon: Goes into the spec; None means the first environment's own limit.

    Raises:
        PerdureError: If seeds and factories do not match or the spaces do not fit the contract.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], Any]],
        seeds: Sequence[int],
        name: str = "custom",
        default_horizon: int | None = None,
    ) -> None:
        seeds = checked_seeds(seeds)
        if len(factories) != len(seeds):
            raise PerdureError(f"{name}: {len(factories)} environments need as many seeds, got {len(seeds)}.")
        self._next_seeds: list[int | None] = list(seeds)
        super().__init__(len(seeds))
        self.environments: list[Any] = []
        """The environment of each lane."""
        self.infos = [dict[str, Any]() for _ in seeds]
        """The environments' last infos."""
        try:
            for factory in factories:
                mujoco = sys.modules.get("mujoco")  # imported with the first robot
                if mujoco:
                    mujoco.set_mju_user_warning(_show_model_warning)
                self.environments.append(call(name, "making it", factory))
            self.spec = self._checked_spec(name, default_horizon)
        except BaseException:
            for env in self.environments:
                with suppress(Exception):  # the first error is the one to show
                    env.close()
            raise

    def _checked_spec(self, name: str, default_horizon: int | None) -> TaskSpec:
        """Return the spec of the environments if they are different objects with the same spaces."""
        if len({id(env.unwrapped) for env in self.environments}) < len(self.environments):
            raise PerdureError(
                f"{name}: two lanes got the same environment; the function must build a new one each time"
            )
        first = self.environments[0]
        limit = default_horizon
        if limit is None:
            limit = getattr(first.spec, "max_episode_steps", None)
        self._space = first.observation_space
        self._action_space = first.action_space
        self.spaces = (self._space, self._action_space)
        spec = spec_of(name, "Gymnasium", first, self.spaces, limit)
        for env in self.environments[1:]:
            if env.observation_space != self._space or env.action_space != self._action_space:
                raise PerdureError(f"{name}: every lane must have the same spaces, got {env} beside {first}.")
        return spec

    @classmethod
    def from_id(cls, env_id: str, seeds: Sequence[int], name: str = "", **options: Any) -> GymnasiumWorld:
        """Build lanes of a registered environment, without the time limit it is registered with.

        Args:
            env_id: Gymnasium's id, e.g. "Pendulum-v1", or "module:Id-v0" to import a module first.
            seeds: One per lane.
            name: Goes into the spec; "": the id.
            options: Of the environment.

        Raises:
            PerdureError: If Gymnasium has no such id, or the environment cannot be built or does not fit the contract.
        """
        import gymnasium

        module, _, registered = env_id.rpartition(":")
        try:
            if module:
                call(f"gymnasium:{env_id}", f"importing {module}", import_module, module)
            spec = gymnasium.spec(registered)
        except PerdureError as problem:
            cause = problem.__cause__
            if not isinstance(cause, ImportError):
                raise
            hint = ""
            if isinstance(cause, ModuleNotFoundError) and cause.name == module.partition(".")[0]:
                hint = "; put its folder on PYTHONPATH, or install it"
            raise PerdureError(f"gymnasium:{env_id} cannot be imported: {cause}{hint}") from cause
        except gymnasium.error.Error:
            known = [f"gymnasium:{env_id.removesuffix(registered)}{known_id}" for known_id in gymnasium.registry]
            raise unknown_task(f"gymnasium:{env_id}", known) from None

        factories = [partial(make_env, env_id, **options)] * len(checked_seeds(seeds))
        return cls(factories, seeds, name or f"gymnasium:{env_id}", default_horizon=spec.max_episode_steps)

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self.lanes_to_reset(lanes)
        observations = np.empty((len(chosen), self.spec.observation_size))
        for row, lane in enumerate(chosen):
            where = f"{self.spec.name}, lane {lane}"
            returned = call(where, "reset", self.environments[lane].reset, seed=self._next_seeds[lane])
            observation, _ = read_tuple(where, "reset", returned, 2)
            self._next_seeds[lane] = None
            observations[row] = read_observation(where, "reset", self._space, observation)
        self.begin(chosen)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        from perdure.wrappers import read_success

        chosen = self.lanes_to_step(lanes)
        shaped = shaped_actions(self._action_space, checked_actions(actions, chosen, self.spec))
        observations = np.empty((len(chosen), self.spec.observation_size))
        rewards, successes = np.empty((2, len(chosen)))
        terminated, truncated, diverged = np.empty((3, len(chosen)), np.bool_)
        steps = self.elapsed
        for row, lane in enumerate(chosen):
            where = f"{self.spec.name}, lane {lane}, step {steps[lane] + 1}"
            returned = call(where, "step", self.environments[lane].step, shaped[row])
            # Third-party code: every part is checked before it counts.
            observation, reward, ended, cut, info = read_tuple(where, "step", returned, 5)
            observations[row] = read_observation(where, "step", self._space, observation)
            rewards[row] = read_reward(where, reward)
            terminated[row] = read_flag(where, "terminated", ended)
            truncated[row] = read_flag(where, "truncated", cut)
            diverged[row] = divergence_count(self.environments[lane]) > 0
            successes[row] = read_success(where, info, self.success_key)
            self.infos[lane] = info
        elapsed = self.advance(chosen, terminated | truncated)
        return Step(observations, rewards, terminated, truncated, elapsed, diverged, successes)

    def close(self) -> None:
        """See `World.close`."""
        if not self.closed:
            self.closed = True
            for env in self.environments:
                env.close()


def make_env(env_id: str, **options: Any) -> Any:
    """Return an environment of Gymnasium without its step limit; warnings about outdated versions are not shown."""
    import gymnasium

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            env = gymnasium.make(env_id, max_episode_steps=-1, disable_env_checker=True, **options)
        except PerdureError:  # of perdure's own environments
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
            # Without its cause, whose traceback of Gymnasium's own code would hide this sentence.
            raise PerdureError(f"gymnasium.make({env_id!r}) fails without perdure, too: {reason}") from None
    lift(env)  # a registered environment may contain a TimeLimit
    return env


def lift(env: Any) -> list[tuple[Any, int]]:
    """Lift every step limit; return the wrappers with their old limits."""
    found = [(wrapper, wrapper._max_episode_steps) for wrapper in _limits(env)]
    for wrapper, _ in found:
        _ = wrapper.spec  # Gymnasium computes it once, with the limit as it is at that time
        wrapper._max_episode_steps = NEVER
    return found


def _limits(env: Any) -> Iterator[Any]:
    """Yield the TimeLimit wrappers of a single environment; refuse a training horizon, and statistics that go on."""
    from gymnasium.wrappers import TimeLimit

    from perdure.wrappers import HorizonLimit, layers

    for each in layers(env):
        if isinstance(each, TimeLimit):
            yield each
        if isinstance(each, HorizonLimit):
            raise PerdureError(
                f"{title_of(each)}: it ends episodes at a training horizon (HorizonLimit); give the environment "
                "without it, and its steps as training_horizon"
            )
        refuse_running(each, getattr(each, RUNNING, False))


RUNNING = "update_running_mean"
"""What wrappers of Gymnasium that normalize observations or rewards have."""


def refuse_running(env: Any, running: bool) -> None:
    """Raise PerdureError for an environment that normalizes with statistics that go on changing."""
    if running:
        raise PerdureError(
            f"{title_of(env)}: its running statistics ({type(env).__name__}) begin anew and go on changing; give it "
            f"without them, or with those of training and {RUNNING} = False"
        )


def title_of(env: Any) -> str:
    """Return the id of an environment, else the name of its class."""
    spec = getattr(env, "spec", None)
    if spec is None:
        return type(env.unwrapped).__name__
    return str(spec.id)


def _show_model_warning(text: str) -> None:
    """Print a warning of MuJoCo, but no advice to the author of a robot file: it would come for each environment."""
    if "deprecated" not in text:
        print(f"MuJoCo: {text}", file=sys.stderr)


# Spaces as vectors


def spec_of(name: str, suite: str, env: Any, spaces: tuple[Any, Any], limit: int | None) -> TaskSpec:
    """Return the spec of a Gymnasium environment or vector of them; `spaces`: observation and action, of one lane.

    Raises:
        PerdureError: If actions are neither a box nor discrete, or observations cannot become one vector.
    """
    import gymnasium

    observations, actions = spaces
    low, high, discrete = _action_range(name, actions)
    try:
        observation_size = gymnasium.spaces.flatdim(observations)
    except (NotImplementedError, ValueError):
        raise PerdureError(
            f"{name}: observations must flatten to one vector of fixed length, this environment has {observations}."
        ) from None
    names = getattr(getattr(env, "unwrapped", None), "observation_names", ())
    if not isinstance(names, tuple) or len(names) != observation_size:
        names = ()
    return TaskSpec(
        name=name,
        suite=suite,
        engine=engine_of(env),
        observation_size=observation_size,
        action_low=low,
        action_high=high,
        default_horizon=UNLIMITED_TASK_HORIZON if limit is None else limit,
        discrete_actions=discrete,
        has_step_limit=limit is not None,
        step_seconds=_step_seconds(env),
        has_goal=isinstance(observations, gymnasium.spaces.Dict) and "desired_goal" in observations.spaces,
        observation_names=names,
    )


def _action_range(name: str, space: Any) -> tuple[FloatArray, FloatArray, bool]:
    """Return lowest and highest action per component, shape (action_size,), and whether actions are whole numbers."""
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

    if isinstance(space, Box):
        return space.low.ravel(), space.high.ravel(), False
    if isinstance(space, Discrete):
        first = float(space.start)
        return np.array([first]), np.array([first + float(space.n) - 1.0]), True
    if isinstance(space, MultiDiscrete):
        low = np.asarray(space.start, np.float64).ravel()
        return low, low + np.asarray(space.nvec, np.float64).ravel() - 1.0, True
    if isinstance(space, MultiBinary):
        size = math.prod(space.shape)
        return np.zeros(size), np.ones(size), True
    raise PerdureError(
        f"{name}: actions must be continuous (a Box) or discrete (Discrete, MultiDiscrete, MultiBinary), this "
        f"environment has {space}."
    )


def engine_of(env: Any) -> str:
    """Return such as "Gymnasium 1.4.0", with MuJoCo's version for one of Gymnasium's MuJoCo environments."""
    import gymnasium

    engine = f"Gymnasium {gymnasium.__version__}"
    if hasattr(getattr(env, "unwrapped", None), "mujoco_renderer"):
        import mujoco

        refuse_mujoco(mujoco.__version__)
        engine += f", MuJoCo {mujoco.__version__}"
    return engine


def refuse_mujoco(version: str) -> None:
    """Raise PerdureError for a MuJoCo that computes wrong dynamics."""
    if version.startswith("4.0.0"):
        raise PerdureError(
            f"MuJoCo {version} is installed. It computes a wrong sparse Cholesky factor, so robots move wrongly in it: "
            "pip install 'mujoco>=3.6,<4'"
        )


def _step_seconds(env: Any) -> float:
    """Return the control step, which an environment gives as `dt`, like Gymnasium's own do; nan if it does not."""
    seconds = getattr(getattr(env, "unwrapped", None), "dt", None)
    if isinstance(seconds, int | float) and 0.0 < seconds < math.inf:
        return float(seconds)
    return math.nan


def shaped_actions(space: gymnasium.Space[Any], actions: FloatArray) -> Any:
    """Return checked actions (n, action_size) in dtype and shape of an action space: (n, *space.shape)."""
    return actions.reshape(len(actions), *(space.shape or ())).astype(space.dtype, copy=False)


def batch_of(space: gymnasium.Space[Any] | None, rows: FloatArray) -> Any:
    """Return observation vectors as a batch of the environment's own observation space.

    Args:
        space: The observation space of one lane; None: observations are vectors already.
        rows: Shape (n, observation_size), as `gymnasium.spaces.flatten` makes them.

    Returns:
        An array of shape (n, *space.shape) and the space's number type, in newly allocated memory; for Dict and Tuple a
        dict or tuple of such arrays.
    """
    from gymnasium import spaces

    if space is None:
        return rows.copy()
    if isinstance(space, spaces.Dict):
        return dict(zip(space, _parts(list(space.values()), rows), strict=True))
    if isinstance(space, spaces.Tuple):
        return tuple(_parts(list(space), rows))
    if isinstance(space, spaces.Box | spaces.MultiBinary):
        return rows.reshape(len(rows), *space.shape).astype(space.dtype)
    if isinstance(space, spaces.Discrete):
        return (rows.argmax(axis=1) + int(space.start)).astype(space.dtype)
    return np.stack([spaces.unflatten(space, row) for row in rows])


def _parts(spaces: Sequence[Any], rows: FloatArray) -> list[Any]:
    """Return each part of a composed observation, as a batch."""
    import gymnasium

    ends = np.cumsum([gymnasium.spaces.flatdim(space) for space in spaces])
    return [batch_of(space, part) for space, part in zip(spaces, np.split(rows, ends[:-1], axis=1), strict=True)]


def divergence_count(env: Any) -> int:
    """Return how often MuJoCo reset itself after a divergence since the environment's last reset; 0 without MuJoCo.

    MuJoCo answers a position, velocity or acceleration that is not a number, or is beyond 1e10, by resetting the data
    to its start; the counters of these warnings survive that reset (``mj_checkPos``, ``mj_checkVel``, ``mj_checkAcc``).
    """
    warnings = getattr(getattr(env.unwrapped, "data", None), "warning", None)
    if warnings is None or "mujoco" not in sys.modules:  # an environment on MuJoCo has imported it
        return 0
    counts = warnings.number.tolist()
    return int(sum(counts[place] for place in _bad_states()))


@cache
def _bad_states() -> tuple[int, ...]:
    """Return the places of `BAD_STATE_WARNINGS` among MuJoCo's warnings; looked up once, this runs in every step."""
    import mujoco

    return tuple(int(getattr(mujoco.mjtWarning, name)) for name in BAD_STATE_WARNINGS)


# Calls of third-party environments. Gymnasium does not check what they return. NumPy would stretch an observation that
# shrank to one number over the whole row, drop the imaginary part of a complex one, and take any text for true.


def call(where: str, method: str, function: Callable[..., T], *args: Any, **keywords: Any) -> T:
    """Call a method of a third-party environment; `where` names it and, if known, lane and step.

    Raises:
        PerdureError: Whatever it raised, SystemExit included, in one line.
    """
    note_call(f"{where}: {method}")
    try:
        return function(*args, **keywords)
    except PerdureError:
        raise
    except BaseException as error:
        # Worker processes ignore SIGINT: there it is the environment that raises KeyboardInterrupt.
        if isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
            raise
        raised = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
        raise PerdureError(f"{where}: {method} raised {raised}") from error
    finally:
        note_call("")


def read_tuple(where: str, method: str, returned: Any, length: int) -> tuple[Any, ...]:
    """Return what a method returned if it is a tuple of this length."""
    if not isinstance(returned, tuple | list) or len(returned) != length:
        found = type(returned).__name__
        if isinstance(returned, tuple | list):
            found = f"{len(returned)} values"
        raise PerdureError(f"{where}: {method} must return {length} values, it returned {found}")
    return tuple(returned)


def read_observation(where: str, method: str, space: Any, observation: Any) -> FloatArray:
    """Return an observation as a vector, shape (flatdim(space),), float64, copied.

    Raises:
        PerdureError: If it is not made of real numbers of the shape of its space.
    """
    import gymnasium

    size = gymnasium.spaces.flatdim(space)
    is_box = isinstance(space, gymnasium.spaces.Box)
    try:
        if not is_box:
            observation = gymnasium.spaces.flatten(space, observation)
        flat = np.asarray(observation)
    except Exception as error:
        raise PerdureError(f"{where}: {method} returned an observation that does not fit {space}: {error}") from error
    if flat.dtype.kind not in "fiub":
        raise PerdureError(f"{where}: {method} returned an observation of {flat.dtype}; it must be real numbers")
    if flat.size != size or (is_box and flat.shape != space.shape and flat.shape != (size,)):
        expected = space.shape if is_box else (size,)
        raise PerdureError(f"{where}: {method} returned an observation of shape {flat.shape}, not {expected}")
    return flat.astype(np.float64).ravel()


def read_reward(where: str, reward: Any) -> float:
    """Return a reward as a number; PerdureError if it is not one real number, or so large that sums overflow."""
    if isinstance(reward, float):  # NumPy's float64 too
        number = float(reward)
    else:
        value = np.asarray(reward)
        if value.dtype.kind not in "fiub" or value.size != 1:
            raise PerdureError(f"{where}: the reward must be a real number, it is {reward!r}")
        number = float(value.reshape(()))
    if LARGEST < abs(number) < math.inf:  # an infinite one is a sign of divergence
        raise PerdureError(f"{where}: the reward is {number:g}; rewards must be at most {LARGEST:g} in size")
    return number


def read_flag(where: str, name: str, flag: Any) -> bool:
    """Return `terminated` or `truncated` as a bool; 0 and 1 are accepted. PerdureError if it is anything else."""
    if isinstance(flag, bool | np.bool_):
        return bool(flag)
    value = np.asarray(flag)
    if value.size != 1 or value.dtype.kind not in "biu" or int(value.reshape(())) not in (0, 1):
        raise PerdureError(f"{where}: {name} must be True or False, it is {flag!r}")
    return bool(value.reshape(()))
