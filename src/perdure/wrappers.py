"""Gymnasium wrappers for any library: random horizons, the time-to-go in the observation, disturbances, and goals.

`HorizonLimit` and `TimeToGoObservation` wrap one environment. `VectorHorizonLimit` and `VectorTimeToGoObservation` do
the same for every environment of a vector, in its own autoreset mode. `Disturb` disturbs one environment.
`StayAtGoal` counts a success only once it has lasted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any, SupportsFloat, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space, iterate
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from perdure.disturbances import Disturber, parse_disturbances
from perdure.errors import PerdureError
from perdure.horizon import Clock, Embedding, End, HorizonDistribution, LaneClocks, check_end

__all__ = ["Disturb", "HorizonLimit", "StayAtGoal", "TimeToGoObservation"]
__all__ += ["VectorHorizonLimit", "VectorTimeToGoObservation"]

if TYPE_CHECKING:
    AnyVectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:
    AnyVectorWrapper = VectorWrapper  # takes type parameters from Gymnasium 1.4 on


Obs = TypeVar("Obs")
Act = TypeVar("Act")
Layer = TypeVar("Layer")
StepResult = tuple[Any, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]
HORIZON_STREAM = 1
"""Spawn key of the horizons' random numbers: seeded like the environment, but a separate stream. From the same
stream, long episodes would go with certain start states."""
OBSERVATION, TIME_TO_GO = "observation", "time_to_go"
SUCCESS_KEYS = ("is_success", "success")
"""Infos that say whether a step was successful; the first that an environment has is read."""


class HorizonLimit(gymnasium.Wrapper[Obs, Act, Obs, Act], RecordConstructorArgs):
    """Draw a horizon T at every reset and end the episode on step T.

    On that step exactly one flag is true: ``terminated`` if the task itself ended there or ``end="terminated"``
    (nothing follows: the learner must not bootstrap), else ``truncated`` (it bootstraps the last observation).

    T comes from a separate random stream, seeded through ``reset(seed=...)``: same seed, same horizons, and the
    environment's own numbers stay what they are without the wrapper.
    """

    horizon: float
    """T of the running episode, in steps."""
    elapsed: int
    """Steps since reset."""

    def __init__(self, env: gymnasium.Env[Obs, Act], distribution: HorizonDistribution, end: End) -> None:
        """Wrap an environment without a shorter step limit.

        Args:
            env: For one made by Gymnasium, ``gymnasium.make(name, max_episode_steps=-1)`` has no limit.
            distribution: Distribution of T.
            end: What reaching T means.

        Raises:
            PerdureError: If distribution or end are invalid, or the environment's own TimeLimit is shorter than the
                longest T.
        """
        check_limit(env, distribution, end)
        RecordConstructorArgs.__init__(self, distribution=distribution, end=end)
        super().__init__(env)
        self.distribution, self.end = distribution, end
        self.horizon, self.elapsed = 0.0, 0
        self._generator: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Obs, dict[str, Any]]:
        """Start an episode with a new horizon. A seed restarts the horizons' random numbers, and the environment's."""
        observation, info = self.env.reset(seed=seed, options=options)
        if self._generator is None or seed is not None:
            self._generator = horizon_generator(seed)
        self.horizon, self.elapsed = draw_horizon(self.distribution, self._generator), 0
        return observation, info

    def step(self, action: Act) -> tuple[Obs, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step; on step T one of the two flags is set.

        Raises:
            PerdureError: If there was no reset yet.
        """
        if self._generator is None:
            raise PerdureError("reset the environment before the first step: its horizon is drawn there")
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.elapsed += 1
        if self.elapsed >= self.horizon:
            terminated = bool(terminated) or self.end == "terminated"
            truncated = not terminated
        return observation, reward, terminated, truncated, info


