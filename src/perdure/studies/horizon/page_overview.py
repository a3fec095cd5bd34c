"""The result on the page: the sentences, the table of methods and the table of clocks, all from the numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean

from perdure.report import wording
from perdure.report.render import Figure
from perdure.studies.horizon import across_tasks, figure_gain, words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.page_sentences import Families, sentences
from perdure.studies.horizon.results import Results

METHODS = (*across_tasks.METHODS, Condition("linear", "countdown"), across_tasks.WITHOUT_INPUT)
"""Columns of the first table, before that of the method; one without a number is left out."""
CLOCKS = ("constant:500", "chosen", "countdown", "chosen periodic", "constant:0")
"""Of the geometric method, with the chosen ones cross-validated."""
NONE = "\u2013"


def overview(results: Results, families: Families, figures: Sequence[Figure]) -> str:
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
    parts = [sentences(results, families), *main, _method_head(results, columns), *lines, "\n", _clock_table(results)]
    return "## Result\n\n" + "".join(parts)


def _method_head(results: Results, columns: Sequence[Condition]) -> str:
    steps = wording.whole(float(results.grid.steps))
    names = " | ".join(words.condition(each) for each in columns)
    what = (
        f"Mean return of {steps} steps on test start states. In brackets: gain; share of episodes that failed; "
        "training runs x start states. *Gain*: return minus that of an idle robot in the same steps, as a share of a "
        "published policy's over all steps: 0 for a robot that falls at once, less for one that stands worse than an "
        "idle robot. *Failed*: fell, diverged, never worked (counted from step 0), or ended with less than three "
        "quarters of the gain over an idle robot that it had in training (*decays* and *fails silently*). Runs that "
        'cannot be judged are left out of that share ("of 2": of two runs). Most runs either fail early or keep nearly '
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
    known = f" of {len(failed)}" if 0 < len(failed) < len(returns) else ""
    return f"{wording.quantity(fmean(returns.values()))} ({shown}{_share(failed)}{known}; {len(returns)} x {states})"


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
