"""The page's tables: success, paired episodes, failure modes, placements, releases, hand-overs, policies."""

from __future__ import annotations

import math
from itertools import combinations

from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.outcomes import COUNTINGS, paired_difference
from perdure.home.evaluate.outcomes.differences import SAME_EPISODE
from perdure.home.evaluate.outcomes.text import interval_text
from perdure.home.evaluate.page.assignment import PolicyAssignment
from perdure.home.evaluate.page.comparison import Comparison, percent
from perdure.home.evaluate.page.failure_modes import mode_counts, mode_labels
from perdure.home.evaluate.page.success import WORDS
from perdure.report import document
from perdure.report.statistics import EVALUATION_SEEDS_ONLY, TRAINING_SEEDS, Interval

UNKNOWN = "not recorded"
STRATEGY = "release strategy"


def success_table(comparison: Comparison) -> str:
    """Return the success of every strategy, and its successes that did not last."""
    headings = (STRATEGY, "in the figures", "episodes", "training x evaluation seeds", *(WORDS[c] for c in COUNTINGS))
    headings += ("counted, did not last", "of these the last object", "diverged")
    rows = []
    for strategy, label in zip(comparison.strategies, comparison.labels, strict=True):
        episodes = comparison.episodes[strategy]
        lost = episodes.filter(outcome="success that did not last")
        rows.append(
            (
                *(strategy, label, f"{len(episodes):,}", _seeds(comparison, strategy)),
                *(interval_text(comparison.final(strategy, counting)) for counting in COUNTINGS),
                *(f"{len(lost)} of {episodes['success'].sum()}", str(comparison.last_left(strategy))),
                str(episodes["diverged"].sum()),
            )
        )
    note = (
        f"Mean +- standard error over runs (none for one run) [95 % interval {_units(comparison)}]. "
        "Counted, did not last: the benchmark counts the episode as a success, yet an object left its goal after its "
        "place had ended."
    )
    return document.table("Success", headings, rows, note)


def paired_table(comparison: Comparison) -> str:
    """Return pairwise comparisons on the episodes that both strategies ran; nothing for a single strategy."""
    rows = []
    for first, second in combinations(comparison.strategies, 2):
        left, right = (comparison.episodes[strategy] for strategy in (first, second))
        both = left.join(right, on=SAME_EPISODE)
        if both.is_empty():
            continue
        better, worse = (
            int((both[f"stabilizing{a}"] & ~both[f"stabilizing{b}"]).sum()) for a, b in (("_right", ""), ("", "_right"))
        )
        found = paired_difference(left, right)
        cells = (f"{len(both):,}", str(better), str(worse), _points(found))
        rows.append((f"{second} against {first}", *cells))
    if not rows:
        return ""
    headings = ("release strategies", "same episodes", "better", "worse", "mean difference")
    note = (
        "Goal-stabilizing success of the same training seed from the same start. Mean difference [95 % interval over "
        "training seeds, Student t; over episodes where there is one training seed]. Not corrected for the number of "
        "comparisons."
    )
    return document.table("The same episodes under two release strategies", headings, rows, note)


def mode_table(comparison: Comparison) -> str:
    """Return the count and both shares of every failure mode, for every strategy and way of counting."""
    rows = []
    for counting in COUNTINGS:
        counts = {strategy: mode_counts(comparison, counting, strategy) for strategy in comparison.strategies}
        for label in mode_labels(comparison, counting):
            cells = [counts[strategy].get(label) for strategy in comparison.strategies]
            rows.append((WORDS[counting], *label, *map(_counted, cells)))
    if not rows:
        return ""
    headings = ("counting", "first unmet stage", "failure cause", *comparison.strategies)
    return document.table("Failure modes", headings, rows, "Count (share of all episodes, share of the failed ones).")


def placement_table(comparison: Comparison) -> str:
    """Return placements that did not stay by strategy: of all objects, of cylinders and of the others."""
    rows = []
    for strategy in comparison.strategies:
        shapes = {row["cylinder"]: row for row in comparison.shapes[strategy].iter_rows(named=True)}
        cells = [
            _failed_of(shapes[c]["failures"], shapes[c]["placements"]) if c in shapes else "none" for c in (True, False)
        ]
        everything = [sum(row[name] for row in shapes.values()) for name in ("failures", "placements")]
        shares = [shapes[True][name] if True in shapes else 0.0 for name in ("of_placements", "of_failures")]
        rows.append((strategy, _failed_of(*everything), *cells, *("" if s is None else percent(s) for s in shares)))
    headings = (
        "strategy",
        "did not stay",
        "cylinders",
        "other objects",
        "cylinders of all placed",
        "of those that left",
    )
    return document.table("Placements", headings, rows, "Did not stay: not goal-stabilizing, of so many placements.")


