"""`perdure compare` on policies whose order is known, on equal ones, and its error rate by simulation.

python benchmarks/compare.py errors     10,000 comparisons of equal policies for each distribution (a minute)
python benchmarks/compare.py pairs      shipped policies, and the same policy twice (minutes of one core)

Both print the tables of results/compare/README.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import polars as pl

import perdure
from perdure.evaluate.compare import compare
from perdure.report.comparison import MEASURES, compare_policies
from perdure.sequential import BETS
from perdure.stats import FloatArray

COMPARISONS = 10_000
PAIRS = 200
LEVEL = 0.05
LOOKS = (8, 12, 18, 27, 40, 60, 90, 135, 200)
"""Start states after which `perdure compare` looks."""
SPAN = MEASURES["work"].span
Draw = Callable[[np.random.Generator, tuple[int, int]], FloatArray]
EQUAL: dict[str, tuple[float, Draw]] = {
    "holds: both in half of the episodes": (1.0, lambda rng, size: rng.choice([-1.0, 0, 1], size, p=[0.25, 0.5, 0.25])),
    "holds: 95 % ties": (1.0, lambda rng, size: rng.choice([-1.0, 0, 1], size, p=[0.025, 0.95, 0.025])),
    "work: normal, standard deviation 0.3": (SPAN, lambda rng, size: rng.normal(0, 0.3, size).clip(-SPAN, SPAN)),
    "work: small gains, a rare large loss": (SPAN, lambda rng, size: rng.choice([0.05, -0.95], size, p=[0.95, 0.05])),
    "work: all or nothing": (SPAN, lambda rng, size: rng.choice([-SPAN, SPAN], size)),
    "work: U-shaped": (SPAN, lambda rng, size: rng.beta(0.3, 0.3, size) - rng.beta(0.3, 0.3, size)),
}
"""Distributions of a difference of mean 0: its largest size, and how it is drawn."""
KNOWN = (
    ("Hopper-v3/ppo", "Hopper-v3/geometric", "better"),
    ("Hopper-v3/ppo-falls", "Hopper-v3/ppo-average-reward", "better"),
    ("Walker2d-v3/ppo", "Walker2d-v3/ppo-average-reward", "better"),
    ("Walker2d-v3/geometric-fixed", "Walker2d-v3/geometric", "worse"),
    ("Hopper-v3/geometric", "Hopper-v3/ppo-average-reward", "better"),
)
"""A, B and what is known of B."""
SAME = ("Hopper-v3/ppo-falls", "Walker2d-v3/ppo", "Walker2d-v3/geometric")
STEPS = 2000
MOST_EQUAL = 90
"""Start states of each side of two equal policies."""
POWER = 0.99


def errors() -> None:
    """Print the share of comparisons of equal policies that find a winner, looking after every pair."""
    print("| difference of equal policies | wrong winner | t test at each look | one t test of 12 pairs |")
    print("|---|---|---|---|")
    for name, (span, draw) in EQUAL.items():
        rng = np.random.default_rng(0)
        wrong = 0
        by_t = 0
        by_one = 0
        for _ in range(COMPARISONS // 1000):
            drawn = draw(rng, (1000, PAIRS))
            wrong += int((_won(drawn, span) | _won(-drawn, span)).sum())
            by_t += int(_t_wins(drawn, LOOKS).sum())
            by_one += int(_t_wins(drawn, (12,)).sum())
        shares = " | ".join(f"{100 * count / COMPARISONS:.1f} %" for count in (wrong, by_t, by_one))
        print(f"| {name} | {shares} |")


def _won(differences: FloatArray, span: float) -> np.ndarray:
    """Return in which comparisons, the rows, the wealth ever reaches what decides."""
    bets = np.log1p(BETS * differences[..., None] / span)
    wealth = np.exp(np.cumsum(bets, axis=1)).mean(axis=2)
    found: np.ndarray = (wealth >= 2.0 / LEVEL).any(axis=1)
    return found


def _t_wins(differences: FloatArray, looks: tuple[int, ...]) -> np.ndarray:
    """Return in which comparisons a paired t test finds a winner after one of these numbers of pairs."""
    from scipy.stats import ttest_1samp

    found = np.zeros(len(differences), np.bool_)
    with np.errstate(divide="ignore", invalid="ignore"):
        for look in looks:
            found |= ttest_1samp(differences[:, :look], 0.0, axis=1).pvalue < LEVEL
    return found


def pairs() -> None:
    """Print the comparisons of shipped policies and of equal ones."""
    print("| A | B | known | verdict on B | B - A | start states | of a t test planned with the effect |")
    print("|---|---|---|---|---|---|---|")
    for a, b, known in KNOWN:
        result = compare(a, b, steps=STEPS, on="here")
        sides = result.frame.select("policy", "train_seed").unique(maintain_order=True).rows()
        _row(a, b, known, result.frame, sides)
    for name in SAME:
        _row(name, "the same, other draws", "equal", *_twice(name))


def _row(a: str, b: str, known: str, frame: pl.DataFrame, sides: list[tuple[str, int]]) -> None:
    found = compare_policies(frame, *sides, "work")
    row = found.deciding.difference
    low, high = row.last()
    planned = "-"
    if known != "equal":
        from perdure.report.comparison import measured_episodes

        episodes = measured_episodes(frame).filter(disturbance=found.condition).sort("eval_seed")
        values = [episodes.filter(policy=label, train_seed=seed)["work"].to_numpy() for label, seed in sides]
        planned = str(_planned(values[1] - values[0]))
    cells = (a, b, known, found.verdict, f"{float(row.estimate):.2f} [{low:.2f}, {high:.2f}]", found.counts[0], planned)
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def _planned(differences: FloatArray) -> int:
    """Return the pairs of a paired t test at 5 % with power 99 % at the effect and the spread of these differences."""
    from scipy.stats import nct, t

    effect = abs(float(differences.mean())) / float(differences.std(ddof=1))
    count = 2
    while True:
        threshold = t.ppf(1.0 - LEVEL / 2.0, count - 1)
        if nct.sf(threshold, count - 1, effect * np.sqrt(count)) >= POWER:
            return count
        count += 1


def _twice(name: str) -> tuple[pl.DataFrame, list[tuple[str, int]]]:
    """Return the episodes of a policy as those of two, each from its own start states, up to a decision."""
    options = {"steps": STEPS, "on": "here", "disturb": "standard-1", "clocks": "default"}
    parts = []
    for side, first in (("A", 0), ("B", 1000)):
        frame = perdure.extrapolate(name, first_eval_seed=first, eval_seeds=MOST_EQUAL, **options).frame
        parts.append(frame.with_columns(pl.lit(side).alias("policy"), pl.col("eval_seed") - first))
    both = pl.concat(parts)
    sides = [(side, int(both["train_seed"][0])) for side in ("A", "B")]
    for look in LOOKS:
        seen = both.filter(pl.col("eval_seed") < look)
        if compare_policies(seen, *sides, "work").verdict != "cannot tell" or look == MOST_EQUAL:
            break
    return seen, sides


if __name__ == "__main__":
    {"errors": errors, "pairs": pairs}[sys.argv[1]]()
