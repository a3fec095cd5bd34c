"""The committed tables and pages are what the analysis makes of the committed results."""

from pathlib import Path

import pytest

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