def release_table(comparison: Comparison) -> str:
    """Return median and 10 to 90 % range of height, speeds and tilt at the release."""
    columns = {
        "release_height": ("height above rest [mm]", 1000.0, 0),
        "object_speed": ("speed of the object [m/s]", 1.0, 3),
        "gripper_speed": ("of the gripper point [m/s]", 1.0, 3),
        "base_speed": ("of the base [m/s]", 1.0, 3),
        "tilt": ("tilt [deg]", 1.0, 0),
    }
    rows = []
    for strategy in comparison.strategies:
        placements = comparison.placements[strategy]
        cells = []
        for column, (_, scale, digits) in columns.items():
            found = [placements[column].quantile(level, "linear") for level in (0.5, 0.1, 0.9)]
            middle, low, high = ("" if value is None else f"{scale * value:.{digits}f}" for value in found)
            cells.append(f"{middle} ({low} to {high})" if middle else "")
        rows.append((strategy, str(len(placements)), *cells))
    headings = (STRATEGY, "placements", *(words for words, _, _ in columns.values()))
    return document.table("At the release", headings, rows, "Median (10 % to 90 %).")


def hand_over_table(comparison: Comparison, assignment: PolicyAssignment) -> str:
    """Return the counts of hand-over outcomes; nothing where no logs record them."""
    counts = {
        strategy: assignment.hand_overs.get((comparison.task, comparison.split, strategy), {})
        for strategy in comparison.strategies
    }
    outcomes = sorted({outcome for each in counts.values() for outcome in each})
    if not outcomes:
        return ""
    rows = [
        (strategy, *(str(each.get(outcome, 0)) for outcome in outcomes)) for strategy, each in counts.items() if each
    ]
    note = "Done: the whole motion ran. Anything else is a fall-back: the object was let go at rest, where it was."
    return document.table("Release strategies: how the motion went", (STRATEGY, *outcomes), rows, note)


def assignment_table(comparison: Comparison, assignment: PolicyAssignment) -> str:
    """Return which policy acted in which skill."""
    task, split = comparison.task, comparison.split
    rows = []
    for skill in assignment.skills(task, split) or ["every skill"]:
        names = [
            assignment.acting.get((task, split, strategy), {}).get(skill, ()) for strategy in comparison.strategies
        ]
        rows.append((skill, *(", ".join(map(_named, each)) or UNKNOWN for each in names)))
    note = "The scripted oracle knows the whole world; a learned policy sees what the skill's table says."
    return document.table("Policies", ("skill", *comparison.strategies), rows, note)


def _named(name: str) -> str:
    return "scripted oracle" if name == "oracle" else name


def _units(comparison: Comparison) -> str:
    """Return units and methods of the intervals as text."""
    found = {comparison.stages[strategy].select("units", "method").row(0) for strategy in comparison.strategies}
    words = {
        TRAINING_SEEDS: "over training seeds",
        EVALUATION_SEEDS_ONLY: "over episodes where there is one training seed: it says nothing about training again",
    }
    return ", ".join(f"{words[units]} ({method})" for units, method in sorted(found, reverse=True))


def _seeds(comparison: Comparison, strategy: str) -> str:
    episodes = comparison.episodes[strategy]
    trained = [seed for seed in episodes["train_seed"].unique() if seed != UNTRAINED]
    return f"{len(trained) or 'untrained'} x {episodes['eval_seed'].n_unique()}"


def _points(difference: Interval) -> str:
    mean, low, high = (100 * float(each) for each in (difference.estimate, difference.lower, difference.upper))
    return f"{mean:+.1f} points" + ("" if math.isnan(low) else f" [{low:+.1f}, {high:+.1f}]")


def _counted(cell: tuple[int, float, float] | None) -> str:
    return "0" if cell is None else f"{cell[0]} ({percent(cell[1])}, {percent(cell[2])})"


def _failed_of(failures: int, placements: int) -> str:
    return f"{failures} of {placements} ({percent(failures / placements)})" if placements else "0"
