"""State of a world's lanes: which run, and for how many steps."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np

from perdure.envs.suites import unknown_task
from perdure.envs.world import (
    MAX_SEED,
    BoolArray,
    FloatArray,
    IntArray,
    Step,
    TaskSpec,
    call,
    checked_actions,
    checked_lanes,
    checked_seeds,
    divergence_count,
    named_lanes,
    read_flag,
    read_observation,
    read_reward,
    read_tuple,
    shaped_actions,
    spec_of,
)
from perdure.errors import PerdureError


class LaneTracker:
    """Keeps track of which lanes run, and for how many steps.

    Before a world uses its simulator, it calls `lanes_to_reset` or `lanes_to_step`, which only check the arguments.
    Afterwards it calls `begin` or `advance`. A refused call therefore changes neither the world nor the tracker.
    """

    def __init__(self, num_lanes: int) -> None:
        """Start with no lane running.

        Args:
            num_lanes: How many lanes there are, at least one.
        """
        self.num_lanes = num_lanes
        self.closed = False
        self._everyone = np.arange(num_lanes, dtype=np.int64)
        self._everyone.flags.writeable = False
        self._elapsed = np.zeros(num_lanes, dtype=np.int64)
        self._begun = np.zeros(num_lanes, dtype=np.bool_)
        self._running = np.zeros(num_lanes, dtype=np.bool_)

    @property
    def elapsed(self) -> IntArray:
        """A copy of the elapsed steps, shape (num_lanes,)."""
        return self._elapsed.copy()

    @property
    def running(self) -> BoolArray:
        """A copy of which lanes may be stepped, shape (num_lanes,)."""
        return self._running.copy()

    def lanes_to_reset(self, lanes: IntArray | None) -> IntArray:
        """Check a reset before it happens and return the lane numbers, shape (n,).

        Args:
            lanes: As in `World.reset`.

        Raises:
            PerdureError: If a lane is not legal.
        """
        return self._chosen(lanes)

    def begin(self, chosen: IntArray) -> None:
        """Record that these lanes begin a new episode.

        Args:
            chosen: Checked lane numbers, shape (n,).
        """
        self._elapsed[chosen] = 0
        self._begun[chosen] = True
        self._running[chosen] = True

    def lanes_to_step(self, lanes: IntArray | None) -> IntArray:
        """Check that these lanes may be stepped.

        Args:
            lanes: As in `World.step`.

        Returns:
            Lane numbers, shape (n,).

        Raises:
            PerdureError: If a lane does not exist, is named twice, has ended or was never reset.
        """
        chosen = self._chosen(lanes)
        running = self._running if chosen is self._everyone else self._running[chosen]
        if np.count_nonzero(running) != len(running):  # a third of the time of .all(), at every step
            raise PerdureError(self._why_not(chosen[~running]))
        return chosen

    def advance(self, chosen: IntArray, ended: BoolArray) -> IntArray:
        """Record that these lanes made one step, and return their elapsed steps, shape (n,).

        Args:
            chosen: Checked lane numbers, shape (n,).
            ended: Where the task or the engine ended the episode, shape (n,).
        """
        if chosen is self._everyone:
            self._elapsed += 1
            elapsed = self._elapsed.copy()
        else:
            elapsed = self._elapsed[chosen] + 1
            self._elapsed[chosen] = elapsed
        if np.count_nonzero(ended):
            self._running[chosen[ended]] = False
        return elapsed

    def abandon(self, lanes: IntArray) -> None:
        """Record that the episodes of these lanes end here.

        Args:
            lanes: Lane numbers, shape (n,).

        Raises:
            PerdureError: If a lane does not exist or is named twice.
        """
        self._running[self._chosen(lanes)] = False

    def _chosen(self, lanes: IntArray | None) -> IntArray:
        if self.closed:
            raise PerdureError("This world is closed; build a new one with make_world.")
        return self._everyone if lanes is None else checked_lanes(lanes, self.num_lanes)

    def _why_not(self, stopped: IntArray) -> str:
        never = stopped[~self._begun[stopped]]
        if len(never):
            return f"Lanes {named_lanes(never)} were never reset; reset them before the first step."
        return f"Lanes {named_lanes(stopped)} have ended; reset them before they are stepped again."


class TrackedWorld:
    """Base class of worlds with a `LaneTracker`."""

    _spec: TaskSpec
    _tracker: LaneTracker
    _space: Any = None
    _action_space: Any = None

    @property
    def spec(self) -> TaskSpec:
        """See `World.spec`."""
        return self._spec

    @property
    def spaces(self) -> tuple[Any, Any]:
        """See `World.spaces`."""
        return self._space, self._action_space

    @property
    def num_lanes(self) -> int:
        """See `World.num_lanes`."""
        return self._tracker.num_lanes

    @property
    def elapsed(self) -> IntArray:
        """See `World.elapsed`."""
        return self._tracker.elapsed

    def abandon(self, lanes: IntArray) -> None:
        """See `World.abandon`."""
        self._tracker.abandon(lanes)


class GymnasiumWorld(TrackedWorld):
    """Lanes of one Gymnasium environment (see `World`), stepped one after the other in this thread.

    A lane's seed goes into its first `reset`; later resets continue the environment's own generator, as Gymnasium
    intends. Stepping some lanes steps only their environments.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], Any]],
        seeds: Sequence[int],
        name: str = "custom",
        suite: str = "Gymnasium",
        default_horizon: int | None = None,
    ) -> None:
        """Build the environments.

        A factory should not wrap its environment in Gymnasium's TimeLimit: lanes have no horizon. If it does, the
        limit is reported as `truncated`.

        Args:
            factories: One per lane, each returns a new environment of the same task.
            seeds: One per lane, see `checked_seeds`.
            name: Goes into the spec.
            suite: Goes into the spec.
            default_horizon: Goes into the spec; None means the first environment's own limit.

        Raises:
            PerdureError: If seeds and factories do not match or the spaces do not fit the contract.
        """
        seeds = checked_seeds(seeds)
        if len(factories) != len(seeds):
            raise PerdureError(f"{name}: {len(factories)} environments need as many seeds, got {len(seeds)}.")
        self._next_seeds: list[int | None] = list(seeds)
        self._tracker = LaneTracker(len(seeds))
        self._envs: list[Any] = []
        try:
            for factory in factories:
                self._envs.append(call(name, "making it", factory))
            self._spec = self._checked_spec(name, suite, default_horizon)
        except BaseException:
            for env in self._envs:
                with suppress(Exception):  # the first error is the one to show
                    env.close()
            raise

    def _checked_spec(self, name: str, suite: str, default_horizon: int | None) -> TaskSpec:
        """Return the spec of the environments if they are different objects with the same spaces."""
        if len({id(env.unwrapped) for env in self._envs}) < len(self._envs):
            raise PerdureError(
                f"{name}: two lanes got the same environment; the function must build a new one each time"
            )
        first = self._envs[0]
        limit = default_horizon if default_horizon is not None else getattr(first.spec, "max_episode_steps", None)
        self._space, self._action_space = first.observation_space, first.action_space
        spec = spec_of(name, suite, first, (self._space, self._action_space), limit)
        for env in self._envs[1:]:
            if env.observation_space != self._space or env.action_space != self._action_space:
                raise PerdureError(f"{name}: every lane must have the same spaces, got {env} beside {first}.")
        return spec

    @classmethod
    def from_id(cls, env_id: str, seeds: Sequence[int]) -> GymnasiumWorld:
        """Build lanes of a registered environment, without the time limit it is registered with.

        Args:
            env_id: Gymnasium's id, e.g. "Pendulum-v1", or "module:Id-v0" to import a module first.
            seeds: One per lane.

        Returns:
            The world.

        Raises:
            PerdureError: If Gymnasium has no such id.
            PerdureError: If the environment cannot be built or does not fit the contract.
        """
        import gymnasium

        module, _, registered = env_id.rpartition(":")
        try:
            if module:
                _import(module, env_id)
            spec = gymnasium.spec(registered)
        except (gymnasium.error.Error, ImportError) as problem:
            if module and isinstance(problem, ImportError):
                absent = isinstance(problem, ModuleNotFoundError) and problem.name == module.partition(".")[0]
                hint = "; put its folder on PYTHONPATH, or install it" if absent else ""
                raise PerdureError(f"gymnasium:{env_id} cannot be imported: {problem}{hint}") from problem
            known = [f"gymnasium:{known_id}" for known_id in gymnasium.registry]
            raise unknown_task(f"gymnasium:{env_id}", known) from None

        def build() -> Any:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about outdated versions
                return gymnasium.make(env_id, max_episode_steps=-1, disable_env_checker=True)

        factories = [build] * len(checked_seeds(seeds))
        return cls(factories, seeds, f"gymnasium:{env_id}", default_horizon=spec.max_episode_steps)

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self._tracker.lanes_to_reset(lanes)
        observations = np.empty((len(chosen), self._spec.observation_size))
        for row, lane in enumerate(chosen):
            where, env = f"{self._spec.name}, lane {lane}", self._envs[lane]
            returned = call(where, "reset", env.reset, seed=self._next_seeds[lane])
            observation, _ = read_tuple(where, "reset", returned, 2)
            self._next_seeds[lane] = None
            observations[row] = read_observation(where, "reset", self._space, observation)
        self._tracker.begin(chosen)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self._tracker.lanes_to_step(lanes)
        shaped = shaped_actions(self._action_space, checked_actions(actions, chosen, self._spec))
        observations = np.empty((len(chosen), self._spec.observation_size))
        rewards = np.empty(len(chosen))
        terminated, truncated, diverged = np.empty((3, len(chosen)), np.bool_)
        steps = self._tracker.elapsed
        for row, lane in enumerate(chosen):
            where = f"{self._spec.name}, lane {lane}, step {steps[lane] + 1}"
            returned = call(where, "step", self._envs[lane].step, shaped[row])
            observation, reward, ended, cut, _ = read_tuple(where, "step", returned, 5)
            observations[row] = read_observation(where, "step", self._space, observation)
            rewards[row] = read_reward(where, reward)
            terminated[row], truncated[row] = read_flag(where, "terminated", ended), read_flag(where, "truncated", cut)
            diverged[row] = divergence_count(self._envs[lane]) > 0
        elapsed = self._tracker.advance(chosen, terminated | truncated)
        return Step(observations, rewards, terminated, truncated, elapsed, diverged)

    def close(self) -> None:
        """See `World.close`."""
        if not self._tracker.closed:
            self._tracker.closed = True
            for env in self._envs:
                env.close()


