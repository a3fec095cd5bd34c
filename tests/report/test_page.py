"""The page: what it says about tables whose truth is known, what it lets run, and whether a browser draws it."""

import base64
import hashlib
import html
import json
import math
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from specs import by_label, notes, rows, specs

from perdure.errors import PerdureError
from perdure.horizon import Clock
from perdure.report import summary_text, write_report
from perdure.report.estimates import estimate_table
from perdure.report.figures import make_figures
from perdure.report.groups import make_groups
from perdure.report.page import PAGE

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorials" / "does-my-sb3-agent-hold.md"
FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-quic --window-size=1600,1000 "
    "--virtual-time-budget=8000 --enable-logging=stderr --v=0 --dump-dom"
)


def half_fall(synthetic, **more):
    """Eight episodes earn 2 a step; four of them fall at step 500, four last for 100,000."""
    return synthetic([{"clock": "constant(500)", "rate": 2.0, "ends": [500] * 4 + [math.inf] * 4} | more])


class TestWhatItSays:
    def test_each_policy_and_clock_gets_a_verdict_with_its_evidence(self, synthetic):
        lines = summary_text(half_fall(synthetic)).splitlines()
        assert lines[0] == "Hopper-v3: geometric, always 500 steps to go: falls in 4 of 8 episodes"
        assert lines[1].strip() == "geometric, always 500 steps to go: falls in 4 of 8 episodes; at step 500."

    def test_a_robot_that_stood_idle_before_it_fell_is_said_to(self, synthetic):
        idle = synthetic([{"rate": 2.0, "ends": [9970] * 4 + [9990] * 4, "failed_step": 0}])
        said = "geometric, always 500 steps to go: idle from the start; all 8 fall at steps 9,970 to 9,990"
        assert summary_text(idle).splitlines()[:2] == [f"Hopper-v3: {said}", f"  {said}."]

    @pytest.mark.parametrize(
        ("state", "outcome", "reason"),
        [
            ("worked", "cut", "the environment truncates episodes at step 100000: remove its counter"),
            ("worked", "unknown", "a final score too close to 75 % to tell"),
            ("cannot tell", "unknown", "within its training horizon it earns more"),
        ],
    )
    def test_it_says_why_it_cannot_tell(self, synthetic, state, outcome, reason):
        table = synthetic([{"clock": "none", "outcome": outcome, "policy_state": state}])
        assert (
            summary_text(table)
            .splitlines()[1]
            .endswith(f"cannot tell in 8 of 8 episodes: all 8 move until the end; {reason}.")
        )

    @pytest.mark.parametrize(("window", "short"), [(20_000, False), (20_001, True)])
    def test_it_says_how_many_steps_are_needed(self, synthetic, window, short):
        """Episodes of 100,000 steps; five windows and no settling."""
        table = synthetic([{"outcome": "unknown", "window": window, "settling": 0}])
        assert ("too few steps to tell: at least 100005 are needed" in summary_text(table)) is short

    def test_the_headline_of_several_conditions_gives_no_details_of_what_it_cannot_tell(self, synthetic):
        table = synthetic([{"outcome": "unknown", "disturbance": each} for each in ("none", "push:1")])
        said = "geometric, always 500 steps to go: cannot tell when calm; cannot tell under push:1"
        assert summary_text(table).splitlines()[0] == f"Hopper-v3: {said}"

    def test_the_tutorial_shows_the_sentence_that_is_printed(self, synthetic):
        (transcript,) = re.findall(r"^```text\n(.*?)^```", TUTORIAL.read_text(), re.MULTILINE | re.DOTALL)
        printed = summary_text(synthetic([{"clock": "none", "spread": 0.3}])).splitlines()[1]
        shown, said = (
            re.sub(r"[\d,]+", "#", line.partition(": ")[2]) for line in (transcript.splitlines()[1], printed)
        )
        assert shown == said

    def test_the_table_gives_the_mean_return_and_the_verdicts(self, synthetic):
        # (4 episodes x 500 steps + 4 episodes x 100,000 steps) x 2 / 8 episodes = 100,500
        assert "100,500" in summary_text(half_fall(synthetic))
        assert re.search(r"falls 4, holds 4|holds 4, falls 4", summary_text(half_fall(synthetic)))

    def test_it_says_which_training_runs_hold(self, synthetic):
        lasting, falling = {"rate": 2.0}, {"rate": 2.0, "ends": [500] * 8}
        runs = [(0, lasting), (1, falling), (2, falling), (3, lasting)]
        table = pl.concat([synthetic([case], train_seeds=(seed,)) for seed, case in runs])
        assert summary_text(table).splitlines()[1].endswith(" By training seed: holds 0, 3; falls 1, 2.")
        many = pl.concat([synthetic([runs[seed % 4][1]], train_seeds=(seed,)) for seed in range(24)])
        assert summary_text(many).splitlines()[1].endswith(" By training seed: holds 12 of 24; falls 12 of 24.")
        assert "training seed" not in summary_text(synthetic([falling]))

    def test_the_page_lists_training_runs(self, synthetic, tmp_path):
        table = pl.concat([synthetic([{"rate": seed + 1.0}], train_seeds=(seed,)) for seed in (0, 1)])
        text = re.sub(r"<[^>]+>", " ", write_report(table, tmp_path, "", formats=()).read_text())
        row = r"constant\(500\)\s+1\s+8\s+200,000\s+holds\s+[\d.]+\s+holds 8\s"
        assert re.search(f"Training runs .*{row}", text, re.DOTALL)

    def test_the_best_clock_holds_first_and_earns_second(self, synthetic):
        falling = {"clock": "constant(0)", "rate": 9.0, "ends": [90_000] * 8}  # earns most, and falls
        best = {"clock": "constant(500)", "rate": 2.0, "spread": 0.3}
        same = {"clock": "constant(600)", "rate": 2.3, "spread": 0.3}
        worse = {"clock": "constant(700)", "rate": 0.5, "spread": 0.1}
        frame = synthetic([falling, best, same, worse])
        last = summary_text(frame).split("\n\n")[0].splitlines()[-1]
        first, _, other = re.fullmatch(
            r"  Best clock of geometric on these start states: always (\d00) steps to go \(--clocks constant:\1\)\."
            r"( Not distinguishable from it \(share that holds, return; 95 % each\): always (\d00) steps to go\.)"
            r" Confirm it on others \(--first-eval-seed\)\.",
            last,
        ).groups()
        assert {first, other} == {"500", "600"}
        final = frame.filter(pl.col("step") == 100_000).group_by("clock").agg(pl.col("return").mean())
        means = dict(final.rows())
        assert means[f"constant({first})"] > means[f"constant({other})"]

    def test_two_training_runs_do_not_make_clocks_alike(self, synthetic):
        falling = {"clock": "constant(100)", "rate": 1.0, "ends": [300] * 8}
        text = summary_text(synthetic([{"clock": "constant(500)", "rate": 2.0}, falling], train_seeds=(0, 1)))
        assert "Best clock of geometric on these start states: always 500 steps to go" in text
        assert "Not distinguishable" not in text

    def test_a_clock_that_earns_more_and_holds_a_little_less_is_as_good(self, synthetic):
        """18 of 20 against 17 of 20: one episode apart, whatever the verdicts are called; and twice the return."""
        holding = {"clock": "constant(500)", "rate": 2.0, "ends": [math.inf] * 18 + [5000] * 2}
        earning = {"clock": "constant(600)", "rate": 4.0, "ends": [math.inf] * 17 + [5000] * 3}
        worse = {"clock": "constant(700)", "rate": 2.0, "ends": [5000] * 20}
        text = summary_text(synthetic([holding, earning, worse], episodes=20))
        assert "always 500 steps to go (--clocks constant:500). Not distinguishable from it" in text
        assert "95 % each): always 600 steps to go. Confirm" in text

    def test_clocks_on_other_start_states_are_not_paired(self, synthetic, tmp_path):
        one = synthetic([{"clock": "constant(500)", "rate": 2.0}])
        two = synthetic([{"clock": "constant(600)", "rate": 3.0}]).with_columns(pl.col("eval_seed") + 100)
        frame = pl.concat([one, two])
        assert "Best clock" not in summary_text(frame)
        assert "Clocks compared" not in write_report(frame, tmp_path / "none", "x", ()).read_text()
        some = pl.concat([one, two.with_columns(pl.col("eval_seed") - 96)])  # 4 to 11 beside 0 to 7
        page = write_report(some, tmp_path / "some", "x", ()).read_text()
        assert "4 of 4 episodes" in page

    def test_runs_that_agree_have_no_interval_of_width_0(self, synthetic):
        text = summary_text(synthetic([{"rate": 2.0}], train_seeds=(0, 1, 2)))
        assert "24 of 24 episodes (the same share in each of 3 training runs)" in text
        text = summary_text(synthetic([{"rate": 2.0, "ends": [5000] + [math.inf] * 15}], 16, train_seeds=(0, 1)))
        assert "the same share" not in text, "two runs have no interval, whether they agree or not"
        (estimate,) = estimate_table(synthetic([{"rate": 2.0}], train_seeds=(0, 1, 2)))["Hopper-v3"]
        assert np.isnan([estimate.verdict.share.lower, estimate.verdict.share.upper]).all(), "null in the summary"
        ends = [math.inf] * 19 + [5000]  # three times 19 of 20: the bounds differ by 5e-16
        text = summary_text(synthetic([{"rate": 2.0, "ends": ends}], episodes=20, train_seeds=(0, 1, 2)))
        assert "57 of 60 episodes (the same share in each of 3 training runs)" in text

    def test_one_run_that_never_worked_among_others_is_not_no_policy(self, synthetic):
        stands = {"policy_state": "never worked", "outcome": "unknown", "end_score_vs_training": math.nan}
        runs = [synthetic([{"rate": 2.0, **(stands if k == 2 else {})}], 3, (k,)) for k in range(5)]
        first = summary_text(pl.concat(runs)).splitlines()[0]
        assert "never worked in 3 of 15 episodes" in first
        assert "no policy works" not in first

    def test_the_best_of_clocks_that_hold_as_often_earns_most_whatever_the_rounding(self, synthetic):
        """26 of 30 each; the means over three runs differ by 1e-16."""
        tables = []
        for steps, rate, failures in ((100, 1.0, (0, 0, 4)), (500, 1.5, (1, 1, 2))):
            for seed, failed in enumerate(failures):
                ends = [50_000] * failed + [math.inf] * (10 - failed)
                group = {"clock": f"constant({steps})", "rate": rate, "ends": ends}
                tables.append(synthetic([group], 10, (seed,)))
        assert "Best clock of geometric on these start states: always 500 steps" in summary_text(pl.concat(tables))

    def test_nine_of_ten_on_average_holds_whatever_the_rounding(self, synthetic):
        """19 of 20 and 17 of 20: the mean of the shares is 0.8999999999999999."""
        ends = [math.inf] * 19 + [5000]
        first = synthetic([{"rate": 2.0, "ends": ends}], episodes=20, train_seeds=(0,))
        second = synthetic([{"rate": 2.0, "ends": [math.inf] * 17 + [5000] * 3}], episodes=20, train_seeds=(1,))
        assert (
            summary_text(pl.concat([first, second]))
            .splitlines()[0]
            .endswith("holds for 100,000 steps, but met few disturbances")
        )

    def test_a_fall_before_the_first_window_counts_as_0(self, synthetic):
        frame = synthetic([{"rate": 2.0, "ends": [500] * 4 + [math.inf] * 4}])
        assert frame.filter(pl.col("end_step") == 500)["end_score_vs_training"].is_nan().all()
        (estimate,) = estimate_table(frame)["Hopper-v3"]
        assert float(estimate.final_score.estimate) == 0.5

    def test_where_every_step_pays_the_same_no_score_is_named(self, synthetic):
        text = summary_text(synthetic([{"rate": 1.0, "idle_rate": 1.0}]))
        assert "an idle robot earns as much (1.00 a step)." in text
        assert "score against its own training" not in text

    def test_a_best_clock_is_not_named_where_none_holds_or_there_is_one(self, synthetic):
        falls = [{"clock": f"constant({c})", "rate": 2.0, "ends": [500] * 8} for c in (100, 500)]
        assert "No episode of geometric holds under any of 2 clocks." in summary_text(synthetic(falls))
        assert "Best clock" not in summary_text(synthetic([{"clock": "constant(500)", "rate": 2.0}]))

    def test_episodes_that_run_on_for_nothing_fail_silently(self, synthetic):
        silent = synthetic([{"clock": "constant(500)", "rate": 2.0, "last_rate": 0.0, "movement_last": 0.001}])
        lines = summary_text(silent).splitlines()
        assert lines[0].endswith("fails silently in 8 of 8 episodes")
        assert (
            "fails silently in 8 of 8 episodes; since step 90,000; nearly motionless; 8 start states behave as one."
            in lines[1]
        )

    def test_what_a_robot_does_instead_is_said(self, synthetic):
        silent = synthetic([{"rate": 2.0, "last_rate": -1.0, "movement_last": 0.01, "failed_step": 0}])
        assert "; from the start; nearly motionless; earning less than an idle robot; 8 start" in summary_text(silent)

    def test_pauses_of_episodes_that_hold_are_said(self, synthetic):
        assert "8 episodes scored below 0.25 for a while" in summary_text(synthetic([{"rate": 2.0, "ever_idle": True}]))

    def test_a_policy_that_holds_is_said_to_with_its_interval(self, synthetic):
        lines = summary_text(synthetic([{"rate": 2.0, "spread": 0.3}])).splitlines()
        assert lines[0].endswith("holds for 100,000 steps, but met few disturbances")
        assert "8 of 8 episodes (95 % interval 63 % to 100 %)" in lines[1]  # Clopper-Pearson
        assert "score against its own training at the end: 1.00." in lines[1]

    def test_where_nothing_beats_an_idle_robot_this_is_said_first(self, synthetic):
        stands = {"rate": 1.0, "policy_state": "never worked", "outcome": "unknown", "end_score_vs_training": math.nan}
        text = summary_text(synthetic([stands, stands | {"clock": "constant(100)"}]))
        assert text.startswith("Hopper-v3: no policy works, even within its training horizon")
        assert "never worked in 8 of 8 episodes; within its training horizon it earns more" in text

    def test_the_asked_policy_is_judged_and_not_the_best_number(self, synthetic):
        frame = synthetic(
            [
                {"clock": "none", "method": "ppo", "rate": 1.0, "ends": [80, *[90] * 7]},
                {"clock": "constant(900)", "rate": 3.0},
            ]
        )
        assert summary_text(frame).splitlines()[0] == (
            "Hopper-v3: ppo: falls within its own training horizon in 8 of 8 episodes: train longer; "
            "geometric, always 900 steps to go: holds for 100,000 steps, but met few disturbances"
        )

    def test_many_policies_are_counted_by_verdict(self, synthetic):
        holds = [{"clock": f"constant({c})", "rate": 2.0} for c in range(6)]
        falls = [{"clock": f"periodic({c})", "rate": 2.0, "ends": [90] * 8} for c in range(2)]
        assert summary_text(synthetic(holds + falls)).startswith("Hopper-v3: 8 policies and clocks: holds 6, falls 2")

    def test_what_the_text_leaves_out_is_counted(self, synthetic):
        clocks = [{"clock": f"constant({c})", "rate": 2.0} for c in range(14)]
        assert "  2 more policies and clocks are in the table." in summary_text(synthetic(clocks))
        assert "more policies" not in summary_text(synthetic(clocks[:12]))

    def test_seven_of_eight_is_not_holding(self, synthetic):
        frame = synthetic([{"rate": 2.0, "ends": [math.inf] * 7 + [900]}])
        assert summary_text(frame).splitlines()[0].endswith(": falls in 1 of 8 episodes")

    def test_clocks_are_compared_on_common_start_states(self, synthetic, tmp_path):
        groups = [{"clock": "constant(100)", "rate": 1.0}, {"clock": "constant(900)", "rate": 3.0}]
        page = write_report(synthetic(groups), tmp_path, "x", ()).read_text()
        (row,) = re.findall(r"<tr><td>geometric</td><td>constant\(900\)</td><td>constant\(100\)</td>.*?</tr>", page)
        assert "<td>200,000</td>" in row
        assert "8 of 8 episodes" in row

    def test_one_training_seed_is_said_to_speak_of_start_states_only(self, synthetic, tmp_path):
        one = write_report(half_fall(synthetic), tmp_path / "one", "x", ()).read_text()
        groups = [{"clock": "constant(500)", "rate": 2.0, "ends": [500] * 4 + [math.inf] * 4}]
        three = write_report(synthetic(groups, train_seeds=(0, 1, 2)), tmp_path / "three", "x").read_text()
        assert "Intervals over evaluation seeds only" in one
        assert "Intervals over training seeds" in three

    def test_the_same_table_gives_the_same_page(self, synthetic, tmp_path):
        pages = [write_report(half_fall(synthetic), tmp_path / name, "x", ()).read_bytes() for name in "ab"]
        assert pages[0] == pages[1]

    def test_a_frame_of_another_kind_is_refused(self, synthetic, tmp_path):
        with pytest.raises(PerdureError, match="missing columns"):
            write_report(half_fall(synthetic).drop("clock"), tmp_path, "x")
        assert not (tmp_path / PAGE).exists()


