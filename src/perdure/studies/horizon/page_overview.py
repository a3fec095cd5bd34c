"""The result on the page: sentences, the table of methods and the table of clocks, all from the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean

import polars as pl

from perdure.report import wording
from perdure.report.render import Figure
from perdure.studies.comparison import Difference
from perdure.studies.horizon import across_tasks, figure_gain, words
from perdure.studies.horizon.across_tasks import mean_gains
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.claim_table import places
from perdure.studies.horizon.claims import MAIN_SETTINGS
from perdure.studies.horizon.decide import LEVEL, ClaimDecision, Decision, p_values
from perdure.studies.horizon.results import Results
from perdure.studies.horizon.tables import WITHIN

METHODS = (*across_tasks.METHODS, Condition("linear", "countdown"))
"""Columns of the first table, before that of the method; one without a number is left out."""
CLOCKS = ("constant:500", "chosen", "countdown", "chosen periodic", "constant:0")
"""Of the geometric method, with the chosen ones cross-validated."""
MAIN_CLAIM = "cross-validated-clock-matches-or-beats-discounted-ppo"
NEVER = 0.5
"""Share of training runs above which a method counts as not learned."""
NONE = "\u2013"


def overview(results: Results, decided: Sequence[ClaimDecision], figures: Sequence[Figure]) -> str:
    """Return the first part of the page."""
    columns = [
        each
        for each in (*METHODS, results.constant)
        if any(results.values(setting, each) for setting in results.grid.settings)
    ]
    if not columns:
        return "## Result\n\nNothing is evaluated on the test start states yet.\n\n"
    lines = [_method_line(results, setting, columns) for setting in results.grid.settings]
    main = [f"![{each.title}](figures/{each.name}.png)\n\n" for each in figures if each.name == figure_gain.NAME]
    parts = [_sentences(results, decided), *main, _method_head(results, columns), *lines, "\n", _clock_table(results)]
    return "## Result\n\n" + "".join(parts)


def _sentences(results: Results, decided: Sequence[ClaimDecision]) -> str:
    found = [
        *_main_claim(decided),
        *_means(results),
        *_failures(results),
        *_never_worked(results),
        *_after_holm(decided),
        *_advice(results),
    ]
    return "".join(f"- {line}\n" for line in found) + "\n" if found else ""


def _main_claim(decided: Sequence[ClaimDecision]) -> Iterator[str]:
    """Yield the claim about the whole method, and what was decided, as text."""
    for each in decided:
        if each.claim.id == MAIN_CLAIM:
            decisions = "; ".join(f"{decision} {where}" for decision, where in places(each).items())
            yield (
                "Main claim, with C chosen by other training runs (the thesis, section 3.5, chooses it on the seeds "
                f"that it reports): {each.claim.statement} After Holm's correction: {decisions}."
            )


def _means(results: Results) -> Iterator[str]:
    """Yield the mean over tasks of each method's gain, as text."""
    means = mean_gains(results)
    if not means:
        return
    found = [f"{words.condition(each.condition)} {_between(each.gain, f'; {each.runs}')}" for each in means]
    text = (
        f"Gain over an idle robot in {wording.whole(float(results.grid.steps))} steps, mean over "
        f"{', '.join(map(words.setting, across_tasks.settings(results)))} (95 % interval; training runs of each task): "
        f"{'; '.join(found)}."
    )
    beside = next((each.beside_ppo for each in means if each.condition == results.constant), None)
    yield text + (f" The method minus discounted PPO: {_between(beside)}." if beside else "")


def _between(found: Difference, note: str = "") -> str:
    """Return an estimate with its interval and a note in brackets, as text."""
    numbers = (f"{number + 0.0:.2f}".replace("-", "\u2212") for number in (found.estimate, found.lower, found.upper))
    return "{} ({} to {}{})".format(*numbers, note)


def _failures(results: Results) -> Iterator[str]:
    """Yield how many episodes of discounted PPO and of the method failed, and how many of them early, as text."""
    compared = (Condition("ppo"), results.constant)
    found = []
    for setting in results.grid.settings:
        shares = [_failed(results, setting, each) for each in compared]
        if setting in MAIN_SETTINGS and all(shares):
            found.append(f"{words.setting(setting)} {' against '.join(shares)}")
    steps = wording.whole(float(results.grid.steps))
    if found:
        yield (
            f"Share of {steps}-step episodes that failed, in brackets within the first {WITHIN:,}, as observed: "
            f"discounted PPO against geometric time-to-go ({words.rule(compared[1].clock)}): {'; '.join(found)}."
        )


def _failed(results: Results, setting: str, condition: Condition) -> str:
    shares = [results.values(setting, condition, name) for name in ("failed share", "failed within")]
    if not all(shares):
        return ""
    all_of_them, early = (wording.share(fmean(each.values())) for each in shares)
    return f"{all_of_them} ({early})"


def _never_worked(results: Results) -> Iterator[str]:
    """Yield where more than half of the training runs gained nothing over an idle robot in training, as text."""
    found: dict[str, list[str]] = {}
    for method in dict.fromkeys(each.method for each in (*METHODS, results.constant)):
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


def _after_holm(decided: Sequence[ClaimDecision]) -> Iterator[str]:
    tests = [p for each in decided for p in p_values(each)]
    lines = [
        f"  - {decision} {where}: {each.claim.statement}{_numbers(each, decision)}"
        for each in decided
        for decision, where in places(each).items()
        if decision in ("supported", "contradicted")
    ]
    if lines:
        count = sum(each.after_holm in ("supported", "contradicted") for each in decided)
        whole = f"{count or 'none'} of {wording.count(len(decided), 'claim')} {'is' if count < 2 else 'are'}"
        head = (
            f"Of {len(tests)} registered comparisons {sum(map(math.isfinite, tests))} are evaluated. After Holm's "
            f"correction {whole} decided as a whole. On single tasks or on average, {len(lines)} "
            f"{'is' if len(lines) == 1 else 'are'} decided by Student's t, {_by_permutation(decided)} by permutation "
            "tests of the same runs:"
        )
        yield "\n".join([head, *lines])
    elif decided:
        yield "No comparison of the claims below is decided after Holm's correction."


