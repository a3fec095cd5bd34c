"""The page of the home benchmark: what it says about logs that were made by hand, and whether a browser draws it."""

import json
import math
import re
import shutil
import subprocess

import pytest
from home_pages import figure, figure_note, four, page_of, records, row, table, two_strategies
from home_stories import Story, good
from specs import by_label, rows

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.comparison import describe, describe_kind, describe_stage
from perdure.home.evaluate.files import write_logs
from perdure.home.evaluate.page import PAGE, LogNotes, read_all, write_page
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.objects import KINDS
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.tasks import get_task

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-quic --virtual-time-budget=8000 --enable-logging=stderr --v=0 --dump-dom"
)
LATCHED, STABILIZING = "latched (benchmark)", "goal-stabilizing (thesis)"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """`rl` with one of four that stays and three of four that the benchmark counts, `ik` with four of four."""
    return page_of(two_strategies(), tmp_path_factory.mktemp("page"))


class TestNumbers:
    def test_both_ways_of_counting_are_in_the_table_and_in_the_sentence(self, page):
        found = row(page, "Success", "rl")
        assert (found["episodes"], found["training x evaluation seeds"]) == ("4", "1 x 1")
        assert found[LATCHED].startswith("75.0 % [19.4, ")  # Clopper-Pearson: quantile of beta(3, 2)
        assert found[STABILIZING].startswith("25.0 % [")
        assert row(page, "Success", "ik")[STABILIZING].startswith("100.0 % [")
        assert "every object stayed: open at once 25.0 %; stop, lower 5 cm 100.0 %. The benchmark counts 75.0 %" in page
        assert row(page, "Success", "ik")["in the figures"] == "stop, lower 5 cm"

    def test_successes_that_did_not_last_are_told_apart(self, page):
        assert row(page, "Success", "rl")["counted, did not last"] == "2 of 3"
        assert row(page, "Success", "ik")["counted, did not last"] == "0 of 4"

    def test_failure_modes_have_both_denominators(self, page):
        rows = {(each["counting"], each["first unmet stage"]): each for each in table(page, "Failure modes")}
        assert rows[LATCHED, "place_1"]["rl"] == "1 (25.0 %, 100.0 %)"
        assert rows[LATCHED, "place_1"]["failure cause"] == "not reached"
        stages = [stage for counting, stage in rows if counting == STABILIZING]
        assert stages == ["place_0", "place_1", "place_2"]
        assert {rows[STABILIZING, stage]["rl"] for stage in stages} == {"1 (25.0 %, 33.3 %)"}
        assert {each["ik"] for each in rows.values()} == {"0"}

    def test_strategies_are_compared_on_the_same_episodes(self, page):
        (found,) = table(page, "The same episodes under two release strategies")
        assert list(found.values()) == ["ik against rl", "4", "3", "0", "+75.0 points [-4.6, +100.0]"]
        assert "different episodes" not in page

    def test_strategies_that_ran_other_episodes_are_warned_of(self, tmp_path):
        page = page_of(records("rl", four()) + records("ik", [good(3), good(4)]), tmp_path)
        assert "The strategies ran different episodes (open at once: 4 and stop, lower 5 cm: 2)" in figure_note(
            page, "success"
        )
        (found,) = table(page, "The same episodes under two release strategies")
        assert list(found.values()) == ["ik against rl", "1", "1", "0", "+100.0 points"]

    def test_releases_are_told_in_their_units(self, tmp_path):
        logs = [Story(index=k).go(0, above=0.02, tilt=30.0, way=0.01).rest((1, 2)).log() for k in range(3)]
        calm = row(page_of(records("rl", [good(k) for k in range(3)]), tmp_path / "a"), "At the release", "rl")
        found = row(page_of(records("rl", logs), tmp_path / "b"), "At the release", "rl")
        assert calm["height above rest [mm]"] == found["height above rest [mm]"] == "20 (20 to 20)"
        assert (calm["tilt [deg]"], calm["of the base [m/s]"]) == ("0 (0 to 0)", "0.000 (0.000 to 0.000)")
        # One of three is let go with a tilt of 30 deg by a robot that moves by 0.01 m in 1/30 s.
        assert (found["tilt [deg]"], found["of the base [m/s]"]) == ("0 (0 to 30)", "0.000 (0.000 to 0.300)")

    def test_logs_without_contact_forces_are_named(self, page, tmp_path):
        assert "contact forces" not in figure_note(page, "modes-latched")
        unknown = Story(index=3).go(0).go(1, beside=0.5).go(2)
        unknown.force = math.nan
        for each in unknown.rows:
            each["force"] = math.nan
        note = figure_note(page_of(records("rl", [unknown.log()]), tmp_path), "modes-latched")
        assert "No contact forces in the logs, so no collision among the causes: open at once." in note


