"""Which apartments are for training and which for evaluation, as in M3 (`scripts/generate_episodes.sh`)."""

from __future__ import annotations

from perdure.home.errors import HomeError

SPLITS: dict[str, tuple[tuple[int, int], ...]] = {
    "train": tuple((macro, micro) for macro in range(4) for micro in range(16)),
    "val": tuple((macro, micro) for macro in range(4) for micro in range(16, 21)),
    "eval": tuple((4, micro) for micro in range(20)),
}
"""(macro, micro) of each split: 64 for training, 20 new configurations of the same layouts, 20 of a new layout.

The new layout has 21 micro variations; M3 uses the first 20.
"""


def split_apartments(split: str) -> tuple[tuple[int, int], ...]:
    """The (macro, micro) pairs of `train`, `val` (cross-configuration) or `eval` (cross-layout)."""
    if split not in SPLITS:
        raise HomeError(f"split must be one of {', '.join(SPLITS)}, not {split!r}")
    return SPLITS[split]
