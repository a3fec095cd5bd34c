"""The committed tables and pages are what the analysis makes of the committed results."""

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import stats

from perdure.studies.horizon import analyze as analysis
from perdure.studies.horizon.grid import GRIDS

RESULTS = Path(__file__).parents[3] / "results"
KEPT = {"thesis": RESULTS / "horizon", "replication": RESULTS / "horizon-replication"}
SOURCES = ("training", "evaluation", "rules", "mechanism")


@pytest.mark.parametrize("scale", KEPT)
def test_tables_claims_and_page_are_made_again_byte_for_byte(scale, tmp_path, monkeypatch):
    folder = KEPT[scale]
    for name in SOURCES:
        if (folder / name).is_dir():
            (tmp_path / name).symlink_to(folder / name)
    (tmp_path / "README.md").write_bytes((folder / "README.md").read_bytes())
    drawn = []
    monkeypatch.setattr(analysis, "save", lambda figures, out, formats: drawn.extend(figures))
    analysis.analyze(GRIDS[scale], tmp_path)
    made = {path.relative_to(tmp_path) for path in [*tmp_path.glob("tables/*.csv"), *tmp_path.glob("*.md")]}
    assert made == {path.relative_to(folder) for path in [*folder.glob("tables/*.csv"), *folder.glob("*.md")]}
    changed = [path for path in sorted(made) if (tmp_path / path).read_bytes() != (folder / path).read_bytes()]
    assert not changed, f"perdure study horizon --scale {scale} --analyze-only changes {changed}"
    assert {f"{figure.name}.svg" for figure in drawn} == {path.name for path in folder.glob("figures/*.svg")}


def interval(values):
    """Mean and Student's t interval."""
    return np.mean(values), *stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))


def printed(pattern):
    """The numbers in what the page says."""
    (found,) = re.findall(pattern, (KEPT["thesis"] / "README.md").read_text())
    return [float(number) for number in found]


def test_the_page_says_how_many_failures_came_after_the_training_horizon():
    runs = pl.read_csv(KEPT["thesis"] / "tables" / "runs.csv")
    ppo = runs.filter((pl.col("setting") == "Walker2d-v3@cleanrl") & (pl.col("method") == "ppo"))
    later = (ppo["failed share"] - ppo["failed within"]).to_list()
    numbers = printed(r"Later failures alone: (\S+) \((\S+) to (\S+); p = (\S+) before")
    assert numbers == pytest.approx([*interval(later), stats.ttest_1samp(later, 0.1).pvalue], abs=0.005)


def test_the_page_says_how_much_actions_change_without_the_c_that_training_never_saw():
    changes = [
        pl.read_parquet(path).filter(pl.col("C").is_in([100, 200, 300, 400, 600, 700, 800, 900, 1000]))["change"].mean()
        for path in (KEPT["thesis"] / "mechanism" / "HalfCheetah-v3" / "geometric").glob("seed-*/actions.parquet")
    ]
    numbers = printed(r"Without C = 0,.*?HalfCheetah-v3 (\S+) \((\S+) to (\S+)\)")
    assert numbers == pytest.approx(interval(changes), abs=0.0005)