class TestRuns:
    def test_several_runs_have_a_standard_error(self, tmp_path):
        logs = records("rl", four(), 100) + records("rl", [good(index) for index in range(4)], 200)
        page = page_of(logs, tmp_path)
        found = row(page, "Success", "rl")
        assert found["training x evaluation seeds"] == "2 x 1"
        # Runs at 3/4 and 4/4: mean 7/8, s = 0.125 sqrt(2), s / sqrt(2) = 0.125.
        assert found[LATCHED].startswith("87.5 +- 12.5 %")
        assert "Bars: none, too few units (n = 2 training seeds)" in figure_note(page, "success")
        assert rows(figure(page, "success"), "rule") == []
        # Each seed as a ring.
        assert sorted(row["x"] for row in rows(figure(page, "success"), "point", filled=False)) == [0.25, 1.0]

    def test_three_runs_have_an_interval(self, tmp_path):
        logs = [each for seed in (1, 2) for each in records("rl", [good(k) for k in range(4)], seed)]
        page = page_of(logs + records("rl", four(), 3), tmp_path)
        assert "95 % intervals over n = 3 training seeds (Student t)" in figure_note(page, "success")
        assert "silent on other seeds" not in page
        # Latched 1, 1, 3/4: 11/12 -+ 4.303 * 0.25 / 3, kept below 1.
        bounds = [(each["low"], each["high"]) for each in rows(figure(page, "success"), "rule")]
        assert bounds[0] == pytest.approx((11 / 12 - 4.3027 / 12, 1.0), abs=1e-4)

    def test_a_single_run_is_not_given_one(self, page):
        assert "+-" not in row(page, "Success", "rl")[LATCHED]
        assert "n = 4 episodes of one training seed, silent on other seeds (Clopper-Pearson)" in figure_note(
            page, "success"
        )
        assert "says nothing about training again" in page

    def test_only_the_strategy_with_one_run_is_named(self, tmp_path):
        logs = records("rl", [good(0)], 1) + records("rl", [good(0)], 2) + records("ik", [good(0)], 1)
        note = figure_note(page_of(logs, tmp_path), "success")
        assert "Bars of stop, lower 5 cm: none, too few units (n = 1 episodes of one training seed)" in note


