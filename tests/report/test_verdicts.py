"""What is said of disturbed episodes, of failures per hour and of the next step."""

import math
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from perdure.report import summary_text, wording
from perdure.report.estimates import advice, estimate_table, headline
from perdure.report.groups import behave_as_one
from perdure.report.outcomes import SITUATIONS, find_advice, outcomes
from perdure.report.summary import not_holding

HELP = Path(__file__).parents[2] / "docs" / "how-to" / "when-a-policy-fails.md"
HOUR = {"disturbance": "standard-1", "step_seconds": 3.6, "rate": 2.0}
"""A thousand steps an hour."""
EARLY, LATE = [90] * 7 + [91], [2000] * 7 + [2001]


def groups(table):
    return estimate_table(table)["Hopper-v3"]


def hours(synthetic, ends, **more):
    return synthetic([HOUR | {"ends": ends} | more], episodes=len(ends), recorded=(100, 1000, 2000, 4000))


class TestHours:
    def test_five_failures_in_twenty_hours(self, synthetic):
        """Five times 2.4 h and twice 4 h."""
        (item,) = groups(hours(synthetic, [2400] * 5 + [math.inf] * 2))
        assert (item.group.failure_rate.events, item.group.failure_rate.exposure_hours) == (5, pytest.approx(20.0))
        assert item.verdict.sentence.endswith(
            "; falls 5 times in 20 h (mean time between failures 4.0 h, at least 1.9 h, one-sided 95 %)."
        )

    def test_no_failure_has_a_bound_too(self, synthetic):
        (item,) = groups(hours(synthetic, [math.inf] * 5))
        assert "no failure in 20 h (mean time between failures at least 6.7 h, one-sided 95 %)" in item.verdict.sentence

    def test_hours_begin_after_settling(self, synthetic):
        (item,) = groups(hours(synthetic, [500, 2000, math.inf], settling=1000))
        assert (item.group.failure_rate.events, item.group.failure_rate.exposure_hours) == (1, pytest.approx(1.0 + 3.0))
        assert "; 1 more before they settled, within 1,000 steps" in item.verdict.sentence

    def test_a_failure_rate_that_is_not_constant_is_said_to_be(self, synthetic):
        (item,) = groups(hours(synthetic, [100] * 6 + [math.inf] * 4))
        assert "the failure rate is not constant: 6 of 6 in the first half of this time" in item.verdict.sentence

    @pytest.mark.parametrize("change", [{"disturbance": "none"}, {"step_seconds": math.nan}])
    def test_calm_episodes_and_steps_of_unknown_length_have_none(self, synthetic, change):
        (item,) = groups(hours(synthetic, [2000] * 5, **change))
        assert item.group.failure_rate is None

    def test_episodes_that_cannot_be_judged_claim_no_hours_without_a_failure(self, synthetic):
        table = hours(synthetic, [math.inf] * 5, outcome="unknown", window=1000, settling=0)
        (said,) = not_holding(estimate_table(table))
        assert "cannot tell in 5 of 5 episodes" in said
        assert said.endswith("too few steps to tell: at least 5000 are needed")


class TestHeadline:
    def test_a_policy_that_falls_when_calm_and_disturbed_has_one_clause(self, synthetic):
        falls = {"clock": "none", "rate": 2.0, "ends": [5000] * 8}
        table = pl.concat([synthetic([falls]), synthetic([falls | {"disturbance": "push:0.5", "ends": [2000] * 8}])])
        said = "when calm falls in 8 of 8 episodes; under push:0.5 half of the episodes fail by step 2,000"
        assert summary_text(table).splitlines()[0] == f"Hopper-v3: geometric: {said}"

    def test_two_policies_have_two(self, synthetic):
        methods = [{"clock": "none", "method": name, "rate": 2.0} for name in ("ppo", "linear")]
        ends = {"disturbance": "standard-1", "ends": [2000] * 3 + [math.inf] * 5}
        table = pl.concat([synthetic(methods), synthetic([methods[0] | ends])])
        assert summary_text(table).splitlines()[0] == (
            "Hopper-v3: ppo: holds when calm, under standard-1 falls in 3 of 8 episodes; "
            "linear: holds for 100,000 steps, but met few disturbances"
        )

    def test_many_are_counted_calm_and_disturbed(self, synthetic):
        clocks = [{"clock": f"constant({c})", "rate": 2.0} for c in range(7)]
        table = pl.concat([synthetic(clocks), synthetic([each | HOUR | {"ends": [2000] * 8} for each in clocks])])
        assert headline([item.verdict for item in groups(table)]) == (
            "Hopper-v3: 7 policies and clocks: holds 7; under standard-1 falls 7"
        )


