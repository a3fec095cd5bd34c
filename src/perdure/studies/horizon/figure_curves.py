"""Curves against steps: figure 3-1, figures A-2 and A-3, and the share of episodes that have not failed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.curves import Curve, Marker, curve_chart
from perdure.report.estimates import Estimate
from perdure.report.render import Figure, slug
from perdure.report.theme import Style
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.estimates import estimate_condition, interval_note, reward_curve, working_curve
from perdure.studies.horizon.results import Results

BASELINES = (Condition("ppo"), Condition("ppo-undiscounted"))
OTHERS = (Condition("ppo-average-reward"), Condition("linear", "constant:500"))
SO_FAR = "Return so far, divided by the steps so far; an ended episode earns nothing more."


def training_horizon_figures(results: Results) -> Iterator[Figure]:
    """Draw figure 3-1: trained in episodes of 200 steps, and of 1,000."""
    for setting in results.grid.settings:
        found = _estimates(results, setting, (Condition("ppo-short"), Condition("ppo")))
        if len(found) == 2:
            yield _reward_figure(setting, found, "figure-3-1", "Trained in episodes of 200 steps and of 1,000 steps")


def survival_figures(results: Results) -> Iterator[Figure]:
    """Draw the share of episodes that have not failed, for the thesis' four methods and the average reward."""
    for setting in results.grid.settings:
        found = _estimates(results, setting, (*BASELINES, *OTHERS, results.constant))
        if not found:
            continue
        curves = [working_curve(words.condition(c), e, styles.style(c)) for c, e in found]
        y = Axis(f"share of episodes that have not failed ({_episodes(found)})", percent=True)
        note = (
            "A failure: a fall, a divergence, or to the end less than three quarters of the gain over an idle robot of "
            "the training episodes (Kaplan-Meier). A policy that never worked, or earns too little from its first "
            "window on, has failed from the start. "
            f"{interval_note([e.working for _, e in found], 'Bars at the right')}"
        )
        chart = curve_chart(curves, _steps(found), y, markers=_markers(found), steps=True)
        yield Figure(slug("survival", setting), "Episodes that have not failed", chart, note, words.setting(setting))


def clock_figures(results: Results) -> Iterator[Figure]:
    """Draw figures A-2 and A-3: every C, constant and periodic, with the countdown and the baselines."""
    for kind, name in (("constant", "figure-a-2"), ("periodic", "figure-a-3")):
        for setting in results.grid.settings:
            found = _sweep(results, setting, kind)
            if found:
                yield _clock_figure(results, setting, kind, name, found)


def _sweep(results: Results, setting: str, kind: str) -> list[tuple[float, Estimate]]:
    found = [
        (steps, estimate_condition(results, setting, Condition("geometric", clock)))
        for steps, clock in results.swept(setting, "geometric", kind).items()
    ]
    return [(steps, estimate) for steps, estimate in found if estimate is not None]


def _clock_figure(
    results: Results, setting: str, kind: str, name: str, sweep: Sequence[tuple[float, Estimate]]
) -> Figure:
    highest = max(steps for steps, _ in sweep) or 1.0
    curves = [
        reward_curve(f"C = {wording.whole(steps)}", estimate, theme.ordered_style(steps / highest), bands=False)
        for steps, estimate in sweep
    ]
    others = _estimates(results, setting, (Condition("geometric", "countdown"), *BASELINES))
    curves += [reward_curve(_short(c), e, _ink(k), bands=False) for k, (c, e) in enumerate(others)]
    shown = [(Condition("geometric"), estimate) for _, estimate in sweep] + others
    return Figure(
        slug(name, setting),
        f"Geometric time-to-go, {wording.clock(kind, 'C')}",
        curve_chart(curves, _steps(shown), _reward_axis(shown), markers=_markers(shown)),
        f"{SO_FAR} {interval_note([e.returns for _, e in shown], 'Bars at the right')}",
        words.setting(setting),
    )


def _reward_figure(setting: str, found: Sequence[tuple[Condition, Estimate]], name: str, title: str) -> Figure:
    curves: list[Curve] = [reward_curve(words.condition(c), e, styles.style(c)) for c, e in found]
    return Figure(
        slug(name, setting),
        title,
        curve_chart(curves, _steps(found), _reward_axis(found), markers=_markers(found)),
        f"{SO_FAR} {interval_note([e.returns for _, e in found], 'Bands')}",
        words.setting(setting),
    )


def _estimates(results: Results, setting: str, conditions: Sequence[Condition]) -> list[tuple[Condition, Estimate]]:
    found = [(condition, estimate_condition(results, setting, condition)) for condition in conditions]
    return [(condition, estimate) for condition, estimate in found if estimate is not None]


def _short(condition: Condition) -> str:
    return "countdown" if condition.clock == "countdown" else words.condition(condition)


def _ink(k: int) -> Style:
    style = theme.style(k + 1)
    return Style(theme.INK, style.dash, style.shape)


def _steps(found: Sequence[tuple[Condition, Estimate]]) -> Axis:
    steps = found[0][1].steps
    return Axis("steps since the reset", log=True, low=float(steps[0]), high=float(steps[-1]))


def _reward_axis(found: Sequence[tuple[Condition, Estimate]]) -> Axis:
    return Axis(f"mean reward per step so far ({_episodes(found)})")


def _episodes(found: Sequence[tuple[Condition, Estimate]]) -> str:
    return wording.sample([estimate.group.lanes for _, estimate in found], "episode")


def _markers(found: Sequence[tuple[Condition, Estimate]]) -> tuple[Marker, ...]:
    low, high = float(found[0][1].steps[0]), float(found[0][1].steps[-1])
    horizons = sorted({e.group.train_horizon for _, e in found if low < e.group.train_horizon < high})
    return tuple(Marker(at, f"longest training horizon, {wording.whole(at)} steps") for at in horizons)