class TestFigures:
    def test_stages_fall_from_one_to_the_next(self, page):
        curves = by_label(figure(page, "stages"), "line")
        assert curves["open at once: latched"] == [1.0, 1.0, 1.0, 0.75, 0.75, 0.75]
        assert curves["open at once"] == [1.0, 0.75, 0.75, 0.5, 0.5, 0.25]
        assert curves["stop, lower 5 cm"] == [1.0] * 6
        places = dict.fromkeys(each["x"] for each in rows(figure(page, "stages"), "line"))
        assert list(places)[:3] == ["object 1 picked", "object 1 placed", "object 2 picked"]

    def test_outcomes_are_shares_of_all_and_of_the_failed(self, page):
        bars = {(each["row"], each["label"]): each for each in rows(figure(page, "outcomes"), "bar")}
        assert bars["every object stayed", "open at once"]["x"] == 0.25
        assert bars["every object stayed", "stop, lower 5 cm"]["x"] == 1.0
        assert bars["counted as success, but an object left later", "open at once"]["x"] == 0.5
        failed = bars["object 2 did not stay", "open at once"]
        assert failed["text"] == "open at once: 1 of 4 (25 %), 100 % of the failed"
        assert len(bars) == 2 * 3

    def test_kinds_are_counted(self, page):
        episodes = load_episodes("prepare_groceries", "val")
        kinds = [goal.kind for index in range(4) for goal in episodes[index].goals]
        lost = [episodes[1].goals[2].kind, episodes[2].goals[0].kind, episodes[3].goals[1].kind]
        drawn = rows(figure(page, "kinds"), "bar", opacity=0.3)
        found = {each["row"]: (each["end"], each["x"]) for each in drawn if each["label"] == "open at once"}
        assert found == {
            describe_kind(name, KINDS[name].cylinder): (kinds.count(name), lost.count(name)) for name in set(kinds)
        }

    def test_the_share_of_cylinders_is_drawn_and_told(self, page):
        episodes = load_episodes("prepare_groceries", "val")
        cylinders = sum(KINDS[goal.kind].cylinder for index in range(4) for goal in episodes[index].goals)
        assert 0 < cylinders < 12
        bars = {each["row"]: each["x"] for each in rows(figure(page, "cylinders"), "bar")}
        assert bars["open at once: placed (n = 12)"] == pytest.approx(cylinders / 12, abs=1e-6)
        found = row(page, "Placements", "rl")
        assert found["cylinders of all placed"] == f"{100 * cylinders / 12:.1f} %"
        assert found["did not stay"] == "3 of 12 (25.0 %)"

    def test_a_distribution_ends_at_its_greatest_value(self, page):
        spec = figure(page, "release-height")
        shares, heights = by_label(spec, "line"), by_label(spec, "line", "x")
        assert list(shares) == ["open at once", "stop, lower 5 cm"]
        assert (shares["open at once"][0], shares["open at once"][-1]) == (0.0, 1.0)
        reached = [x for x, y in zip(heights["open at once"], shares["open at once"], strict=True) if y == 1.0]
        assert reached[0] == pytest.approx(0.02, abs=1e-4)

    def test_a_task_in_which_nothing_fails_has_no_failure_modes(self, tmp_path):
        page = page_of(records("rl", [good(0)]), tmp_path)
        assert figure(page, "modes-latched") is None
        assert "<h2>Failure modes</h2>" not in page
        assert figure(page_of(two_strategies(), tmp_path), "modes-latched") is not None

    def test_strategies_come_in_the_order_of_what_they_add(self, tmp_path):
        names = ["zebra", "guarded", "ik", "gentle", "delta-50", "stop", "delta-5", "rl"]
        logs = [each for name in names for each in records(name, [good(0)])]
        logs += records("rl", [good(0)], planner="closed", fallback="none")
        logs += records("rl", [good(0)], planner="closed", fallback="oracle")
        logs += records("ik", [good(0)], world="drag only") + records("rl", [good(0)], world="drag only")
        page = page_of(logs, tmp_path)
        expected = [
            "rl",
            "delta-5",
            "delta-50",
            "gentle",
            "stop",
            "ik",
            "guarded",
            "zebra",
            "rl, closed",
            "rl, closed, without fallback",
            "rl, drag only",
            "ik, drag only",
        ]
        assert [each["release strategy"] for each in table(page, "Success")] == expected


class TestWords:
    @pytest.mark.parametrize(
        ("strategy", "expected"),
        [
            (Strategy("rl"), "open at once"),
            (Strategy("ik", "drag only"), "stop, lower 5 cm, drag only"),
            (Strategy("delta-50"), "trained to stay 50 steps"),
            (Strategy("delta-50", "drag only, 480 hz"), "trained to stay 50 steps, drag only, 480 hz"),
            (Strategy("rl", planner="closed", fallback="oracle"), "open at once, planned again after each skill"),
            (Strategy("zebra crossing"), "zebra crossing"),
        ],
    )
    def test_strategies_are_told_in_words(self, strategy, expected):
        assert describe(strategy) == expected

    def test_a_world_that_all_arms_share_is_named_once(self, tmp_path):
        page = page_of(records("rl", four(), world="drag only") + records("ik", four(), world="drag only"), tmp_path)
        assert set(by_label(figure(page, "release-height"), "line")) == {"open at once", "stop, lower 5 cm"}
        assert "PrepareGroceries, val, drag only" in page

    def test_stages_are_told_in_words(self):
        assert tuple(map(describe_stage, get_task("set_table").stages)) == (
            *("drawer opened", "object 1 picked", "object 1 placed", "drawer closed"),
            *("fridge opened", "object 2 picked", "object 2 placed", "fridge closed"),
        )
        assert describe_stage(get_task("set_table").stages[-1], unmet=True) == "fridge not closed"


