"""A world as pure functions that a compiled JAX program calls, so that a rollout is one program.

EnvPool offers its engine to XLA directly. Any other world is called back from the program, one host call a step.
Time limits are not applied here: the program that steps the world counts the steps and decides when a lane has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback
from numpy.typing import NDArray

from perdure.envs.envpool import EnvPoolWorld, observation_keys
from perdure.errors import PerdureError
from perdure.schema import LARGEST

if TYPE_CHECKING:
    from perdure.envs.world import World

T = TypeVar("T")

Handle = Any
"""Engine state that passes through the program; an array or nothing."""


class TracedStep(NamedTuple):
    """One step of all lanes; arrays of float64 and bool."""

    observations: jax.Array
    rewards: jax.Array
    terminated: jax.Array
    truncated: jax.Array


class TracedWorld(NamedTuple):
    """``step(handle, actions)`` and ``reset(done)`` for use inside ``jax.jit`` under ``jax.enable_x64``."""

    step: Callable[[Handle, jax.Array], tuple[Handle, TracedStep]]
    """Actions of shape (num_lanes, action_size), already inside the action box."""
    reset: Callable[[jax.Array], jax.Array]
    """Starts the lanes where ``done`` (num_lanes,) is true; observations (num_lanes, d), other rows zero."""


class WorldSlot:
    """Holds the world that a compiled program steps, and releases it after the program."""

    def __init__(self) -> None:
        self._world: World | None = None
        self.handle: Handle = None
        """What the program needs first; set by :meth:`fill`."""
        self.pool_step: Callable[..., Any] | None = None
        """The engine's own traced step, if it has one."""
        self.error: BaseException | None = None
        """Error that the world raised inside the program, whose results then mean nothing."""

    def fill(self, world: World) -> None:
        """Put in a world that has been reset. Once the program runs, only it may step it until :meth:`clear`."""
        self._world = world
        self.error = None
        with jax.enable_x64(True):  # EnvPool's functions need 64 bits
            if isinstance(world, EnvPoolWorld) and observation_keys(world.pool) == ["obs"]:
                self.handle, _, _, self.pool_step = world.pool.xla()
            else:
                self.handle = jnp.zeros(())
                self.pool_step = None

    def clear(self) -> None:
        """Take the world out. A program that was interrupted goes on to its end without it."""
        self._world = None
        jax.effects_barrier()  # type: ignore[no-untyped-call]

    def keep_error(self, on_host: Callable[[jax.Array], T], shapes: Any) -> Callable[[jax.Array], T]:
        """Return a host function that keeps its error and from then on returns zeros: JAX would log and wrap errors."""

        def watched(values: jax.Array) -> T:
            try:
                if self.error is None:
                    return on_host(values)
            except BaseException as error:
                self.error = error
            zeros: T = jax.tree.map(lambda shape: np.zeros(shape.shape, shape.dtype), shapes)
            return zeros

        return watched

    @property
    def world(self) -> World:
        """The world in the slot."""
        if self._world is None:
            raise RuntimeError("the slot is empty: fill it before the program runs")
        return self._world


def traced_world(slot: WorldSlot) -> TracedWorld:
    """Return the functions of the world in the slot.

    A program made of them belongs to that world: EnvPool writes its pool's address into it, so a program kept for
    another world would go on stepping this one.
    """
    if slot.pool_step is None:
        return TracedWorld(_callback_step(slot), _reset(slot))
    return TracedWorld(_pool_step(slot.pool_step), _reset(slot))


def _pool_step(pool_step: Callable[..., Any]) -> Callable[[Handle, jax.Array], tuple[Handle, TracedStep]]:
    def step(handle: Handle, actions: jax.Array) -> tuple[Handle, TracedStep]:
        handle, (observations, rewards, terminated, truncated, _) = pool_step(handle, actions)
        return handle, TracedStep(observations, rewards.astype(jnp.float64), terminated, truncated)

    return step


def _callback_step(slot: WorldSlot) -> Callable[[Handle, jax.Array], tuple[Handle, TracedStep]]:
    lanes = slot.world.num_lanes
    size = slot.world.spec.observation_size
    flags = jax.ShapeDtypeStruct((lanes,), jnp.bool_)  # type: ignore[no-untyped-call]
    shapes = (_bits_shape(lanes, size), _bits_shape(lanes), flags, flags)

    def on_host(actions: jax.Array) -> tuple[NDArray[Any], ...]:
        step = slot.world.step(np.ascontiguousarray(actions).view(np.float64)[..., 0])
        # A state that the engine made up is neither bootstrapped nor paid for.
        rewards = np.where(step.diverged, 0.0, step.rewards)
        if not (np.isfinite(step.observations).all() and (np.abs(rewards) <= LARGEST).all()):
            words = f"observations {step.observations} and rewards {rewards}, which nobody can learn from"
            raise PerdureError(f"{slot.world.spec.name}: step returned {' '.join(words.split())[:300]}")
        return _bits(step.observations), _bits(rewards), step.terminated | step.diverged, step.truncated

    def step(handle: Handle, actions: jax.Array) -> tuple[Handle, TracedStep]:
        bits = jax.lax.bitcast_convert_type(actions, jnp.uint32)
        observations, rewards, terminated, truncated = io_callback(slot.keep_error(on_host, shapes), shapes, bits)
        return handle, TracedStep(_traced_float64(observations), _traced_float64(rewards), terminated, truncated)

    return step


def _reset(slot: WorldSlot) -> Callable[[jax.Array], jax.Array]:
    lanes = slot.world.num_lanes
    size = slot.world.spec.observation_size

    def on_host(done: jax.Array) -> NDArray[np.uint32]:
        ended = np.flatnonzero(np.asarray(done))
        observations = np.zeros((lanes, size))
        observations[ended] = slot.world.reset(ended)
        return _bits(observations)

    def reset(done: jax.Array) -> jax.Array:
        shape = _bits_shape(lanes, size)
        return _traced_float64(io_callback(slot.keep_error(on_host, shape), shape, done))

    return reset


# JAX runs host callbacks on another thread, where 64-bit numbers are off and a float64 would silently become a
# float32. So they cross as pairs of 32-bit words.


def _bits(values: NDArray[np.float64]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(values, np.float64)[..., None].view(np.uint32)


def _bits_shape(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((*shape, 2), jnp.uint32)  # type: ignore[no-untyped-call]


def _traced_float64(bits: jax.Array) -> jax.Array:
    result: jax.Array = jax.lax.bitcast_convert_type(bits, jnp.float64)
    return result
