"""The vocabulary of outcomes: what reads it finds everything there."""

import pytest

from perdure.errors import PerdureError
from perdure.report import outcomes as vocabulary
from perdure.report.outcomes import (
    EpisodeOutcome,
    Unknown,
    judging_order,
    outcome,
    outcome_words,
    outcomes,
    verdicts_in_order,
)


def test_every_outcome_has_its_words():
    for each in outcomes():
        assert each.meaning, each.name
        assert each.advice.sentence.endswith(".")
        assert not each.meaning.endswith(".")


def test_no_two_outcomes_have_the_same_place():
    places = [(each.good, each.order) for each in outcomes()]
    assert len(places) == len(set(places))


def test_good_verdicts_come_first_and_words_of_the_table_that_reports_do_not_show_are_left_out():
    assert verdicts_in_order() == [
        *("holds", "reaches its goal"),
        *("falls", "fails silently", "decays", "diverges", "misses its goal", "never worked"),
        "cannot tell",
    ]


def test_a_word_that_is_shown_as_another_names_one_that_reports_show():
    shown = {each.shown_as for each in outcomes() if each.shown_as}
    assert shown == {"cannot tell"}
    assert shown <= set(verdicts_in_order())


def test_rules_of_bad_outcomes_are_tried_first_and_every_episode_has_an_outcome():
    order = judging_order()
    goods = [each.good for each in order]
    assert goods == sorted(goods, key=[False, True, None].index)
    assert isinstance(order[-1], Unknown)
    assert sorted(each.name for each in order) == sorted(outcome_words(in_table=True))


def test_an_unknown_word_gives_the_nearest_one():
    with pytest.raises(PerdureError, match=r"no outcome is named 'fall'.*did you mean 'falls'"):
        outcome("fall")


def test_the_documentation_has_a_row_for_every_outcome():
    own = [kind for kind in EpisodeOutcome.kinds().values() if kind.__module__ == vocabulary.__name__]
    rows = [line for line in (vocabulary.__doc__ or "").splitlines() if line.startswith("| ")][1:]
    assert sorted(row.split(" | ")[0].removeprefix("| ") for row in rows) == sorted(kind.name for kind in own)