def _numbers(each: ClaimDecision, decision: Decision) -> str:
    """Return the means of both sides of a decision on one task, and where its interval says otherwise, as text."""
    mine = [task.difference for task in each.tasks if task.after_holm == decision and task.difference is not None]
    if each.claim.over == "mean" or len(mine) != 1:
        return ""
    measure = each.claim.measure[0].upper() + each.claim.measure[1:]
    shown = f" {measure}: {wording.quantity(mine[0].left)} against {wording.quantity(mine[0].right)}."
    other = "contradicted" if decision == "supported" else "supported"
    against = [words.setting(task.task) for task in each.tasks if task.decision == other]
    return shown + (f" Before the correction it is {other} on {', '.join(against)}." if against else "")


def _by_permutation(decided: Sequence[ClaimDecision]) -> str:
    """Return on how many tasks permutation tests decide after Holm's correction, as text."""
    tasks = [task for each in decided for task in each.tasks if each.claim.over == "each"]
    count = sum(task.adjusted_permutation_p <= LEVEL and task.decision != "undecided" for task in tasks)
    return str(count) if count else "none"


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


def _method_head(results: Results, columns: Sequence[Condition]) -> str:
    steps = wording.whole(float(results.grid.steps))
    names = " | ".join(words.condition(each) for each in columns)
    what = (
        f"Mean return of {steps} steps on test start states. In brackets: gain; share of episodes that failed; "
        "training runs x start states. *Gain*: return minus that of an idle robot in the same steps, as a share of a "
        "published policy's over all steps: 0 for a robot that falls at once, less for one that stands worse than an "
        "idle robot. *Failed*: fell, diverged, never worked (counted from step 0), or ended with less than three "
        "quarters of the gain over an idle robot that it had in training (*decays* and *fails silently*). Runs that "
        "cannot be judged are left out of that share. Most runs either fail early or keep nearly "
        "full reward, so the means have wide intervals. C is the constant number of steps to go given to the "
        f"policy. {_choice(results)}Tasks without a name in brackets use the settings of RL Baselines3 Zoo. A robot "
        "that stands still for the reward of being alive can have a high return and fail."
    )
    return f"{what}\n\n| task | {names} |\n|---{'|---' * len(columns)}|\n"


def _choice(results: Results) -> str:
    """Return how C was chosen, as sentences."""
    if results.constant.clock != "chosen":
        return ""
    return (
        "It is cross-validated: that of the highest mean return of the *other* training runs on validation "
        f"start states ({_validation_states(results)} each). To the linear embedding every C > 0 is the same input. "
    )


def _validation_states(results: Results) -> str:
    runs = results.validation_runs
    counts: list[int] = [] if runs.is_empty() else runs["episodes"].unique().sort().to_list()
    return " or ".join(map(str, counts)) or "none evaluated"


def _method_line(results: Results, setting: str, columns: Sequence[Condition]) -> str:
    cells = [_cell(results, setting, condition) for condition in columns]
    return f"| {words.setting(setting)} | {' | '.join(cells)} |\n" if set(cells) != {NONE} else ""


def _cell(results: Results, setting: str, condition: Condition) -> str:
    names = ("return", "gain", "failed share")
    returns, gains, failed = (results.values(setting, condition, name) for name in names)
    if not returns:
        return NONE
    states = results.start_states(setting, condition.method)
    gain = round(fmean(gains.values()), 2) + 0.0  # no -0.00
    shown = f"gain {gain:.2f}; ".replace("-", "\u2212") if math.isfinite(gain) else ""
    return f"{wording.quantity(fmean(returns.values()))} ({shown}{_share(failed)}; {len(returns)} x {states})"


def _share(failed: Mapping[int, float]) -> str:
    return wording.share(fmean(failed.values())) if failed else "cannot tell"


def _clock_table(results: Results) -> str:
    shown = [
        clock
        for clock in CLOCKS
        if any(results.values(setting, Condition("geometric", clock)) for setting in results.grid.settings)
    ]
    if not shown:
        return ""
    lines = []
    for setting in results.grid.settings:
        cells = [_clock_cell(results, setting, clock) for clock in shown]
        if set(cells) != {NONE}:
            lines.append(f"| {words.setting(setting)} | {' | '.join(cells)} |\n")
    names = " | ".join(words.rule(clock) for clock in shown)
    what = (
        "Mean return of the geometric method by clock. In brackets: share of episodes that failed; values of C chosen. "
        "A countdown to the end shows more than 1,000 steps to go nearly all the time, as no training episode did."
    )
    return f"{what}\n\n| task | {names} |\n|---{'|---' * len(shown)}|\n{''.join(lines)}\n"


def _clock_cell(results: Results, setting: str, clock: str) -> str:
    returns, row = results.values(setting, Condition("geometric", clock)), results.grid.row(setting, "geometric")
    if not returns or row is None:
        return NONE
    failed = results.values(setting, Condition("geometric", clock), "failed share")
    notes = _share(failed)
    if clock.startswith("chosen"):
        values = sorted({int(each.partition(":")[2]) for each in results.clocks(row, clock).values()})
        notes += f"; C = {' or '.join(map(wording.whole, map(float, values)))}"
    return f"{wording.quantity(fmean(returns.values()))} ({notes})"
