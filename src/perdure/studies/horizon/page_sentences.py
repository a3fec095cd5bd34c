"""The result on the page as sentences, all from the numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from statistics import fmean

import polars as pl

from perdure.report import wording
from perdure.studies.comparison import Difference, compare_with
from perdure.studies.horizon import across_tasks, words
from perdure.studies.horizon.across_tasks import WITHOUT_INPUT, mean_gain_difference, mean_gains
from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claim_table import places, registered
from perdure.studies.horizon.claims import PPO
from perdure.studies.horizon.decide import LEVEL, ClaimDecision, Decision, TaskDecision, p_values
from perdure.studies.horizon.mechanism import ACTIONS, read_details
from perdure.studies.horizon.mechanism_actions import OWN
from perdure.studies.horizon.results import Results
from perdure.studies.horizon.tables import MEASURED, WITHIN

MAIN_CLAIM = "cross-validated-clock-matches-or-beats-discounted-ppo"
NEVER = 0.5
"""Share of training runs above which a method counts as not learned."""
Families = Sequence[Sequence[ClaimDecision]]
"""Decisions on claims that were registered together, in the order of registration."""


def sentences(results: Results, families: Families) -> str:
    """Return what was found, one item of a list for each sentence; "" where nothing is evaluated."""
    found = [
        *_main_claim(families),
        *_means(results),
        *_failures(results),
        *_never_worked(results),
        *_after_holm(results, families),
        *_advice(results),
    ]
    return "".join(f"- {line}\n" for line in found) + "\n" if found else ""


def _main_claim(families: Families) -> Iterator[str]:
    """Yield the claim about the whole method, what was decided, and the differences, as text."""
    for each in (each for family in families for each in family):
        if each.claim.id == MAIN_CLAIM:
            decisions = "; ".join(f"{decision} {where}" for decision, where in places(each).items())
            differences = "; ".join(_relative(task) for task in each.tasks if task.difference is not None)
            yield (
                "Main claim, with C chosen by other training runs (the thesis, section 3.5, chooses it on the seeds "
                f"that it reports): {each.claim.statement} After Holm's correction: {decisions}."
            )
            if differences:
                yield (
                    "Undecided does not mean equal. Difference of the mean return, as a share of discounted PPO's "
                    f"(95 % interval; the claim allows {_percent(-each.claim.margin)}): {differences}."
                )


def _relative(task: TaskDecision) -> str:
    """Return the difference of a comparison as a share of its right side's mean, as text."""
    found = task.difference
    assert found is not None
    estimate, lower, upper = (
        _percent(value / abs(found.right)) if found.right and math.isfinite(value) else "cannot tell"
        for value in (found.estimate, found.lower, found.upper)
    )
    return f"{words.setting(task.task)} {estimate} ({lower} to {upper})"


def _percent(share: float) -> str:
    return f"{round(100.0 * share)} %".replace("-", "\u2212")


def _means(results: Results) -> Iterator[str]:
    """Yield the mean over tasks of each method's gain, as text."""
    means = mean_gains(results)
    if not means:
        return
    found = [f"{words.condition(each.condition)} {_between(each.gain, f'; {each.runs}')}" for each in means]
    yield (
        f"Gain over an idle robot in {wording.whole(float(results.grid.steps))} steps, mean over "
        f"{', '.join(map(words.setting, across_tasks.settings(results)))} (95 % interval over training runs of these "
        f"tasks; training runs of each task): {'; '.join(found)}."
    )
    beside = mean_gain_difference(results, results.constant, PPO)
    if beside is None:
        return
    text = (
        f"The method's mean gain minus that of discounted PPO: {_between(beside)}. The two differ in discount, "
        "training horizons, what the end of an episode means, and input."
    )
    without = mean_gain_difference(results, results.constant, WITHOUT_INPUT)
    yield text + (
        f" Minus the mean gain of *{words.condition(WITHOUT_INPUT)}*, which differs from the method in the input "
        f"alone, it is {_between(without)}. These means were not registered."
        if without
        else ""
    )


def _first_upper(text: str) -> str:
    return text[0].upper() + text[1:]


def _between(found: Difference, note: str = "") -> str:
    """Return an estimate with its interval and a note in brackets, as text."""
    numbers = (f"{number + 0.0:.2f}".replace("-", "\u2212") for number in (found.estimate, found.lower, found.upper))
    return "{} ({} to {}{})".format(*numbers, note)


