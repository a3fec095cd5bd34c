"""The audit of published agents: the page says what its table says."""

from pathlib import Path

import polars as pl

from studies.agents.study import VERDICTS, page_table
from studies.files import include_tables

RESULTS = Path(__file__).parents[2] / "results" / "agents"


def test_the_page_says_what_the_verdicts_say(tmp_path):
    verdicts = pl.read_csv(RESULTS / VERDICTS)
    page = tmp_path / "README.md"
    page.write_bytes((RESULTS / "README.md").read_bytes())
    include_tables(page, {"agents": page_table(verdicts)})
    assert page.read_text() == (RESULTS / "README.md").read_text()
    held = {
        (task, algorithm, condition)
        for task, algorithm, condition, verdict in verdicts.filter(when="published")
        .select("task", "algorithm", "condition", "verdict")
        .iter_rows()
        if verdict == "holds"
    }
    agents = set(verdicts.filter(when="published").select("task", "algorithm").iter_rows())
    calm = {agent for agent in agents if (*agent, "none") in held}
    both = {agent for agent in calm if (*agent, "standard-1") in held}
    words = " ".join(page.read_text().split())
    assert f"**{len(both)} of {len(agents)} do.**" in words
    assert f"{len(calm)} hold for 100,000 calm steps and {len(both)} of these also under" in words