class TestPolicies:
    def test_an_episode_in_two_files_is_named_with_both(self, tmp_path):
        """As after a trial run of ten episodes and the whole run."""
        for name in ("trial", "whole"):
            (tmp_path / name).mkdir()
            write_logs(tmp_path / name / "logs.parquet", records("rl", [good(0)]), {})
        with pytest.raises(PerdureError, match=r"trial/logs\.parquet and .*whole/logs\.parquet both hold "):
            read_all([tmp_path / "trial" / "logs.parquet", tmp_path / "whole" / "logs.parquet"])

    def test_names_of_folders_set_two_policies_under_one_strategy_side_by_side(self, tmp_path):
        folders, paths = [tmp_path / "a", tmp_path / "ab"], []
        for folder, skill in zip(folders, ("one", "two"), strict=True):
            folder.mkdir()
            logs = records("rl", [good(0)], planner="closed", fallback="oracle")
            paths.append(write_logs(folder / "logs.parquet", logs, {"policies": f'{{"place": "{skill}"}}'}))
        found, notes = read_all(paths, dict(zip(folders, ("mine", "from a paper"), strict=True)))
        assert [log.strategy.name for log in found] == ["rl, closed, mine", "rl, closed, from a paper"]
        assert describe(found[1].strategy) == "open at once, planned again after each skill, from a paper"
        acted = {each["skill"]: each for each in table(page_of(found, tmp_path, "go", notes), "Policies")}["place"]
        assert (acted["rl, closed, mine"], acted["rl, closed, from a paper"]) == ("one", "two")

    def test_notes_of_the_logs_are_shown(self, tmp_path):
        run = {
            "policies": '{"place": "shipped x (SHA-256 12345678)", "pick": "oracle"}',
            "command": "go 1",
        }
        path = write_logs(tmp_path / "a.parquet", records("rl", [good(0)]), run)
        logs, notes = read_all([path])
        page = page_of(logs, tmp_path, "go 2", notes)
        acted = {each["skill"]: each["rl"] for each in table(page, "Policies")}
        assert acted == {"place": "shipped x (SHA-256 12345678)", "pick": "scripted oracle"}
        assert "<pre>go 1</pre>" in page
        assert "<pre>go 2</pre>" in page

    def test_hand_overs_of_several_files_add_up(self, tmp_path):
        counts = [{"done": 2}, {"done": 3, "blocked": 1}]
        notes = [{"hand_overs": json.dumps(each)} for each in counts]
        paths = [write_logs(tmp_path / f"{k}.parquet", records("ik", [good(k)]), notes[k]) for k in range(2)]
        found = read_all(paths)[1].tables["hand_overs"]
        assert dict(found.select("outcome", "count").rows()) == {"done": 5, "blocked": 1}

    @pytest.mark.parametrize("note", ["free text", "7", "[]"])
    def test_a_note_that_names_nobody_is_refused(self, tmp_path, note):
        path = write_logs(tmp_path / "a.parquet", records("rl", [good(0)]), {"policies": note})
        with pytest.raises(PerdureError, match="must be a JSON object"):
            read_all([path])

    def test_nothing_is_made_up(self, tmp_path, page):
        path = write_logs(tmp_path / "a.parquet", records("rl", [good(0)]), {})
        assert read_all([path])[1] == LogNotes()
        assert row(page, "Policies", "every skill")["rl"] == "not recorded"


class TestTheFiles:
    def test_nothing_is_loaded_from_elsewhere(self, page):
        markup = re.sub(r"(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
        assert not re.search(r"<(script|link|img)[^>]+(src|href)=['\"](?!data:)", markup)

    def test_every_figure_has_a_png_of_its_name(self, tmp_path):
        page = page_of(two_strategies(), tmp_path, formats=("png",))
        names = re.findall(r"<figure id='([^']+)'", page)
        assert len(names) == len(set(names)) == 11
        for name in names:
            assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert len(list(tmp_path.iterdir())) == 12

    def test_strategies_and_the_command_cannot_bring_in_markup(self, tmp_path):
        evil = "</script><script>alert(1)</script>"
        page = page_of(records(evil, four()), tmp_path, evil)
        assert "alert(1)" in page
        assert evil not in page

    def test_the_same_logs_give_the_same_page(self, tmp_path):
        pages = [page_of(two_strategies(), tmp_path / name) for name in "ab"]
        assert pages[0] == pages[1]

    def test_a_folder_that_cannot_be_is_refused(self, tmp_path):
        (tmp_path / "file").write_text("in the way")
        with pytest.raises(OSError, match="file"):
            write_page(analyze(records("rl", [good(0)])), tmp_path / "file", "x")


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
def test_a_browser_draws_every_figure_and_complains_of_nothing(tmp_path):
    page_of(two_strategies(), tmp_path)
    command = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={tmp_path / 'profile'}", (tmp_path / PAGE).as_uri()]
    browser = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    figures = browser.stdout.count("<figure id=")
    assert figures == 11
    assert browser.stdout.count('class="marks"') == figures
    assert "CONSOLE" not in browser.stderr
