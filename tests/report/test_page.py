"""The page: what it says about tables whose truth is known, and whether a browser draws it."""

import math
import re
import shutil
import subprocess

import pytest

from perdure.report import ReportError, summary_text, write_report
from perdure.report.page import PAGE

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-quic --virtual-time-budget=8000 --enable-logging=stderr --v=0 --dump-dom"
)


def half_fall(synthetic, **more):
    """Eight lanes earn 2 a step; four of them fall at step 500, four last for 100,000."""
    return synthetic([{"clock": "constant(500)", "rate": 2.0, "ends": [500] * 4 + [math.inf] * 4} | more])


class TestWhatItSays:
    def test_the_verdict_counts_the_lanes_that_still_go(self, synthetic):
        text = summary_text(half_fall(synthetic))
        assert text.startswith("Hopper-v3 · geometric · constant(500): 50 % of 8 lanes still go after 100,000 steps")
        assert "1,000 steps was the training horizon" in text

    def test_the_table_gives_the_mean_return_and_the_reasons(self, synthetic):
        # (4 lanes x 500 steps + 4 lanes x 100,000 steps) x 2 / 8 lanes = 100,500
        assert "100,500" in summary_text(half_fall(synthetic))
        assert re.search(r"4 (terminated|survived), 4 (terminated|survived)", summary_text(half_fall(synthetic)))

    def test_lanes_that_live_on_for_nothing_do_not_go(self, synthetic):
        silent = synthetic([{"clock": "constant(500)", "rate": 2.0, "last_rate": 0.0}])
        assert ": 0 % of 8 lanes still go" in summary_text(silent)

    def test_the_best_group_is_judged(self, synthetic):
        frame = synthetic([{"clock": "constant(100)", "rate": 1.0}, {"clock": "constant(900)", "rate": 3.0}])
        assert "constant(900): 100 % of 8 lanes" in summary_text(frame).splitlines()[0]

    def test_one_training_seed_is_said_to_speak_of_start_states_only(self, synthetic, tmp_path):
        one = write_report(half_fall(synthetic), tmp_path / "one", "x").read_text()
        groups = [{"clock": "constant(500)", "rate": 2.0, "ends": [500] * 4 + [math.inf] * 4}]
        three = write_report(synthetic(groups, train_seeds=(0, 1, 2)), tmp_path / "three", "x").read_text()
        assert "Intervals over evaluation seeds only" in one
        assert "Intervals over training seeds" in three

    def test_the_same_table_gives_the_same_page(self, synthetic, tmp_path):
        pages = [write_report(half_fall(synthetic), tmp_path / name, "x").read_bytes() for name in "ab"]
        assert pages[0] == pages[1]

    def test_a_frame_of_another_kind_is_refused(self, synthetic, tmp_path):
        with pytest.raises(ReportError, match="missing columns"):
            write_report(half_fall(synthetic).drop("clock"), tmp_path, "x")
        assert not (tmp_path / PAGE).exists()


class TestTheFiles:
    def test_nothing_is_loaded_from_elsewhere(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x").read_text()
        assert not re.search(r"<(script|link|img)[^>]+(src|href)=['\"](?!data:)", page)

    def test_every_figure_has_a_png_of_its_name(self, synthetic, tmp_path):
        page = write_report(half_fall(synthetic), tmp_path, "x").read_text()
        names = re.findall(r"<figure id='([^']+)'>", page)
        assert len(names) >= 3
        for name in names:
            assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")

    def test_labels_and_the_command_cannot_bring_in_markup(self, synthetic, tmp_path):
        evil = "</script><script>alert(1)</script>"
        frame = half_fall(synthetic, method=evil, task=evil)
        page = write_report(frame, tmp_path, evil).read_text()
        assert "alert(1)" in page
        assert evil not in page

    def test_infinite_and_unknown_horizons_are_drawn(self, synthetic, tmp_path):
        groups = [{"clock": f"constant({c})", "train_horizon": h} for c, h in ((1, math.inf), (2, math.nan))]
        assert write_report(synthetic(groups), tmp_path, "x").exists()


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
class TestInABrowser:
    def test_plots_are_drawn_and_the_console_is_silent(self, synthetic, tmp_path):
        clocks = [f"constant({c})" for c in range(0, 1001, 100)] + ["countdown(100000)"]
        groups = [{"clock": clock, "hazard": 1e-4, "rate": 1.0, "spread": 0.1} for clock in clocks]
        page = write_report(synthetic(groups), tmp_path, "perdure extrapolate")
        command = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()]
        browser = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True)
        figures = browser.stdout.count("<figure id=")
        assert figures >= 4
        assert browser.stdout.count("js-plotly-plot") >= figures
        assert browser.stdout.count('class="scatterlayer') >= figures
        assert "CONSOLE" not in browser.stderr

    def test_a_broken_page_would_be_noticed(self, tmp_path):
        """Negative control."""
        page = tmp_path / "broken.html"
        page.write_text("<script>nothing.there()</script>")
        command = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()]
        assert "CONSOLE" in subprocess.run(command, capture_output=True, text=True, timeout=100, check=True).stderr