def _import(module: str, env_id: str) -> None:
    """Import a module that the user named; convert every error except ImportError to PerdureError."""
    try:
        call(f"gymnasium:{env_id}", f"importing {module}", import_module, module)
    except PerdureError as error:
        if isinstance(error.__cause__, ImportError):
            raise error.__cause__ from None
        raise


class VectorEnvWorld(TrackedWorld):
    """Lanes of one `VectorEnv` (see `World`).

    A `VectorEnv` moves all its environments at every step. So every running lane must be stepped together; lanes that
    have ended get the action nearest to zero and what they do is ignored. Every episode is started with a seed made
    from the lane's seed and the number of its episode, so ended episodes have no effect on later ones.

    All three autoreset modes work: `AutoresetMode.DISABLED` is the plain one; with `NEXT_STEP` the self-made resets
    happen in ended lanes only; with `SAME_STEP` the last observation is taken from `info["final_obs"]`. Resetting some
    of the lanes needs a `VectorEnv` that follows Gymnasium's `options["reset_mask"]`; resetting all at once does not.
    """

    def __init__(
        self,
        env: Any,
        seeds: Sequence[int],
        name: str = "custom",
        suite: str = "Gymnasium",
        default_horizon: int | None = None,
    ) -> None:
        """Build a world from a `VectorEnv`.

        Args:
            env: A `gymnasium.vector.VectorEnv`. Its environments should not have a TimeLimit; one is reported as
                `truncated`.
            seeds: One per environment, see `checked_seeds`.
            name: Goes into the spec.
            suite: Goes into the spec.
            default_horizon: Goes into the spec; None means the environment's own limit.

        Raises:
            PerdureError: If seeds and environments do not match, the spaces do not fit the contract or the vector does
                not say how it resets itself.
        """
        from gymnasium.vector import AutoresetMode

        self._seeds = checked_seeds(seeds)
        if env.num_envs != len(self._seeds):
            raise PerdureError(f"{name}: {env.num_envs} environments need as many seeds, got {len(self._seeds)}.")
        self._mode = env.metadata.get("autoreset_mode")
        if not isinstance(self._mode, AutoresetMode):
            modes = ", ".join(mode.name for mode in AutoresetMode)
            raise PerdureError(f"{name}: metadata['autoreset_mode'] must be one of {modes}, got {self._mode!r}.")
        self._env = env
        self._space, self._action_space = env.single_observation_space, env.single_action_space
        limit = default_horizon if default_horizon is not None else getattr(env.spec, "max_episode_steps", None)
        engine = getattr(env, "envs", [env])[0]
        self._spec = spec_of(name, suite, engine, (self._space, self._action_space), limit)
        self._tracker = LaneTracker(len(self._seeds))
        self._episodes = np.zeros(len(self._seeds), dtype=np.int64)
        self._over = np.zeros(len(self._seeds), dtype=np.bool_)  # ended inside the vector, not reset since
        self._shown: FloatArray | None = None  # what the vector showed last, all lanes

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self._tracker.lanes_to_reset(lanes)
        mask = np.zeros(self.num_lanes, dtype=np.bool_)
        mask[chosen] = True
        shown = self._reset_inside(mask, [self._episode_seed(lane) for lane in range(self.num_lanes)])
        self._episodes[chosen] += 1
        self._tracker.begin(chosen)
        return shown[chosen]

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`; all running lanes must be stepped together."""
        from gymnasium.vector import AutoresetMode

        chosen = self._tracker.lanes_to_step(lanes)
        self._refuse_leaving_lanes_behind(chosen)
        clipped = checked_actions(actions, chosen, self._spec)
        if self._mode is AutoresetMode.DISABLED and self._over.any():
            self._reset_inside(self._over.copy(), [None] * self.num_lanes)
        idle = np.clip(np.zeros(self._spec.action_size), self._spec.action_low, self._spec.action_high)
        everyone = np.tile(idle, (self.num_lanes, 1))
        everyone[chosen] = clipped
        name = self._spec.name
        returned = call(name, "step", self._env.step, shaped_actions(self._action_space, everyone))
        batch, rewards, terminated, truncated, info = read_tuple(name, "step", returned, 5)
        rewards = self._column("rewards", rewards, "fiu").astype(np.float64)
        terminated, truncated = self._column("terminated", terminated, "b"), self._column("truncated", truncated, "b")
        self._shown = self._rows("step", batch)
        self._over = terminated | truncated
        last = self._shown
        if self._mode is AutoresetMode.SAME_STEP:
            last = self._with_final_observations(last, info)
        elapsed = self._tracker.advance(chosen, self._over[chosen])
        return Step(
            last[chosen],
            rewards[chosen],
            terminated[chosen],
            truncated[chosen],
            elapsed,
            self._diverged(info)[chosen],
        )

    def close(self) -> None:
        """See `World.close`."""
        if not self._tracker.closed:
            self._tracker.closed = True
            self._env.close()

    def _episode_seed(self, lane: int) -> int:
        seed, episode = self._seeds[lane], int(self._episodes[lane])
        if episode == 0:
            return seed
        return int(np.random.SeedSequence([seed, episode]).generate_state(1)[0]) & MAX_SEED

    def _reset_inside(self, mask: BoolArray, seeds: Sequence[int | None]) -> FloatArray:
        """Reset the lanes of the mask; at the first call all lanes, because a vector must start as a whole."""
        if mask.all() or self._shown is None:
            returned = call(self._spec.name, "reset", self._env.reset, seed=list(seeds))
            observations, _ = read_tuple(self._spec.name, "reset", returned, 2)
            self._shown, self._over = self._rows("reset", observations), np.zeros_like(mask)
            return self._shown
        only_masked = [seed if reset else None for seed, reset in zip(seeds, mask, strict=True)]
        options = {"reset_mask": mask.copy()}
        returned = call(self._spec.name, "reset", self._env.reset, seed=only_masked, options=options)
        observations, _ = read_tuple(self._spec.name, "reset", returned, 2)
        shown = self._rows("reset", observations)
        kept = ~mask & self._tracker.running
        if not np.array_equal(shown[kept], self._shown[kept], equal_nan=True):
            raise PerdureError(
                f"{self._spec.name}: resetting lanes {np.flatnonzero(mask)} changed other lanes. The VectorEnv does "
                "not follow options['reset_mask'], or a wrapper mixes lanes; give its single environments to "
                "GymnasiumWorld."
            )
        self._shown, self._over = shown, self._over & ~mask
        return shown

    def _refuse_leaving_lanes_behind(self, chosen: IntArray) -> None:
        behind = self._tracker.running
        behind[chosen] = False
        if behind.any():
            raise PerdureError(
                f"{self._spec.name}: a VectorEnv moves all lanes at once, but lanes {np.flatnonzero(behind)} are "
                "running and were left out. Step every running lane, or give the single environments to GymnasiumWorld."
            )

    def _column(self, what: str, values: Any, kinds: str) -> Any:
        """Return one value for each lane, of one of NumPy's kinds."""
        array = np.asarray(values)
        if array.shape != (self.num_lanes,) or array.dtype.kind not in kinds:
            raise PerdureError(
                f"{self._spec.name}: {what} must be {'bools' if kinds == 'b' else 'real numbers'} of shape "
                f"({self.num_lanes},), step returned {array.dtype} of shape {array.shape}"
            )
        return array

    def _rows(self, method: str, batch: Any) -> FloatArray:
        """Return a batch of observations as vectors, shape (num_lanes, observation_size), copied."""
        from gymnasium.spaces import Box
        from gymnasium.vector.utils import iterate

        if not isinstance(self._space, Box):
            lanes = iterate(self._env.observation_space, batch)
            return np.stack([read_observation(self._spec.name, method, self._space, lane) for lane in lanes])
        array = np.asarray(batch)
        shape = (self.num_lanes, *self._space.shape)
        if array.shape != shape or array.dtype.kind not in "fiub":
            raise PerdureError(
                f"{self._spec.name}: {method} must return observations of shape {shape} made of real numbers, it "
                f"returned {array.dtype} of shape {array.shape}"
            )
        return array.astype(np.float64).reshape(self.num_lanes, -1)

    def _diverged(self, info: dict[str, Any]) -> BoolArray:
        """Return which lanes diverged: by their info or, if the environments are in this process, by their engine."""
        found = np.asarray(info.get("diverged", np.zeros(self.num_lanes)), dtype=np.bool_)
        final = info.get("final_info", {})
        if isinstance(final, dict) and "diverged" in final:  # what a lane said before it was reset in the same step
            found = np.where(self._over, np.asarray(final["diverged"], dtype=np.bool_), found)
        here = [divergence_count(env) > 0 for env in getattr(self._env.unwrapped, "envs", ())]
        return found | np.array(here) if here else found

    def _with_final_observations(self, shown: FloatArray, info: dict[str, Any]) -> FloatArray:
        """Return observations, with the final one of lanes that the vector has already reset."""
        last = shown.copy()
        for lane in np.flatnonzero(self._over):
            final = _lane_of(self._space, info["final_obs"], int(lane))
            last[lane] = read_observation(self._spec.name, "step (final_obs)", self._space, final)
        return last


def _lane_of(space: Any, tree: Any, lane: int) -> Any:
    """Return one lane of a batched info entry, which may be nested and contain Gymnasium's masks."""
    from gymnasium.spaces import Dict, Tuple

    if isinstance(space, Dict) and isinstance(tree, dict):
        return {key: _lane_of(part, tree[key], lane) for key, part in space.items()}
    if isinstance(space, Tuple) and isinstance(tree, tuple):
        return tuple(_lane_of(part, branch, lane) for part, branch in zip(space, tree, strict=True))
    return tree[lane]
