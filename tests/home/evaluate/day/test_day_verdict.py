"""Verdicts on days, on tables whose answer is known because they were made so, each with a day that is not so."""

import math

import polars as pl
import pytest
from home_days import make_day

from perdure.home.evaluate.day_page import make_tables, make_views, summary, write_page
from perdure.home.evaluate.day_table import to_frame
from perdure.home.evaluate.day_verdict import (
    HomeOutcome,
    failure_times,
    home_outcomes,
    intervention_rate,
    interventions,
    judge_days,
)
from perdure.report.outcomes import COLORS, outcome_words


def verdict(rows, **options):
    return judge_days(to_frame(rows), **options)["verdict"].item()


def failing(*numbers):
    return {number: {"stays": False} for number in numbers}


@pytest.mark.parametrize(
    ("word", "rows"),
    [
        ("holds", make_day()),
        ("holds", make_day(changes=failing(2, 7))),
        # From all to one in five: 5 of C(10, 6) = 210 ways, p = 0.024. To two in five p = 0.083: chance.
        ("decays", make_day(10, failing(6, 7, 8, 9))),
        ("holds", make_day(10, failing(6, 7, 8))),
        ("holds", make_day(10, failing(1, 3))),
        ("never worked", make_day(10, failing(*range(1, 11)))),
        ("never worked", make_day(8, failing(1, 2, 3))),
        ("holds", make_day(8, failing(1, 2))),
        ("fails silently", make_day(8, {8: {"on_floor": 1, "fell": 1}})),
        ("fails silently", make_day(8, {8: {"tipped": 1, "knocked_over": 1}})),
        ("fails silently", make_day(8, {8: {"out_of_reach": 1}})),
        ("holds", make_day(8, {8: {"doors_open": 1}})),
        ("decays", make_day(10, {**failing(6, 7, 8, 9), 10: {"on_floor": 1, "stays": False}})),
        ("needs help", make_day(8, {3: {"taken_over": 1}})),
        ("needs help", make_day(8, {3: {"tipped_targets": 1, "tipped": 1}})),
        ("needs help", make_day(8, {3: {"stood": 30.0}})),
        ("holds", make_day(8, {3: {"stood": 29.9}})),
        ("no errand left", make_day(3, last="no errand left")),
        ("no errand left", make_day(8, {8: {"on_floor": 21}}, last="no errand left")),
        ("diverges", make_day(8, last="diverged")),
        ("cannot tell", make_day(3)),
    ],
)
def test_a_home_gets_its_word(word, rows):
    assert verdict(rows) == word


def test_a_verdict_by_the_hour_sees_only_what_was_done_by_then():
    rows = make_day(10, {9: {"fell": 1, "on_floor": 1}, 10: {"on_floor": 1}})
    assert verdict(rows, until=0.85) == "holds"
    assert verdict(rows, until=0.95) == "fails silently"
    assert verdict(rows, until=0.35) == "cannot tell"


def test_the_words_are_those_of_policies_and_two_new_ones():
    words = [each.name for each in home_outcomes()]
    assert set(words) - set(outcome_words()) == {"no errand left", "needs help"}
    assert [each.name for each in home_outcomes() if each.good] == ["holds"]
    assert HomeOutcome.kinds()["no errand left"]().page_color == COLORS[False]


def test_interventions_by_kind():
    changes = {2: {"fell": 2}, 3: {"taken_over": 3, "tipped_targets": 1}, 4: {"stood": 31.0}}
    rows = make_day(5, changes, last="no errand left")
    kinds = interventions(to_frame(rows)).sum().row(0, named=True)
    assert kinds == {"taken over": 3, "on the floor": 2, "tipped target": 1, "stuck": 1, "stopped": 1}


def test_hours_between_interventions_have_the_exact_bound():
    """Without an event the bound of Garwood is hours / -ln 0.05; with one, hours / 4.7439."""
    quiet = to_frame(make_day(10))
    rate = intervention_rate(quiet)
    assert (rate.events, rate.exposure_hours) == (0, pytest.approx(1.0))
    assert 1.0 / rate.upper == pytest.approx(1.0 / -math.log(0.05))
    one = intervention_rate(to_frame(make_day(10, {9: {"fell": 1}})))
    assert (one.events, one.early, one.mean_hours) == (1, 0, pytest.approx(1.0))
    assert 1.0 / one.upper == pytest.approx(1.0 / 4.7439, rel=1e-4)
    assert intervention_rate(to_frame(make_day(10, {9: {"fell": 1}})), "stuck").events == 0


def test_exposure_ends_with_the_day_of_each_home():
    """Home 0 is watched for 1 h, home 1 for 0.2 h: half of the exposure is over at 0.4 h."""
    rows = make_day(10, {3: {"fell": 1}, 5: {"fell": 1}}) + make_day(2, last="no errand left", home=1)
    rate = intervention_rate(to_frame(rows))
    assert (rate.events, rate.early) == (3, 2)
    assert rate.exposure_hours == pytest.approx(1.2)
    times, failed = failure_times(judge_days(to_frame(rows)))
    assert times.tolist() == pytest.approx([0.3, 0.2])
    assert failed.tolist() == [True, True]
    times, failed = failure_times(judge_days(to_frame(make_day(10))))
    assert (times.tolist(), failed.tolist()) == ([pytest.approx(1.0)], [False])


@pytest.fixture(scope="module")
def homes():
    """Of three homes one holds, one fails silently, and one has no errand left after four errands."""
    changes = {number: {"on_floor": 1, "fell": int(number == 5)} for number in range(5, 13)}
    rows = make_day(12) + make_day(12, changes, home=1)
    return to_frame(rows + make_day(4, {4: {"on_floor": 21, "fell": 21}}, "no errand left", home=2))


def test_the_page_counts_homes(homes, tmp_path, monkeypatch):
    monkeypatch.setattr("perdure.report.page.javascript", lambda: "")  # it takes seconds
    (view,) = make_views(homes)
    assert view.errands == 12
    floor = view.by_errand(pl.col("on_floor"), ended=None)
    assert floor.shape == (3, 12)
    assert floor[2].tolist() == [0.0] * 3 + [21.0] * 9, "a home whose day ended early counts as it was left"
    assert view.by_errand(pl.col("stays"), ended=0.0)[2].sum() == 4.0
    verdicts, _, kinds, _ = make_tables(view)
    hour, whole = (dict(zip(verdicts.headings, row, strict=True)) for row in verdicts.rows)
    assert (hour["holds"], hour["fails silently"], hour["no errand left"]) == ("1", "1", "1")
    assert whole == {**hour, "after": whole["after"]}
    assert [row[1] for row in kinds.rows] == ["0", "22", "0", "0", "1", "23"]
    assert "1 of 3 homes" in summary(view)
    page = write_page(homes, tmp_path, "asked by a test", formats=()).read_text()
    assert "1 of 3 homes hold" in page
    assert "asked by a test" in page


def test_groups_stand_apart(homes):
    other = homes.with_columns(place=pl.lit("stop"))
    assert [view.homes.height for view in make_views(pl.concat([homes, other]))] == [3, 3]