class TimeToGoObservation(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Append phi(t, T) to the observation.

    In training (t, T) come from the :class:`HorizonLimit` below. At deployment they come from a clock:
    ``TimeToGoObservation(env, Geometric(10), clock=Constant(500))``.

    The last observation of an episode contains phi(T, T): no steps left.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        embedding: Embedding,
        clock: Clock | None = None,
        dict: bool = False,
    ) -> None:
        """Wrap an environment.

        Args:
            env: Contains a :class:`HorizonLimit`, unless a clock is given.
            embedding: phi.
            clock: Sets the time-to-go at deployment; None: the time-to-go of the training horizon.
            dict: Observations are {"observation", "time_to_go"} instead of one flat vector, so that a normalizer can
                leave phi out (Stable-Baselines3: ``VecNormalize(norm_obs_keys=["observation"])``).

        Raises:
            PerdureError: If there is neither a clock nor a HorizonLimit, or phi cannot be appended to the observations.
        """
        RecordConstructorArgs.__init__(self, embedding=embedding, clock=clock, dict=dict)
        super().__init__(env)
        self.embedding, self.clock = embedding, clock
        self._limit = find_layer(env, HorizonLimit) if clock is None else None
        self._elapsed = 0
        self.observation_space = appended_space(env.observation_space, embedding.size, as_dict=dict)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode at t = 0."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._elapsed = 0
        return self._append(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._elapsed += 1
        return self._append(observation), reward, terminated, truncated, info

    def _append(self, observation: Any) -> Any:
        if self.clock is not None:
            time = self.clock.time(np.float64(self._elapsed))
        else:
            assert self._limit is not None
            time = np.float64(self._limit.elapsed), self._limit.horizon
        return append(self.observation_space, observation, np.asarray(self.embedding(*time)))


class Disturb(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Disturb a robot in training or evaluation: noise, delay, pushes, other physics (see `perdure.disturbances`).

    The equations and draws are those of ``perdure extrapolate --disturb`` for the same seed. Every episode has its own
    draws. Put it below the time limit and every normalizer, next to the environment itself.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        disturbances: Sequence[str],
        seed: int | None = None,
        observation_std: Any = None,
    ) -> None:
        """Wrap an environment.

        Args:
            env: Its actions are a box; pushes and factors need Gymnasium's MuJoCo.
            disturbances: Such as ["action_noise:0.1", "push:0.5"]; at most one of each kind.
            seed: Of the draws; None: the seed of `reset`, and of the first reset without one a random seed.
            observation_std: Spread of each observation component, shape (observation_size,), for observation noise;
                such as the square root of VecNormalize's `obs_rms.var`.

        Raises:
            PerdureError: If a disturbance is unknown, named twice or impossible here.
        """
        RecordConstructorArgs.__init__(self, disturbances=disturbances, seed=seed, observation_std=observation_std)
        super().__init__(env)
        name = str(env.spec.id if env.spec else type(env.unwrapped).__name__)
        space: Any = env.action_space
        box = (space.low.ravel().astype(float), space.high.ravel().astype(float)) if _is_box(space) else None
        std = None if observation_std is None else np.asarray(observation_std, float).reshape(1, -1)
        if std is not None and not (
            _is_box(env.observation_space) and std.size == spaces.flatdim(env.observation_space)
        ):
            raise PerdureError(
                f"observation_std has {std.size} components, the observations are {env.observation_space}"
            )
        seeds = [int(np.random.default_rng().integers(2**31)) if seed is None else seed]
        self._disturber = Disturber(name, parse_disturbances(disturbances), seeds, box, std, [env])
        self._fixed, self._lane, self._elapsed = seed is not None, np.zeros(1, np.int64), np.zeros(1, np.int64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode with draws of its own. A seed restarts them, unless the constructor got one."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None and not self._fixed:
            self._disturber.seeds[0], self._disturber.episodes[0] = seed, 0
        self._disturber.begin(self._lane)
        self._elapsed[:] = 0
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step."""
        space: Any = self.env.action_space
        if _is_box(space):
            actions = self._disturber.act(np.asarray(action, float).reshape(1, -1), self._lane, self._elapsed)
            action = np.clip(actions.reshape(space.shape), space.low, space.high).astype(space.dtype)
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._elapsed += 1
        return self._observe(observation), reward, terminated, truncated, info

    def _observe(self, observation: Any) -> Any:
        if not self._disturber.observation_std.size:
            return observation
        rows = np.array(observation, float).reshape(1, -1)
        noisy = self._disturber.observe(rows, self._lane, self._elapsed)
        return noisy.reshape(np.shape(observation)).astype(self.env.observation_space.dtype)


def _is_box(space: Any) -> bool:
    return isinstance(space, spaces.Box)


class VectorHorizonLimit(AnyVectorWrapper):
    """:class:`HorizonLimit` for every lane of a vector environment, in its own autoreset mode.

    Put it directly above the vector environment: it resets single lanes through ``options={"reset_mask": ...}``, which
    Gymnasium's Sync- and AsyncVectorEnv and EnvPool (1.2.2 and later) understand. One that ignores the mask is found
    out at the first reset and refused.

    * ``NEXT_STEP``: the step after step T resets the lane (reward 0, action ignored), as Gymnasium does after a fall.
      The world below has been stepped once more by then; nothing of that step is shown.
    * ``SAME_STEP``: step T resets the lane; ``infos`` holds ``final_obs`` and ``final_info``.
    * ``DISABLED``: the user resets with ``reset_mask``; stepping an ended lane raises PerdureError.

    Lane i draws its horizons as a HorizonLimit that was reset with its seed would.
    """

    horizons: NDArray[np.float64]
    """T of the running episodes, in steps, shape (n,)."""
    last_horizons: NDArray[np.float64]
    """T of the episodes that the last step belonged to, shape (n,): before the resets of SAME_STEP."""

    def __init__(self, env: VectorEnv[Any, Any, Any], distribution: HorizonDistribution, end: End) -> None:
        """Wrap a vector environment without a shorter step limit.

        Args:
            env: The vector environment.
            distribution: Distribution of T.
            end: What reaching T means.

        Raises:
            PerdureError: If distribution or end are invalid, the environment's own limit is shorter than the longest T,
                or it does not say its autoreset mode.
        """
        super().__init__(env)
        check_limit(env, distribution, end)
        self.distribution, self.end = distribution, end
        self.horizons = np.zeros(self.num_envs)
        self.last_horizons = np.zeros(self.num_envs)
        self._counter = StepCounter(self.num_envs, autoreset_mode(env))
        self._cut = np.zeros(self.num_envs, np.bool_)  # ended by us alone: the world below runs on
        self._generators = [horizon_generator(None) for _ in range(self.num_envs)]

    @property
    def elapsed(self) -> NDArray[np.int64]:
        """Steps since reset, shape (n,)."""
        return self._counter.elapsed

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes with new horizons, in all lanes or those of ``options["reset_mask"]``.

        Args:
            seed: Restarts the horizons' random numbers and those of the environments: lane i gets seed + i, or seed[i].
            options: Handed on.
        """
        # A copy, because Gymnasium removes the mask from the dictionary it is given.
        observations, infos = self.env.reset(seed=seed, options=None if options is None else dict(options))  # type: ignore[arg-type]
        lanes = reset_lanes(self.num_envs, options)
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        for lane in np.flatnonzero(lanes).tolist():
            if seeds is not None and seeds[lane] is not None:
                self._generators[lane] = horizon_generator(seeds[lane])
        self._counter.reset(lanes)
        self._draw(lanes)
        return observations, infos

    def step(self, actions: Any) -> StepResult:
        """Make one step of all lanes; on step T of a lane one of its two flags is set.

        Raises:
            PerdureError: If a lane has never been reset, or has ended and must be reset by the user (DISABLED).
        """
        if not self.horizons.all():
            raise PerdureError("reset the vector environment before the first step: its horizons are drawn there")
        restarted = self._counter.advance()
        result = self._restart(restarted & self._cut, self.env.step(actions))
        self._draw(restarted)
        return self._finish(*self._limit(*result))

    def _restart(self, lanes: NDArray[np.bool_], result: StepResult) -> StepResult:
        """Reset ended lanes in NEXT_STEP mode, because the wrapped environment has stepped them."""
        if not lanes.any():
            return result
        observations, rewards, terminated, truncated, infos = result
        observations, infos = self._reset_below(lanes, observations, infos)
        return observations, np.where(lanes, 0, rewards), terminated & ~lanes, truncated & ~lanes, infos

    def _limit(self, observations: Any, rewards: Any, terminated: Any, truncated: Any, infos: Any) -> StepResult:
        """Set the flags of the lanes on their last step."""
        on_limit = self._counter.elapsed >= self.horizons
        self._cut = on_limit & ~(terminated | truncated)
        terminated = terminated | (on_limit & (self.end == "terminated"))
        truncated = np.where(on_limit, ~terminated, truncated)
        return observations, rewards, terminated, truncated, infos

    def _finish(self, observations: Any, rewards: Any, terminated: Any, truncated: Any, infos: Any) -> StepResult:
        """Reset ended lanes in SAME_STEP mode, and keep their final observations."""
        self.last_horizons = self.horizons.copy()
        restarted = self._counter.end(terminated | truncated)
        lanes = restarted & self._cut
        if lanes.any():
            for lane in np.flatnonzero(lanes).tolist():
                last = deepcopy(list(iterate(self.env.observation_space, observations))[lane])
                final = {"final_obs": last, "final_info": lane_info(infos, lane)}
                forget_lane(infos, lane)
                infos = self._add_info(infos, final, lane)
            observations, infos = self._reset_below(lanes, observations, infos)
        self._draw(restarted)
        return observations, rewards, terminated, truncated, infos

    def _reset_below(self, lanes: NDArray[np.bool_], observations: Any, infos: Any) -> tuple[Any, dict[str, Any]]:
        fresh, fresh_infos = self.env.reset(options={"reset_mask": lanes.copy()})
        replace_unmasked(infos, fresh_infos, lanes)
        for lane in np.flatnonzero(lanes).tolist():
            if self._counter.mode is AutoresetMode.NEXT_STEP:
                forget_lane(infos, lane)
            infos = self._add_info(infos, lane_info(fresh_infos, lane), lane)
        return replace_lanes(observations, fresh, lanes), infos

    def _draw(self, lanes: NDArray[np.bool_]) -> None:
        for lane in np.flatnonzero(lanes).tolist():
            self.horizons[lane] = draw_horizon(self.distribution, self._generators[lane])


class VectorTimeToGoObservation(AnyVectorWrapper):
    """:class:`TimeToGoObservation` for every lane of a vector environment, in its own autoreset mode.

    In ``SAME_STEP`` mode phi is appended to ``infos["final_obs"]`` too.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        embedding: Embedding,
        clock: Clock | LaneClocks | None = None,
        dict: bool = False,
    ) -> None:
        """Wrap a vector environment.

        Args:
            env: With a :class:`VectorHorizonLimit` somewhere beneath, unless a clock is given.
            embedding: phi.
            clock: Sets the time-to-go at deployment, one clock for all lanes or one for each; None: the time-to-go of
                the training horizons.
            dict: Observations are {"observation", "time_to_go"} instead of one flat vector.

        Raises:
            PerdureError: If there is neither a clock nor a VectorHorizonLimit, there are more or fewer clocks than
                lanes, phi cannot be appended to the observations, or the environment does not say its autoreset mode.
        """
        super().__init__(env)
        if isinstance(clock, LaneClocks) and len(clock.clocks) != self.num_envs:
            raise PerdureError(f"{self.num_envs} lanes need as many clocks, got {len(clock.clocks)}")
        self.embedding, self.clock = embedding, clock
        self._limit = find_layer(env, VectorHorizonLimit) if clock is None else None
        self._counter = StepCounter(self.num_envs, autoreset_mode(env))
        self.single_observation_space = appended_space(env.single_observation_space, embedding.size, as_dict=dict)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes at t = 0, in all lanes or those of ``options["reset_mask"]``."""
        lanes = reset_lanes(self.num_envs, options)
        # A copy, because Gymnasium removes the mask from the dictionary it is given.
        below = None if options is None else {**options}
        observations, infos = self.env.reset(seed=seed, options=below)  # type: ignore[arg-type]
        self._counter.reset(lanes)
        return append(self.observation_space, observations, self._phi()), infos

    def step(self, actions: Any) -> StepResult:
        """Make one step of all lanes.

        Raises:
            PerdureError: If a lane has ended and must be reset by the user (DISABLED).
        """
        self._counter.advance()
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": self._append_final(infos["final_obs"])}
        self._counter.end(terminated | truncated)
        return append(self.observation_space, observations, self._phi()), rewards, terminated, truncated, infos

    def _phi(self, ended: bool = False) -> NDArray[np.float64]:
        elapsed = self._counter.elapsed.astype(np.float64)
        if self.clock is not None:
            time = self.clock.time(elapsed)
        else:
            assert self._limit is not None
            time = elapsed, self._limit.last_horizons if ended else self._limit.horizons
        return np.asarray(self.embedding(*time))

    def _append_final(self, final: Any) -> Any:
        phi = self._phi(ended=True)
        if final.dtype != object:
            return append(self.observation_space, final, phi)
        space = self.single_observation_space
        appended = np.full(final.shape, None, dtype=object)
        for lane, observation in enumerate(final):
            if observation is not None:
                appended[lane] = append(space, observation, phi[lane])
        return appended


class StayAtGoal(gymnasium.Wrapper[Obs, Act, Obs, Act], RecordConstructorArgs):
    """Report ``is_success`` only after so many consecutive successful steps.

    The info also has ``success_once`` and ``success_at_end``, whether any step so far and this one were successful,
    and ``longest_stay``, the most consecutive successful steps of the episode.
    """

    def __init__(self, env: gymnasium.Env[Obs, Act], steps: int, key: str | None = None) -> None:
        """Wrap an environment whose episodes go on at the goal; `key`: info that says success, see `read_success`."""
        if steps < 1:
            raise PerdureError(f"steps must be at least 1, got {steps}")
        RecordConstructorArgs.__init__(self, steps=steps, key=key)
        super().__init__(env)
        self.steps, self.key = steps, key
        self._stay = self._longest = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Obs, dict[str, Any]]:
        """Start an episode."""
        self._stay = self._longest = 0
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Act) -> tuple[Obs, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step; PerdureError if the info does not say, or the episode ends before a success has lasted."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        success = read_success("StayAtGoal", info, self.key)
        if math.isnan(success):
            raise PerdureError(f"{self.env}: the info has no {' nor '.join(SUCCESS_KEYS)}: name its entry with key")
        self._stay = self._stay + 1 if success else 0
        self._longest = max(self._longest, self._stay)
        if terminated and 0 < self._stay < self.steps:
            raise PerdureError(f"{self.env} ends its episode at the goal, after {self._stay} of {self.steps} steps")
        info = {**info, "is_success": self._stay >= self.steps, "success_once": self._longest > 0}
        info |= {"success_at_end": bool(success), "longest_stay": self._longest}
        return observation, reward, terminated, truncated, info


# Horizons


def check_limit(env: Any, distribution: HorizonDistribution, end: Any) -> None:
    """Raise PerdureError if the limit is invalid, or the environment would cut episodes before the longest T."""
    if not isinstance(distribution, HorizonDistribution):
        raise PerdureError(
            f"a horizon limit needs a HorizonDistribution, such as Uniform(200, 1000), got {distribution!r}"
        )
    check_end(end)
    own = own_limit(env)
    if own < distribution.longest:
        raise PerdureError(
            f"the environment cuts its episodes after {own:g} steps, before the longest horizon "
            f"({distribution.longest:g}): "
            "make it without that limit (gymnasium.make with max_episode_steps=-1, envpool.make with a larger one)"
        )


def own_limit(env: Any) -> float:
    """Return the environment's own step limit if it can be read; else infinity.

    Seen are Gymnasium's TimeLimit (also inside a SyncVectorEnv), the limit in the spec of another vector environment,
    and EnvPool's max_episode_steps.
    """
    if isinstance(env, gymnasium.vector.VectorEnv):
        inner: Any = env.unwrapped
        if isinstance(inner, gymnasium.vector.SyncVectorEnv):
            return min(own_limit(part) for part in inner.envs)
        pool = getattr(inner, "config", {})
        pooled = pool.get("max_episode_steps") if isinstance(pool, dict) else None
        remote = isinstance(inner, gymnasium.vector.AsyncVectorEnv)
        spec = inner.get_attr("spec")[0] if remote else getattr(inner, "spec", None)
        known = (pooled, getattr(spec, "max_episode_steps", None), math.inf)
        return min(float(limit) for limit in known if limit is not None and limit > 0)
    limits = [math.inf]
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            limits.append(float(env._max_episode_steps))
        env = env.env
    return min(limits)


def find_layer(env: Any, kind: type[Layer]) -> Layer:
    """Return the wrapper of a kind, `HorizonLimit` or `VectorHorizonLimit`, in a stack of wrappers.

    Raises:
        PerdureError: If there is none.
    """
    layer = env
    while isinstance(layer, gymnasium.Wrapper | VectorWrapper):
        if isinstance(layer, kind):
            return layer
        layer = layer.env
    raise PerdureError(f"the time-to-go needs a {kind.__name__} below it, or a clock; {env} has neither")


def horizon_generator(seed: int | None) -> np.random.Generator:
    """Return the generator of the horizons of an environment with this seed; None takes fresh entropy."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(HORIZON_STREAM,)))


def draw_horizon(distribution: HorizonDistribution, generator: np.random.Generator) -> float:
    """Return T of the next episode, in steps."""
    return float(distribution.from_uniform(generator.random()))


# The time-to-go in observations


def appended_space(space: spaces.Space[Any], size: int, as_dict: bool) -> spaces.Space[Any]:
    """Return the space of observations with phi.

    Args:
        space: Space of the observations of one environment.
        size: Numbers in phi.
        as_dict: Dict {"observation", "time_to_go"} instead of one flat Box.

    Raises:
        PerdureError: If a flat vector is asked for and the observations are none of floating-point numbers.
    """
    flat = isinstance(space, spaces.Box) and len(space.shape) == 1 and np.issubdtype(space.dtype, np.floating)
    if not (as_dict or flat):
        raise PerdureError(f"phi cannot be appended to observations in {space}: use dict=True, or flatten them first")
    dtype = space.dtype if isinstance(space, spaces.Box) and flat else np.dtype(np.float32)
    # No bounds: an embedding need not stay in [0, 1].
    phi = spaces.Box(-np.inf, np.inf, (size,), dtype.type)
    if as_dict:
        return spaces.Dict({OBSERVATION: space, TIME_TO_GO: phi})
    assert isinstance(space, spaces.Box)
    return spaces.Box(np.concatenate([space.low, phi.low]), np.concatenate([space.high, phi.high]), dtype=dtype.type)


def append(space: spaces.Space[Any], observation: Any, phi: NDArray[np.float64]) -> Any:
    """Return the observation with phi, as a member of ``space``.

    Args:
        space: From :func:`appended_space`.
        observation: One observation, or a batch of them.
        phi: Shape (size,), or (n, size) for a batch.
    """
    if isinstance(space, spaces.Dict):
        return {OBSERVATION: observation, TIME_TO_GO: phi.astype(space[TIME_TO_GO].dtype)}
    return np.concatenate([observation, phi], axis=-1, dtype=space.dtype)


# Vector environments: autoresets, and infos with the entry ``key`` of all lanes and the mask ``_key`` of who has one


def autoreset_mode(env: VectorEnv[Any, Any, Any]) -> AutoresetMode:
    """Return how the vector environment resets its lanes; raise PerdureError if it does not say."""
    mode = env.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError:
        raise PerdureError(
            f"{env} does not say how it resets its environments: metadata['autoreset_mode'] must be one of "
            f"{', '.join(str(known) for known in AutoresetMode)}, got {mode!r}"
        ) from None


def reset_lanes(num_lanes: int, options: dict[str, Any] | None) -> NDArray[np.bool_]:
    """Return the mask of the lanes that a call of ``reset(options=options)`` resets, shape (n,)."""
    mask = (options or {}).get("reset_mask")
    return np.ones(num_lanes, np.bool_) if mask is None else np.array(mask, np.bool_)


class StepCounter:
    """Counts the steps since reset of n lanes, and reports which lanes have just started an episode.

    ``NEXT_STEP``: the step after an episode's end is the reset. ``SAME_STEP``: the step that ends an episode is also
    the reset. ``DISABLED``: the user resets.
    """

    def __init__(self, num_lanes: int, mode: AutoresetMode) -> None:
        """Begin with all lanes at 0 steps."""
        self.mode = mode
        self.elapsed = np.zeros(num_lanes, np.int64)
        """Steps since reset that belong to the returned observations, shape (n,)."""
        self.ended = np.zeros(num_lanes, np.bool_)
        """Lanes whose episode has ended and which have not been reset yet, shape (n,)."""

    def reset(self, lanes: NDArray[np.bool_]) -> None:
        """Set the lanes of a mask to 0 steps."""
        self.elapsed[lanes] = 0
        self.ended[lanes] = False

    def advance(self) -> NDArray[np.bool_]:
        """Count a step; return the mask of the lanes that it has reset instead (NEXT_STEP only).

        Raises:
            PerdureError: If a lane has ended and nothing resets it (DISABLED).
        """
        if self.mode is AutoresetMode.DISABLED and self.ended.any():
            raise PerdureError(
                f"lanes {np.flatnonzero(self.ended).tolist()} have ended: reset them before the next step with "
                "reset(options={'reset_mask': mask})"
            )
        restarted = self.ended.copy()
        self.elapsed += 1
        self.reset(restarted)
        return restarted

    def end(self, done: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Record the episodes that ended on this step; return the mask of lanes reset on it (SAME_STEP only)."""
        if self.mode is AutoresetMode.SAME_STEP:
            self.reset(done)
            return done
        self.ended = done.copy()
        return np.zeros_like(done)


def replace_lanes(observations: Any, fresh: Any, lanes: NDArray[np.bool_]) -> Any:
    """Return observations with those of ``lanes`` replaced.

    Args:
        observations: Of a step, all lanes: an array, or dictionaries and tuples of arrays.
        fresh: Of a reset with ``reset_mask=lanes``: all lanes (Gymnasium) or only those (EnvPool).
        lanes: Mask of shape (n,).

    Raises:
        PerdureError: If other lanes changed: the environment ignores ``reset_mask`` and has reset them too.
    """
    if isinstance(observations, dict):
        return {key: replace_lanes(value, fresh[key], lanes) for key, value in observations.items()}
    if isinstance(observations, tuple):
        return tuple(replace_lanes(old, new, lanes) for old, new in zip(observations, fresh, strict=True))
    if not isinstance(observations, np.ndarray):
        return fresh
    if len(fresh) != len(lanes):
        rows = observations.copy()
        rows[lanes] = fresh
        return rows
    if not np.array_equal(observations[~lanes], fresh[~lanes], equal_nan=observations.dtype.kind == "f"):
        raise PerdureError(
            "this vector environment ignores options={'reset_mask': ...}, so single lanes cannot be ended from "
            "outside: put HorizonLimit around each environment, inside a SyncVectorEnv"
        )
    return fresh


def lane_info(infos: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info dictionary of one lane of these, which are of all lanes."""
    keys = [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][lane]]
    return {key: _entry(infos[key], lane) for key in keys}


def _entry(values: Any, lane: int) -> Any:
    if isinstance(values, dict):
        return lane_info(values, lane)
    # Gymnasium makes an object array of NumPy's own bool, but not of Python's.
    return bool(values[lane]) if values.dtype == bool else values[lane]


def forget_lane(infos: dict[str, Any], lane: int) -> None:
    """Remove one lane's entries, in place; delete an entry that no lane has any more."""
    for key in [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][lane]]:
        infos[f"_{key}"][lane] = False
        if not infos[f"_{key}"].any():
            del infos[key], infos[f"_{key}"]
        elif isinstance(infos[key], dict):
            forget_lane(infos[key], lane)
        else:
            infos[key][lane] = None if infos[key].dtype == object else 0


def replace_unmasked(infos: dict[str, Any], fresh: dict[str, Any], lanes: NDArray[np.bool_]) -> None:
    """Merge, in place, infos without masks, as EnvPool returns them: one row for each lane that was reset.

    Args:
        infos: Of a step, all lanes.
        fresh: Of a reset of ``lanes`` only.
        lanes: Mask of shape (n,).
    """
    for key, value in infos.items():
        rows = fresh.get(key)
        bare = isinstance(value, np.ndarray) and f"_{key}" not in infos and len(value) == len(lanes)
        if bare and isinstance(rows, np.ndarray) and rows.shape == (lanes.sum(), *value.shape[1:]):
            infos[key] = value.copy()
            infos[key][lanes] = rows


def read_success(where: str, info: Any, key: str | None) -> float:
    """Return 1.0 if the info of a step reports a success, 0.0 if it reports that there is none, nan if it does not say.

    It reads the entry `key`, or PerdureError beginning with `where`; None: one of `SUCCESS_KEYS` that is True or False.
    """
    entries = info if isinstance(info, dict) else {}
    for value in (np.asarray(entries[name]) for name in (SUCCESS_KEYS if key is None else (key,)) if name in entries):
        if value.size == 1 and value.dtype.kind in "fiub" and value.item() in (0, 1):
            return float(value.item())
    if key is None:
        return math.nan
    found = f"is {entries[key]!r}" if key in entries else f"is missing; there are {', '.join(map(str, entries))}"
    raise PerdureError(f"{where}: info[{key!r}] must be True or False after every step, it {found}")