def both(frame):
    """All figures of a report, those at the top of its page first."""
    top, others = make_figures(estimate_table(frame)["Hopper-v3"])
    return [*top, *others]


def looks(spec):
    """Color and dash pattern of the line of a figure."""
    (line,) = (each["encoding"] for each in spec["layer"] if each["mark"]["type"] == "line")
    return [line[name]["scale"]["range"] for name in ("color", "strokeDash")]


def drawn(frame):
    """The specifications of a report's figures, by the figure's name without its task, and their notes."""
    figures = {each.name.removeprefix("hopper-v3-"): each for each in both(frame)}
    return [{name: getattr(each, what) for name, each in figures.items()} for what in ("spec", "note")]


def disturbed(frame, label="push:0.5"):
    return frame.with_columns(disturbance=pl.lit(label))


class TestFigures:
    def test_return_over_a_logarithmic_axis_is_per_step(self, synthetic):
        found, _ = drawn(half_fall(synthetic))
        (values,) = by_label(found["reward"], "line").values()
        # 2 a step while all run; from step 500 half of the episodes earn nothing: (4 * 500 + 4 * s) * 2 / 8 / s.
        assert values[:4] == pytest.approx([2.0, 2.0, 2.0, 1.5])
        assert values[-1] == pytest.approx(1.005)

    def test_failures_are_counted_among_the_episodes_still_watched(self, synthetic):
        """Kaplan and Meier: 1 of 4 fails at 100, one is cut at 200, 1 of the 2 left fails at 300."""
        episodes = [{"ends": [100]}, {"ends": [200], "reason": "truncated"}, {"ends": [300]}, {"ends": [math.inf]}]
        frame = pl.concat(
            [synthetic([episode], episodes=1).with_columns(eval_seed=pl.lit(k)) for k, episode in enumerate(episodes)]
        )
        (group,) = make_groups(frame.with_columns(pl.col("eval_seed").cast(pl.Int64)))
        at = dict(zip(group.steps.tolist(), group.working.tolist(), strict=True))
        assert (at[100], at[200], at[500], at[100_000]) == pytest.approx((0.75, 0.75, 0.375, 0.375))
        (estimate,) = estimate_table(frame.with_columns(pl.col("eval_seed").cast(pl.Int64)))["Hopper-v3"]
        bounds = dict(zip(estimate.steps.tolist(), np.isfinite(estimate.working.lower).tolist(), strict=True))
        assert (bounds[100], bounds[200], bounds[100_000]) == (True, False, False), "no interval once one is cut"

    def test_survival_falls_at_the_exact_steps_of_the_failures(self, synthetic):
        """The recorded steps are 100, 200, 500, 1,000, ...; failures at 137 (twice) and 4,321 lie between them."""
        found, text = drawn(synthetic([{"rate": 2.0, "ends": [137, 137, 4321] + [math.inf] * 5}]))
        assert [(row["x"], row["y"]) for row in rows(found["working"], "line")] == [
            *((100.0, 1.0), (137.0, 0.75), (4321.0, 0.625), (100_000.0, 0.625), (100_000.0, 0.625))
        ]
        (bar,) = rows(found["working"], "rule", size=1.6)
        assert (bar["lower"], bar["upper"]) == pytest.approx((0.2449, 0.9148), abs=1e-4)  # Clopper-Pearson, 5 of 8
        assert "(Clopper-Pearson) over n = 8 start states, from one training run" in text["working"]

    def test_the_number_at_risk_is_under_the_marks_of_the_axis(self, synthetic):
        found, _ = drawn(synthetic([{"rate": 2.0, "ends": [100, 137, 4321] + [math.inf] * 5}]))
        at_risk = {row["x"]: row["text"] for row in rows(found["working"], "text") if "x" in row and "label" in row}
        assert {at: at_risk[at] for at in (100.0, 1e3, 1e4)} == {100.0: "8", 1e3: "6", 1e4: "5"}

    def test_a_robot_that_fails_from_the_start_has_a_curve(self, synthetic):
        frame = synthetic([{"rate": 2.0, "ends": [9970] * 8, "failed_step": 0}])
        found, _ = drawn(frame)
        assert [(row["x"], row["y"]) for row in rows(found["working"], "line")] == [(1.0, 1.0), (1.0, 0.0), (1e5, 0.0)]

    def test_calm_and_disturbed_episodes_of_other_lengths_are_two_figures_of_one_color(self, synthetic):
        short = synthetic([{"rate": 2.0, "ends": [300] * 8}], recorded=(50, 500, 10_000))
        estimates = [*estimate_table(half_fall(synthetic))["Hopper-v3"], *estimate_table(disturbed(short))["Hopper-v3"]]
        top, others = make_figures(estimates)
        assert [each.title for each in top[:2]] == [
            *("Episodes that have not failed: calm", "Episodes that have not failed: under push:0.5")
        ]
        ends = [each.spec["layer"][0]["encoding"]["x"]["scale"]["domain"] for each in top[:2]]
        assert ends == [[100.0, 100_000.0], [100.0, 10_000.0]]
        colors, dashes = zip(*(looks(each.spec) for each in top[:2]), strict=True)
        assert colors[0] == colors[1]
        assert dashes[0] != dashes[1]
        assert {each.title for each in others} >= {
            "Reward per step so far: calm",
            "Reward per step so far: under push:0.5",
        }

    def test_the_plane_has_a_point_for_each_run_and_condition(self, synthetic):
        """402,000 steps with 4 failures (4 x 500 and 4 x 100,000), and 8 x 200 steps with 8."""
        calm = half_fall(synthetic)
        rough = disturbed(synthetic([{"rate": 1.5, "ends": [200] * 8}]))
        found, _ = drawn(pl.concat([calm, rough]))
        assert [(row["label"], row["x"], row["y"]) for row in rows(found["plane"], "point", opacity=1)] == [
            ("geometric, always 500 steps to go: 50 % hold", 100_500.0, 2.0),
            ("geometric under push:0.5, always 500 steps to go: 0 % hold", 200.0, 1.5),
        ]
        assert "plane" not in drawn(calm)[0]

    def test_a_run_without_a_failure_is_marked_in_the_plane(self, synthetic):
        found, _ = drawn(synthetic([{"rate": 2.0}], train_seeds=(0, 1)))
        assert [row["x"] for row in rows(found["plane"], "text") if row.get("text") == "\u2192"] == [800_000.0] * 2
        silent = (pl.col("train_seed") == 0) & (pl.col("eval_seed") < 4)
        some = synthetic([{"rate": 2.0}], train_seeds=(0, 1)).with_columns(
            outcome=pl.when(silent).then(pl.lit("fails silently")).otherwise("outcome"),
            failed_step=pl.when(silent).then(0).otherwise("failed_step"),
        )
        plane = drawn(some)[0]["plane"]
        assert [row["x"] for row in rows(plane, "text") if row.get("text") == "\u2192"] == [800_000.0]
        assert sorted(row["x"] for row in rows(plane, "point", opacity=1)) == [100_000.0, 800_000.0]

    def test_scores_a_little_below_zero_are_drawn(self, synthetic):
        found, _ = drawn(synthetic([{"rate": 2.0, "end_score_vs_training": -0.004}]))
        low, high = found["score"]["layer"][0]["encoding"]["x"]["scale"]["domain"]
        assert low <= -0.004
        assert high >= 1.0

    def test_two_episodes_give_thin_lines_and_no_band(self, synthetic):
        groups = [{"rate": 2.0, "spread": 0.5}]
        two, note = drawn(synthetic(groups, episodes=2))
        three, _ = drawn(synthetic(groups, episodes=3))
        assert rows(two["reward"], "area") == []
        assert {row["member"] for row in rows(two["reward"], "line", size=0.9)} == {0, 1}
        assert rows(two["working"], "rule", size=2.6) == []
        assert rows(two["score"], "rule") == []
        assert "No interval where n is less than 3. Thin lines" in note["reward"]
        assert len(rows(three["reward"], "area")) == 10
        assert rows(three["reward"], "line", size=0.9) == []

    def test_labels_are_words_with_n(self, synthetic):
        clocks = ["constant(500)", "periodic(500)", "countdown(100000)", "none"]
        found, _ = drawn(synthetic([{"clock": clock} for clock in clocks]))
        assert set(by_label(found["reward"], "line")) == {
            *("geometric, always 500 steps to go", "geometric, countdown from 500, repeated"),
            *("geometric, countdown from 100,000", "geometric"),
        }
        assert "(n = 8 episodes each)" in json.dumps(found["reward"])
        assert {row["row"] for row in rows(found["score"], "point")} >= {"geometric (n = 8)"}

    def test_two_values_of_c_are_not_joined(self, synthetic):
        some = [{"clock": f"constant({c})", "rate": 1.0 + c, "spread": 0.1} for c in (0, 1, 2)]
        two, _ = drawn(synthetic(some[:2]))
        three, _ = drawn(synthetic(some))
        assert rows(two["return-against-c"], "line") == []
        assert [row["x"] for row in rows(two["return-against-c"], "point", opacity=1)] == [0.0, 1.0]
        assert [row["x"] for row in rows(three["return-against-c"], "line")] == [0.0, 1.0, 2.0]
        endless, _ = drawn(synthetic([*some, {"clock": "constant(inf)"}]))
        assert [row["x"] for row in rows(endless["return-against-c"], "line")] == [0.0, 1.0, 2.0]

    def test_the_training_horizon_is_marked_where_it_is_on_the_axis(self, synthetic):
        found, _ = drawn(half_fall(synthetic))
        assert "training horizon, 1,000 steps" in json.dumps(found["reward"])
        for horizon in (math.inf, math.nan, 1e6):
            found, _ = drawn(half_fall(synthetic, train_horizon=horizon))
            assert "training horizon" not in json.dumps(found["reward"])


