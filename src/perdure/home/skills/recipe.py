"""A recipe: PPO's settings for one skill."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Recipe:
    """The settings that differ from skill to skill, named as in `PPOConfig` (OURS; M3 trains from images)."""

    total_steps: int
    n_envs: int = 32
    n_steps: int = 128
    batch_size: int = 512
    n_epochs: int = 5
    learning_rate: float = 3e-4
    log_std_init: float = -1.0
    log_std_end: float | None = None
    """Set where the mean action alone would never open or close the hand, because training relied on noise to do it."""
    log_std_fall: tuple[float, float] = (0.0, 0.6)
    gamma: float = 0.99
    clutter: bool = False
    """Train with the objects that are no targets. They cost time, and only pick must tell them from its target."""
    any_heading: bool = False
    """Train place with `Place.any_heading`."""

    @property
    def env_options(self) -> dict[str, object]:
        """Return environment options of training only; policies are scored with clutter and M3's headings."""
        return {name: True for name in ("clutter", "any_heading") if getattr(self, name)}