def _failures(results: Results) -> Iterator[str]:
    """Yield how many episodes of discounted PPO and of the method failed, and how many of them early, as text."""
    compared = (PPO, results.constant)
    found, against = [], []
    for setting in across_tasks.settings(results):
        shares = [_failed(results, setting, each) for each in compared]
        if all(shares):
            found.append(f"{words.setting(setting)} {' against '.join(shares)}")
            if better := _fails_less_and_gains_less(results, setting, *compared):
                against.append(
                    f"On {words.setting(setting)} {words.method(better.method)} fails less often and gains less."
                )
    steps = wording.whole(float(results.grid.steps))
    if found:
        yield " ".join(
            [
                f"Share of {steps}-step episodes that failed, in brackets within the first {WITHIN:,}, as observed: "
                f"discounted PPO against geometric time-to-go ({words.rule(compared[1].clock)}): {'; '.join(found)}. "
                "*Failed* compares a policy with its own training, and one that never worked counts as failed from "
                "step 0.",
                *against,
            ]
        )


def _fails_less_and_gains_less(results: Results, setting: str, one: Condition, other: Condition) -> Condition | None:
    """Return the method that fails less often if it has the lower gain; None if it has not, or both fail as often."""
    means = [
        [fmean(values.values()) for each in (one, other) if (values := results.values(setting, each, name))]
        for name in ("failed share", across_tasks.GAIN)
    ]
    if not all(len(each) == 2 for each in means):
        return None
    failed, gain = (first - second for first, second in means)
    return (one if failed < 0.0 else other) if failed * gain > 0.0 else None


def _failed(results: Results, setting: str, condition: Condition) -> str:
    shares = [results.values(setting, condition, name) for name in ("failed share", "failed within")]
    if not all(shares):
        return ""
    all_of_them, early = (wording.share(fmean(each.values())) for each in shares)
    return f"{all_of_them} ({early})"


def _never_worked(results: Results) -> Iterator[str]:
    """Yield where more than half of the training runs gained nothing over an idle robot in training, as text."""
    found: dict[str, list[str]] = {}
    for method in dict.fromkeys(each.method for each in across_tasks.conditions(results)):
        for setting in results.grid.settings:
            if _mostly_never_worked(results, setting, method):
                found.setdefault(words.method(method), []).append(words.setting(setting))
    if found:
        where = "; ".join(f"{method} on {', '.join(settings)}" for method, settings in found.items())
        yield f"More than half of these training runs gained little over an idle robot even in training: {where}."


def _mostly_never_worked(results: Results, setting: str, method: str) -> bool:
    row = results.grid.row(setting, method)
    runs = pl.DataFrame() if row is None else results.of(row)
    return not runs.is_empty() and fmean(runs["never worked"]) > NEVER


def _after_holm(results: Results, families: Families) -> Iterator[str]:
    decided = [each for family in families for each in family]
    lines = [
        f"  - {decision} {where}: {each.claim.statement}{_numbers(results, each, decision)}"
        for each in decided
        for decision, where in places(each).items()
        if decision in ("supported", "contradicted")
    ]
    if lines:
        count = sum(each.after_holm in ("supported", "contradicted") for each in decided)
        whole = f"{count or 'none'} of {wording.count(len(decided), 'claim')} {'is' if count < 2 else 'are'}"
        head = (
            f"{registered(families)} After Holm's correction {whole} decided as a whole. On single tasks or on "
            f"average, {len(lines)} {'is' if len(lines) == 1 else 'are'} decided, by Student's t. "
            f"{_by_permutation(families)}:"
        )
        yield "\n".join([head, *lines])
    elif decided:
        yield "No comparison of the claims below is decided after Holm's correction."


def _by_permutation(families: Families) -> str:
    """Return in how many comparisons permutation tests decide after Holm's correction, and could, as text."""
    able, count = 0, 0
    for family in families:
        number = sum(len(p_values(each)) for each in family)
        for task in (task for each in family for task in each.tasks if each.claim.over == "each"):
            able += task.difference is not None and number * task.difference.least_permutation_p <= LEVEL
            count += task.adjusted_permutation_p <= LEVEL and task.decision != "undecided"
    return (
        "A permutation test of so few runs could pass this correction in "
        f"{able or 'none'} of the comparisons, and does in {count or 'none'}"
    )


