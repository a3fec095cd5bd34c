"""Chromium runs nothing of what files hold, and draws every figure of their pages."""

import re
import shutil
import subprocess

import pytest
from payloads import PAYLOADS, logs, table

from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.page import read_all, write_page
from perdure.report import read_table, write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --disable-quic --virtual-time-budget=60000 --enable-logging=stderr --v=0 --dump-dom"
)
pytestmark = [pytest.mark.verify, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]
AT_ONCE = 8
"""Payloads in one page: each is a curve in every figure."""
GROUPS = [PAYLOADS[k : k + AT_ONCE] for k in range(0, len(PAYLOADS), AT_ONCE)]


def browse(page, profile):
    """The page as the browser leaves it, and what it says on its console."""
    command = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={profile}", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def check(page, profile):
    shown, console = browse(page, profile)
    assert "<title>owned</title>" not in shown
    assert console == []
    figures = shown.count("<figure ")
    assert figures == page.read_text(encoding="utf-8").count("<figure ") > 3
    assert len(re.findall(r"<figure [^>]*>.*?<svg.*?</figure>", shown, re.DOTALL)) == figures


@pytest.mark.parametrize("payloads", GROUPS, ids=range(len(GROUPS)))
def test_a_table_of_payloads_runs_nothing_and_is_drawn(tmp_path, payloads):
    frame, notes = read_table(table(tmp_path / "episodes.parquet", payloads=payloads))
    check(write_report(frame, tmp_path / "page", notes["command"], ()), tmp_path / "profile")


@pytest.mark.parametrize("payloads", GROUPS, ids=range(len(GROUPS)))
def test_logs_of_payloads_run_nothing_and_are_drawn(tmp_path, payloads):
    records, cast = read_all([logs(tmp_path / "logs.parquet", payloads=payloads)])
    check(write_page(analyze(records), tmp_path / "page", "x", cast, ()), tmp_path / "profile")


@pytest.mark.parametrize("text", PAYLOADS, ids=range(len(PAYLOADS)))
def test_tasks_and_splits_of_payloads_run_nothing(tmp_path, text):
    frame, _ = read_table(table(tmp_path / "episodes.parquet", payloads=(text,), tasks=(text,)))
    check(write_report(frame, tmp_path / "page", text, ()), tmp_path / "profile")
    records, cast = read_all([logs(tmp_path / "logs.parquet", payloads=(text,), split=text[:50])])
    check(write_page(analyze(records), tmp_path / "home", text, cast, ()), tmp_path / "profile-2")


def test_a_page_that_runs_a_payload_would_be_noticed(tmp_path):
    """Negative control, without escaping and without the page's policy."""
    page = tmp_path / "page.html"
    for text in PAYLOADS[:7]:
        page.write_text(f"<p>{text}</p>")
        assert "<title>owned</title>" in browse(page, tmp_path / "profile")[0]
