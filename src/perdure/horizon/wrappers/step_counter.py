"""Count the elapsed steps of each lane of a vector environment, in the three autoreset modes."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from perdure.horizon.errors import HorizonError


class StepCounter:
    """Counts the steps since reset of n lanes, and reports which lanes have just started an episode.

    ``NEXT_STEP``: the step after an episode's end is the reset. ``SAME_STEP``: the step that ends an episode is also
    the reset. ``DISABLED``: the user resets.
    """

    def __init__(self, num_lanes: int, mode: AutoresetMode) -> None:
        """Begin with all lanes at 0 steps.

        Args:
            num_lanes: n.
            mode: Of the vector environment.
        """
        self.mode = mode
        self.elapsed = np.zeros(num_lanes, np.int64)
        """Steps since reset that belong to the returned observations, shape (n,)."""
        self.ended = np.zeros(num_lanes, np.bool_)
        """Lanes whose episode has ended and which have not been reset yet, shape (n,)."""

    def reset(self, lanes: NDArray[np.bool_]) -> None:
        """Reset lanes to 0 steps.

        Args:
            lanes: Mask of shape (n,).
        """
        self.elapsed[lanes] = 0
        self.ended[lanes] = False

    def advance(self) -> NDArray[np.bool_]:
        """Count a step; return the mask of the lanes that it has reset instead (NEXT_STEP only).

        Raises:
            HorizonError: If a lane has ended and nothing resets it (DISABLED).
        """
        if self.mode is AutoresetMode.DISABLED and self.ended.any():
            raise HorizonError(
                f"lanes {np.flatnonzero(self.ended).tolist()} have ended: reset them before the next step with "
                "reset(options={'reset_mask': mask})"
            )
        restarted = self.ended.copy()
        self.elapsed += 1
        self.reset(restarted)
        return restarted

    def end(self, done: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Record the episodes that ended on this step; return the mask of lanes reset on it (SAME_STEP only).

        Args:
            done: Mask of shape (n,).
        """
        if self.mode is AutoresetMode.SAME_STEP:
            self.reset(done)
            return done
        self.ended = done.copy()
        return np.zeros_like(done)


def autoreset_mode(env: VectorEnv[Any, Any, Any]) -> AutoresetMode:
    """Return how the vector environment resets its lanes.

    Args:
        env: A vector environment.

    Raises:
        HorizonError: If it does not say.
    """
    mode = env.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError:
        raise HorizonError(
            f"{env} does not say how it resets its environments: metadata['autoreset_mode'] must be one of "
            f"{', '.join(str(known) for known in AutoresetMode)}, got {mode!r}"
        ) from None


def reset_lanes(num_lanes: int, options: dict[str, Any] | None) -> NDArray[np.bool_]:
    """Return the mask of the lanes that a call of ``reset(options=options)`` resets, shape (n,).

    Args:
        num_lanes: n.
        options: As the user passed them, with or without ``reset_mask``.
    """
    mask = (options or {}).get("reset_mask")
    return np.ones(num_lanes, np.bool_) if mask is None else np.array(mask, np.bool_)