def _numbers(results: Results, each: ClaimDecision, decision: Decision) -> str:
    """Return the means of both sides of a decision on one task, and where its interval says otherwise, as text."""
    mine = [task for task in each.tasks if task.after_holm == decision and task.difference is not None]
    if each.claim.over == "mean" or len(mine) != 1 or mine[0].difference is None:
        return ""
    claim, found = each.claim, mine[0].difference
    sides = ((claim.left, found.left), (claim.right, found.right))
    shown = f" {_first_upper(claim.measure)}: {', '.join(_side(side, mean, claim.measure) for side, mean in sides)}."
    other = "contradicted" if decision == "supported" else "supported"
    against = [words.setting(task.task) for task in each.tasks if task.decision == other]
    shown += f" Before the correction it is {other} on {', '.join(against)}." if against else ""
    note = NOTES.get(claim.id)
    return shown + (note(results, mine[0].task, claim) if note else "")


def _side(side: Condition | float, mean: float, measure: str) -> str:
    """Return one side of a comparison in words."""
    if not isinstance(side, Condition):
        return f"threshold {side:g}"
    return f"{wording.quantity(mean)} ({words.condition(side) if measure in MEASURED else words.method(side.method)})"


def _later_failures(results: Results, setting: str, claim: Claim) -> str:
    """Return the share of episodes that failed after the training horizon, as a sentence."""
    whole, within = (results.values(setting, PPO, name) for name in ("failed share", "failed within"))
    assert not isinstance(claim.right, Condition)
    threshold = claim.right
    later = compare_with([whole[seed] - within[seed] for seed in whole], threshold)
    low, high = threshold + later.lower, threshold + later.upper
    return (
        f" Within the first {WITHIN:,} steps {wording.share(fmean(within.values()))} failed or never worked. Later "
        f"failures alone: {later.left:.2f} ({low:.2f} to {high:.2f}; p = {later.p():.3f} before any correction; not "
        "registered)."
    )


def _trained_c(results: Results, _: str, __: Claim) -> str:
    """Return how much the action depends on C without C = 0, as a sentence."""
    changes = read_details(results.grid, results.out, ACTIONS)
    if changes.is_empty():
        return ""
    kept = changes.filter((pl.col("method") == "geometric") & (pl.col("C") > 0) & (pl.col("C") != OWN))
    means = kept.group_by("setting", "train_seed").agg(pl.col("change").mean())
    found = []
    for setting in across_tasks.settings(results):
        runs = means.filter(pl.col("setting") == setting)["change"].to_list()
        if len(runs) > 1:
            each = compare_with(runs, 0.0)
            found.append(f"{words.setting(setting)} {each.left:.3f} ({each.lower:.3f} to {each.upper:.3f})")
    return f" Without C = 0, which no policy saw in training (not registered): {', '.join(found)}." if found else ""


NOTES: dict[str, Callable[[Results, str, Claim], str]] = {
    "policies-fail-beyond-their-horizon": _later_failures,
    "actions-hardly-depend-on-the-time-to-go": _trained_c,
}
"""What the numbers of a decision leave out, by the claim's id."""


def _advice(results: Results) -> Iterator[str]:
    """Yield how the default clock does beside others, as text."""
    losses, failing = [], []
    for setting in results.grid.settings:
        if _mostly_never_worked(results, setting, "geometric"):
            continue
        repeated = results.values(setting, Condition("geometric", "chosen periodic"), "failed share")
        if repeated and min(repeated.values()) == 1.0:
            failing.append(words.setting(setting))
        usual, chosen = (results.values(setting, Condition("geometric", clock)) for clock in ("constant:500", "chosen"))
        if usual and chosen and fmean(chosen.values()) > 0:
            loss = 1.0 - fmean(usual.values()) / fmean(chosen.values())
            size = wording.share(abs(loss))
            losses.append(f"{words.setting(setting)} {size} {'lower' if loss >= 0 else 'higher'}")
    if losses:
        yield (
            "Clock: where the geometric method worked in training, its mean return under the default, `constant:500`, "
            f"beside that under the cross-validated constant: {'; '.join(losses)} (means, not a test)."
        )
    if failing:
        where = ", ".join(failing)
        yield f"Under a repeated countdown (cross-validated C) all episodes of the geometric method failed on {where}."
