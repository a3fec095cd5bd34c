"""Gymnasium wrappers for any library: random horizons, the time-to-go in the observation, disturbances, and goals.

`HorizonLimit` and `TimeToGoObservation` wrap one environment, also each of a vector: give them to
``gymnasium.make_vec(..., wrappers=[...])``. `Disturb` disturbs one environment. `StayAtGoal` counts a success only once
it has lasted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, SupportsFloat, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from perdure.disturbances import Disturber, parse_disturbances
from perdure.errors import PerdureError
from perdure.horizon import Clock, Embedding, End, HorizonDistribution, check_end

__all__ = ["Disturb", "HorizonLimit", "StayAtGoal", "TimeToGoObservation"]

Obs = TypeVar("Obs")
Act = TypeVar("Act")
HORIZON_STREAM = 1
"""Spawn key of the horizons' random numbers: seeded like the environment, but a separate stream. From the same
stream, long episodes would go with certain start states."""
OBSERVATION = "observation"
TIME_TO_GO = "time_to_go"
SUCCESS_KEYS: tuple[str, ...] = ("is_success", "success")
"""Infos that say whether a step was successful; the first that an environment has is read."""


class HorizonLimit(gymnasium.Wrapper[Obs, Act, Obs, Act], RecordConstructorArgs):
    """Draw a horizon T at every reset and end the episode on step T.

    On that step exactly one flag is true: ``terminated`` if the task itself ended there or ``end="terminated"``
    (nothing follows: the learner must not bootstrap), else ``truncated`` (it bootstraps the last observation).

    T comes from a separate random stream, seeded through ``reset(seed=...)``: same seed, same horizons, and the
    environment's own numbers stay what they are without the wrapper.

    Args:
        env: With no step limit below the longest T; ``gymnasium.make(name, max_episode_steps=-1)`` gives it none.
        distribution: Distribution of T.
        end: What reaching T means.

    Raises:
        PerdureError: If distribution or end are invalid, or the environment's own TimeLimit is shorter than the longest
            T.
    """

    horizon: float
    """T of the running episode, in steps."""
    elapsed: int
    """Steps since reset."""

    def __init__(self, env: gymnasium.Env[Obs, Act], distribution: HorizonDistribution, end: End) -> None:
        if not isinstance(distribution, HorizonDistribution):
            raise PerdureError(
                f"a horizon limit needs a HorizonDistribution, such as Uniform(200, 1000), got {distribution!r}"
            )
        check_end(end)
        limits = (float(each._max_episode_steps) for each in layers(env) if isinstance(each, TimeLimit))
        own = min(limits, default=math.inf)
        if own < distribution.longest:
            raise PerdureError(
                f"the environment cuts its episodes after {own:g} steps, before the longest horizon "
                f"({distribution.longest:g}): "
                "make it without that limit (gymnasium.make with max_episode_steps=-1)"
            )
        RecordConstructorArgs.__init__(self, distribution=distribution, end=end)
        super().__init__(env)
        self.distribution = distribution
        self.end = end
        self.horizon = 0.0
        self.elapsed = 0
        self._generator: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Obs, dict[str, Any]]:
        """Start an episode with a new horizon. A seed restarts the horizons' random numbers, and the environment's."""
        observation, info = self.env.reset(seed=seed, options=options)
        if self._generator is None or seed is not None:
            self._generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(HORIZON_STREAM,)))
        self.horizon = float(self.distribution.from_uniform(self._generator.random()))
        self.elapsed = 0
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

    Args:
        env: Contains a :class:`HorizonLimit`, unless a clock is given.
        embedding: phi.
        clock: Sets the time-to-go at deployment; None: the time-to-go of the training horizon.
        dict: Observations are {"observation", "time_to_go"} instead of one flat vector, so that a normalizer can leave
            phi out (Stable-Baselines3: ``VecNormalize(norm_obs_keys=["observation"])``).

    Raises:
        PerdureError: If there is neither a clock nor a HorizonLimit, or phi cannot be appended to the observations.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], embedding: Embedding, clock: Clock | None = None, dict: bool = False
    ) -> None:
        RecordConstructorArgs.__init__(self, embedding=embedding, clock=clock, dict=dict)
        super().__init__(env)
        self.embedding = embedding
        self.clock = clock
        self._limit = next((each for each in layers(env) if isinstance(each, HorizonLimit)), None)
        if clock is None and self._limit is None:
            raise PerdureError(f"the time-to-go needs a HorizonLimit below it, or a clock; {env} has neither")
        self._elapsed = 0
        self.observation_space = _with_phi(env.observation_space, embedding.size, as_dict=dict)

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
        phi = np.asarray(self.embedding(*time))
        space = self.observation_space
        if isinstance(space, spaces.Dict):
            return {OBSERVATION: observation, TIME_TO_GO: phi.astype(space[TIME_TO_GO].dtype)}
        return np.concatenate([observation, phi], axis=-1, dtype=space.dtype)


class Disturb(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Disturb a robot in training or evaluation: noise, delay, pushes, other physics (see `perdure.disturbances`).

    The equations and draws are those of ``perdure extrapolate --disturb`` for the same seed. Every episode has its own
    draws. Put it below the time limit and every normalizer, next to the environment itself.

    Args:
        env: Its actions are a box; pushes and factors need Gymnasium's MuJoCo.
        disturbances: Such as ["action_noise:0.1", "push:0.5"]; at most one of each kind.
        seed: Of the draws; None: the seed of `reset`, and of the first reset without one a random seed.
        observation_std: Spread of each observation component, shape (observation_size,), for observation noise; such as
            the square root of VecNormalize's `obs_rms.var`.

    Raises:
        PerdureError: If a disturbance is unknown, named twice or impossible here.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        disturbances: Sequence[str],
        seed: int | None = None,
        observation_std: Any = None,
    ) -> None:
        RecordConstructorArgs.__init__(self, disturbances=disturbances, seed=seed, observation_std=observation_std)
        super().__init__(env)
        name = type(env.unwrapped).__name__
        if env.spec:
            name = str(env.spec.id)
        space: Any = env.action_space
        box = None
        if _is_box(space):
            box = (space.low.ravel().astype(float), space.high.ravel().astype(float))
        if observation_std is not None:
            observation_std = _checked_std(observation_std, env.observation_space)
        first = seed
        if first is None:
            first = int(np.random.default_rng().integers(2**31))
        self._disturber = Disturber(name, parse_disturbances(disturbances), [first], box, observation_std, [env])
        self._fixed = seed is not None
        self._lane = np.zeros(1, np.int64)
        self._elapsed = np.zeros(1, np.int64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode with draws of its own. A seed restarts them, unless the constructor got one."""
        robots = self._disturber.robots
        if seed is not None and not self._fixed:
            robots.seeds[0] = seed
            robots.episodes[0] = 0
        self._disturber.begin(self._lane)
        self._elapsed[:] = 0
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Make one step."""
        space: Any = self.env.action_space
        given = np.zeros((1, 0))
        if _is_box(space):
            given = np.asarray(action, float).reshape(1, -1)
        actions = self._disturber.act(given, self._lane, self._elapsed)
        if _is_box(space):
            action = np.clip(actions.reshape(space.shape), space.low, space.high).astype(space.dtype)
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._elapsed += 1
        return self._observe(observation), reward, terminated, truncated, info

    def _observe(self, observation: Any) -> Any:
        if not _is_box(self.env.observation_space):
            return observation
        rows = np.array(observation, float).reshape(1, -1)
        noisy = self._disturber.observe(rows, self._lane, self._elapsed)
        return noisy.reshape(np.shape(observation)).astype(self.env.observation_space.dtype)


def _is_box(space: Any) -> bool:
    return isinstance(space, spaces.Box)


def _checked_std(values: Any, space: spaces.Space[Any]) -> NDArray[np.float64]:
    """Return the spread of the components of observations, shape (1, observation_size); PerdureError if not as many."""
    std = np.asarray(values, float).reshape(1, -1)
    if not (_is_box(space) and std.size == spaces.flatdim(space)):
        raise PerdureError(f"observation_std has {std.size} components, the observations are {space}")
    return std


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
        self.steps = steps
        self.key = key
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
        if success:
            self._stay += 1
        else:
            self._stay = 0
        self._longest = max(self._longest, self._stay)
        if terminated and 0 < self._stay < self.steps:
            raise PerdureError(f"{self.env} ends its episode at the goal, after {self._stay} of {self.steps} steps")
        info = {**info, "is_success": self._stay >= self.steps, "success_once": self._longest > 0}
        info |= {"success_at_end": bool(success), "longest_stay": self._longest}
        return observation, reward, terminated, truncated, info


def layers(env: Any) -> Iterator[Any]:
    """Yield the wrappers of a single environment, from the outermost."""
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env


def _with_phi(space: spaces.Space[Any], size: int, as_dict: bool) -> spaces.Space[Any]:
    """Return the space of observations with phi of a size: one flat Box, or a Dict {"observation", "time_to_go"}."""
    flat = isinstance(space, spaces.Box) and len(space.shape) == 1 and np.issubdtype(space.dtype, np.floating)
    if not (as_dict or flat):
        raise PerdureError(f"phi cannot be appended to observations in {space}: use dict=True, or flatten them first")
    dtype = np.dtype(np.float32)
    if isinstance(space, spaces.Box) and flat:
        dtype = space.dtype
    # No bounds: an embedding need not stay in [0, 1].
    phi = spaces.Box(-np.inf, np.inf, (size,), dtype.type)
    if as_dict:
        return spaces.Dict({OBSERVATION: space, TIME_TO_GO: phi})
    assert isinstance(space, spaces.Box)
    return spaces.Box(np.concatenate([space.low, phi.low]), np.concatenate([space.high, phi.high]), dtype=dtype.type)


# Infos


def lane_info(infos: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info of one lane of a vector's: they have entries of all lanes, and `_name` says who has one."""
    keys = [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][lane]]
    return {key: _entry(infos[key], lane) for key in keys}


def _entry(values: Any, lane: int) -> Any:
    if isinstance(values, dict):
        return lane_info(values, lane)
    # Gymnasium makes an object array of NumPy's own bool, but not of Python's.
    if values.dtype == bool:
        return bool(values[lane])
    return values[lane]


def read_success(where: str, info: Any, key: str | None) -> float:
    """Return 1.0 if the info of a step reports a success, 0.0 if it reports that there is none, nan if it does not say.

    It reads the entry `key`, or PerdureError beginning with `where`; None: one of `SUCCESS_KEYS` that is True or False.
    """
    entries: dict[str, Any] = {}
    if isinstance(info, dict):
        entries = info
    names = SUCCESS_KEYS
    if key is not None:
        names = (key,)
    for name in names:
        if name not in entries:
            continue
        value = np.asarray(entries[name])
        if value.size == 1 and value.dtype.kind in "fiub" and value.item() in (0, 1):
            return float(value.item())
    if key is None:
        return math.nan
    found = f"is missing; there are {', '.join(map(str, entries)) or 'none'}"
    if key in entries:
        found = f"is {entries[key]!r}"
    raise PerdureError(f"{where}: info[{key!r}] must be True or False after every step, it {found}")