class TestTheFiles:
    def test_nothing_is_loaded_from_elsewhere(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x", ()).read_text()
        assert len(page) < 1.2e6
        markup = re.sub(r"(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
        assert not re.search(r"<(script|link|img)[^>]+(src|href)=['\"](?!data:)", markup)

    def test_only_the_two_scripts_of_the_page_may_run(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x", ()).read_text()
        policy = html.unescape(re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)[1])
        rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
        scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
        digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts]
        assert rules["default-src"] == "'none'"
        assert rules["script-src"] == " ".join(f"'sha256-{digest}'" for digest in digests)
        assert len(scripts) == 2
        assert page.count("<script") == 2 + 1 + page.count("<figure")  # the others hold JSON

    def test_every_figure_has_a_file_of_its_name(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x", ("png", "svg")).read_text()
        names = re.findall(r"<figure id='([^']+)'", page)
        assert len(names) >= 3
        assert {path.name for path in tmp_path.iterdir()} == {
            PAGE,
            *(f"{name}.{kind}" for name in names for kind in ("png", "svg")),
        }

    def test_the_page_holds_the_specifications_and_notes_of_its_figures(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x", ()).read_text()
        figures = both(half_fall(synthetic))
        assert specs(page) == {each.name: json.loads(json.dumps(each.spec)) for each in figures}
        assert notes(page) == {each.name: each.note for each in figures}

    def test_labels_and_the_command_cannot_bring_in_markup(self, synthetic, tmp_path):
        evil = "</script><script>alert(1)</script>"
        frame = half_fall(synthetic, method=evil, task=evil, clock="<!--<b>")
        page = write_report(frame, tmp_path, evil, ()).read_text()
        assert "alert(1)" in page
        assert evil not in page
        assert "<!--" not in page
        assert all("<" not in text for text in re.findall(r"<script type='application/json'>(.*?)</script>", page))

    def test_a_task_cannot_choose_where_files_go(self, synthetic, tmp_path):
        frame = synthetic([{"task": task} for task in ("../../up", "..-..-up", "/etc/x")])
        write_report(frame, tmp_path / "here" / "out", "x", ("svg",))
        written = [path.relative_to(tmp_path).parts for path in tmp_path.rglob("*.*")]
        assert {parts[:2] for parts in written} == {("here", "out")}
        assert len(written) == 1 + 3 * 3


def browse(page, profile):
    """What Chromium makes of a page: the document after its scripts ran, and what the console says."""
    command = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={profile}", page.as_uri()]
    browser = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    return browser.stdout, [line for line in browser.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
class TestInABrowser:
    def test_plots_are_drawn_and_the_console_is_silent(self, synthetic, tmp_path):
        clocks = [f"constant({c})" for c in range(0, 1001, 100)] + ["countdown(100000)"]
        groups = [{"clock": clock, "hazard": 1e-4, "rate": 1.0, "spread": 0.1} for clock in clocks]
        page = write_report(synthetic(groups), tmp_path, "perdure extrapolate", ())
        shown, console = browse(page, tmp_path / "profile")
        assert shown.count("<figure id=") == shown.count('class="marks"') >= 4
        assert shown.count("always C steps to go") >= 1
        assert console == []
        assert '<p class="cue">' not in shown, "no table scrolls sideways"

    def test_an_injected_script_does_not_run(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x", ())
        text = page.read_text().replace("<main>", "<main><script>document.title = 'in'</script>", 1)
        page.write_text(text)
        shown, console = browse(page, tmp_path / "profile")
        assert "<title>in</title>" not in shown
        assert "Content Security Policy" in console[0]

    def test_a_broken_page_would_be_noticed(self, tmp_path):
        """Negative control."""
        page = tmp_path / "broken.html"
        page.write_text("<script>nothing.there()</script>")
        assert browse(page, tmp_path / "profile")[1]


@pytest.mark.parametrize(
    ("last", "words"), [(0.1, "up to 0.1"), (0.02, "up to 0.02"), (0.0, "at none of these levels")]
)
def test_a_sweep_says_up_to_which_level_nine_in_ten_episodes_hold(synthetic, last, words):
    """Ten episodes each; of those above the last level two end early."""
    table = synthetic(
        [
            {"disturbance": f"action_noise:{level}", "ends": [5000] * 2 * (level > last) + [math.inf] * 10}
            for level in (0.1, 0.02, 0.05)
        ],
        episodes=10,
    )
    sentence = f"nine in ten episodes hold under action_noise {words} (tried: 0.02, 0.05, 0.1)"
    assert f"geometric, always 500 steps to go: {sentence}" in summary_text(table)


def test_factors_below_and_above_1_are_sweeps_of_their_own(synthetic):
    levels = {0.8: 5000, 0.9: 5000, 1.1: math.inf, 1.2: math.inf}
    found = summary_text(
        synthetic([{"disturbance": f"mass:{each}", "ends": [end] * 8} for each, end in levels.items()])
    )
    assert "hold under mass at none of these levels (tried: 0.9, 0.8)" in found
    assert "hold under mass up to 1.2 (tried: 1.1, 1.2)" in found


def test_the_name_of_a_policy_is_told_from_its_disturbances(synthetic):
    names = {"policy": "walks under none", "method": "walks under none"}
    calm, pushed = make_groups(synthetic([names, names | {"disturbance": "push:1"}]))
    assert (calm.policies, calm.line) == ("walks under none", "walks under none")
    assert (pushed.policies, pushed.line) == ("walks under none", "walks under none under push:1")
    assert calm.policy_and_clock == pushed.policy_and_clock == "walks under none, always 500 steps to go"


@dataclass(frozen=True)
class Whole(Clock):
    """A clock of another package that shows the length of the deployment; its steps are no setting."""

    name = "whole-of-a-stranger"
    words = "a deployment of {} steps"
    place = 5
    is_tuned = False
    steps: float

    def time(self, elapsed):
        return 0 * elapsed, self.steps + 0 * elapsed


def test_a_clock_of_another_package_has_its_words_and_its_place(synthetic):
    clocks = ("constant(500)", "countdown(1000)", "whole-of-a-stranger(1000)", "none", "of-a-missing-package(7)")
    groups = make_groups(synthetic([{"clock": clock} for clock in clocks]))
    assert [group.label for group in groups] == [
        "geometric",
        "geometric, a deployment of 1,000 steps",
        "geometric, countdown from 1,000",
        "geometric, always 500 steps to go",
        "geometric, of-a-missing-package 7",
    ]
    assert [group.is_tuned_by_steps for group in groups] == [False, False, False, True, True]


def test_levels_of_a_fault_are_a_sweep_of_their_own(synthetic):
    labels = {"strength:0.9": math.inf, "strength:0.9@500": math.inf, "strength:0.5@500": 5000}
    found = summary_text(synthetic([{"disturbance": label, "ends": [end] * 8} for label, end in labels.items()]))
    assert "hold under strength@500 up to 0.9 (tried: 0.9, 0.5)" in found
    assert found.count("nine in ten") == 1


def test_a_level_without_a_verdict_decides_nothing_in_a_sweep(synthetic):
    def sweep(*outcomes):
        levels = zip((0.1, 0.2, 0.3), outcomes, strict=False)
        return summary_text(
            synthetic([{"disturbance": f"action_noise:{level}", "outcome": outcome} for level, outcome in levels])
        )

    found = sweep("holds", "unknown", "decays")
    assert "hold under action_noise up to 0.1 (tried: 0.1, 0.2 (cannot tell), 0.3)" in found
    assert "nine in ten" not in sweep("unknown", "unknown")


def test_the_page_names_the_policy_file_to_watch_and_how_it_failed(synthetic, tmp_path):
    """A model of another library was imported beside the table."""
    ends = [math.inf] * 3 + [5000] * 5
    table = synthetic([{"clock": "none"}, {"clock": "none", "disturbance": "push:0.5 mass:1.1", "ends": ends}])
    page = write_report(table, tmp_path, "x", ()).read_text()
    words = "--until-failure --steps 100000 --first-eval-seed 3 --disturb push:0.5 mass:1.1 --out failure.mp4"
    assert f"watch POLICY {words}" in page
    without = table.with_columns(not_applied=pl.lit("mass"))
    page = write_report(without, tmp_path, "x", ()).read_text()
    assert "--first-eval-seed 3 --disturb push:0.5 --out failure.mp4" in page
    assert "watch POLICY" not in write_report(table, tmp_path, "x", (), {"command": "of a function"}).read_text()
    why = half_fall(synthetic).with_columns(not_applied=pl.lit("standard-1, because it is discrete"))
    page = write_report(why, tmp_path, "x", ()).read_text()
    assert "watch POLICY --until-failure --steps 100000 --clock constant:500 --disturb none --out failure.mp4" in page
    assert "Not applied: standard-1, because it is discrete." in page
    robot = half_fall(synthetic).with_columns(task=pl.lit("my robot.yaml"))
    page = write_report(robot, tmp_path, "perdure extrapolate a.onnx", ()).read_text()
    assert "watch POLICY --until-failure --env &#39;my robot.yaml&#39; --steps" in page
    assert "watch POLICY --until-failure --steps" in write_report(robot, tmp_path, "x", ()).read_text()
    own = half_fall(synthetic).with_columns(task=pl.lit("gymnasium:my_tasks:Corridor-v0"))
    assert "--until-failure --modules my_tasks --steps" in write_report(own, tmp_path, "x", ()).read_text()
    (tmp_path / "imported").mkdir()
    (model := tmp_path / "imported" / "a.safetensors").touch()
    assert f"perdure watch {model} --until" in write_report(half_fall(synthetic), tmp_path, "x", ()).read_text()