class TestNext:
    def test_every_verdict_has_a_next_step_and_a_section(self):
        headings = re.findall(r"^## (.*)$", HELP.read_text(), re.MULTILINE)
        anchors = {re.sub(r"[^a-z0-9 -]", "", each.lower()).replace(" ", "-") for each in headings}
        known = [each.advice for each in outcomes()] + list(SITUATIONS.values())
        assert {each.section for each in known} <= anchors

    @pytest.mark.parametrize(
        ("calm", "disturbed", "kind"),
        [
            ({}, {}, "holds"),
            ({}, {"ends": LATE}, "fails when disturbed"),
            ({"ends": LATE}, {"ends": LATE}, "falls"),
            ({"ends": LATE[:1] * 8}, {}, "ends at one step"),
            ({"ends": LATE[:1] * 8, "reason": "truncated"}, {}, "cut"),
            ({"ends": EARLY}, {"ends": EARLY}, "falls in training"),
            ({"last_rate": 0.0}, {}, "fails silently"),
        ],
    )
    def test_the_calm_failure_comes_first(self, synthetic, calm, disturbed, kind):
        alone = {"clock": "none", "rate": 2.0}
        table = pl.concat([synthetic([alone | calm]), synthetic([alone | {"disturbance": "standard-1"} | disturbed])])
        sentence, where = advice([item.verdict for item in groups(table)])
        assert (sentence, where.split("#")[1]) == find_advice(kind)


def test_robots_of_contracts_have_no_time_limit(synthetic):
    table = synthetic([{"clock": "none", "ends": [3] * 8}])
    (verdict,) = (item.verdict for item in groups(table))
    (walking,) = (item.verdict for item in groups(table.with_columns(heading_error=1.0)))
    assert ("time limit" in verdict.sentence, "time limit" in walking.sentence) == (True, False)
    assert (verdict.kind, walking.kind) == ("ends at one step", "falls in training")


def test_a_policy_that_falls_in_training_has_no_score_against_a_published_one(synthetic):
    """Its reward per step lasts for 218 steps only."""
    falling = {"rate": 5.2, "ends": [218] * 8, "training_falls": 1.0}
    assert "training vs published" not in summary_text(synthetic([falling]))
    columns = summary_text(synthetic([falling, {"clock": "constant(9)", "rate": 5.2}])).splitlines()[-3:]
    at = columns[0].index("training vs published")
    assert [row[at:].split()[0] == "\u2013" for row in columns[1:]] == [False, True]


@pytest.mark.parametrize(("apart", "alike"), [(0.019, True), (0.021, False)])
def test_start_states_behave_as_one_up_to_a_hundredth_of_the_gain(apart, alike):
    """Two rates on both sides of their mean: the root mean square is half of the difference; the gain is 1."""
    steps = np.arange(100, 10_001, 100)
    returns = np.array([1.0 - apart / 2, 1.0 + apart / 2])[:, None] * steps
    returns[0] += 500.0  # before settling
    assert behave_as_one(steps, returns, 100, 1.0) == alike
    assert not behave_as_one(steps, returns[:1], 100, 1.0), "one start state is no evidence"


@pytest.mark.parametrize(
    ("hours", "text"), [(20.0, "20 h"), (4.0, "4.0 h"), (0.5, "30 min"), (0.05, "3.0 min"), (0.001, "3.6 s")]
)
def test_durations(hours, text):
    assert wording.duration(hours) == text
