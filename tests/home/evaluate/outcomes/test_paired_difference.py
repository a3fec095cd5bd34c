"""Differences of two release strategies over the same episodes."""

import polars as pl
import pytest

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import paired_difference


def episodes(shares, count=20):
    """A table of episodes: for each training seed, the first so many are successes."""
    rows = [
        {
            "train_seed": seed,
            "eval_seed": 0,
            "index": k,
            "episode_hash": f"episode {k}",
            "stabilizing": k < round(share * count),
            "success": True,
        }
        for seed, share in enumerate(shares)
        for k in range(count)
    ]
    return pl.DataFrame(rows)


def test_the_interval_is_students_over_training_seeds():
    """Differences 0.1, 0.2, 0.3: 0.2 -+ 4.3027 * 0.1 / sqrt(3)."""
    found = paired_difference(episodes((0.5, 0.3, 0.2)), episodes((0.6, 0.5, 0.5)))
    assert (found.count, found.method) == (3, "Student t")
    assert float(found.estimate) == pytest.approx(0.2)
    assert (float(found.lower), float(found.upper)) == pytest.approx((0.2 - 0.24841, 0.2 + 0.24841), abs=1e-4)


def test_seeds_that_agree_on_the_difference_are_narrow_however_much_their_levels_differ():
    """What pairing is for; the unpaired interval of the same numbers holds 0."""
    found = paired_difference(episodes((0.1, 0.5, 0.8)), episodes((0.2, 0.6, 0.85)))
    assert 0.0 < float(found.lower) < float(found.upper) < 0.2


def test_only_common_episodes_count_and_none_is_refused():
    left, right = episodes((0.5, 0.5)), episodes((1.0, 1.0))
    half = right.filter(pl.col("index") < 10)  # where the first succeeds, too
    assert float(paired_difference(left, half).estimate) == 0.0
    assert float(paired_difference(left, right).estimate) == 0.5
    assert float(paired_difference(left, right, "success").estimate) == 0.0
    with pytest.raises(PerdureError, match="in common"):
        paired_difference(left, right.with_columns(eval_seed=pl.lit(1, pl.Int64)))
    with pytest.raises(PerdureError, match="in common"):
        paired_difference(left, right.with_columns(episode_hash=pl.lit("of another benchmark")))
