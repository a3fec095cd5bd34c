"""The summary for machines, of tables whose truth is known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import polars as pl
import pytest

from perdure.cli.extrapolate import write_and_show
from perdure.evaluate import ExtrapolationResult
from perdure.report import estimate_table, write_table
from perdure.report.summary import Summary, badge, json_schema, not_holding


@pytest.fixture(scope="module")
def mixed(synthetic):
    """One policy holds when calm and falls in 3 of 8 episodes when disturbed; nothing else."""
    calm = synthetic([{"rate": 2.0}])
    disturbed = synthetic([{"rate": 2.0, "ends": [500] * 3 + [math.inf] * 5}])
    return pl.concat([calm, disturbed.with_columns(disturbance=pl.lit("standard-1"))])


def test_the_document_says_what_the_table_says(mixed, tmp_path):
    document = json.loads(
        Summary.of(estimate_table(mixed), tmp_path / "episodes.parquet", Path("report.html"), {}).to_json()
    )
    calm, disturbed = document["groups"]
    assert document["holds"] is False
    assert Path(document["page"]).is_absolute()
    assert document["table"] == str((tmp_path / "episodes.parquet").resolve())
    assert set(document["versions"]) == {"python", "perdure", "envpool", "gymnasium", "mujoco", "numpy"}
    assert calm["verdict"] == "holds"
    assert (calm["policy"], calm["clock"], calm["disturbance"]) == ("geometric", "constant(500)", "none")
    assert (disturbed["policy"], disturbed["disturbance"], disturbed["verdict"]) == ("geometric", "standard-1", "falls")
    assert disturbed["outcomes"] == {"falls": 3, "holds": 5}
    assert (disturbed["task"], disturbed["episodes"], disturbed["steps"]) == ("Hopper-v3", 8, 100_000)
    assert calm["mean_return"]["estimate"] == pytest.approx(200_000)
    assert disturbed["share_that_holds"]["estimate"] == pytest.approx(5 / 8)
    assert disturbed["share_that_holds"]["low"] < 5 / 8 < disturbed["share_that_holds"]["high"]
    assert disturbed["median_failure_step"] is None  # fewer than half failed
    assert not_holding(estimate_table(mixed)) == [
        f"{estimate_table(mixed)['Hopper-v3'][1].group.label}: falls in 3 of 8 episodes"
    ]


def test_every_name_is_in_the_reference(mixed):
    document = json.loads(Summary.of(estimate_table(mixed), Path("t"), Path("p"), {}).to_json())
    page = (Path(__file__).parents[2] / "docs" / "reference" / "json.md").read_text()
    assert [name for name in (*document, *document["groups"][0]) if f"`{name}`" not in page] == []


def test_the_documents_fit_the_published_schema(mixed):
    published = (Path(__file__).parents[2] / "docs" / "reference" / "verdict.schema.json").read_text()
    assert published == json_schema(), "write it again: python -m perdure.report.summary"
    validator = jsonschema.Draft202012Validator(json.loads(published))
    document = json.loads(Summary.of(estimate_table(mixed), Path("t"), Path("p"), {}).to_json())
    validator.validate(document)
    del document["groups"][0]["verdict"]
    assert not validator.is_valid(document)


def test_what_does_not_hold_is_a_failed_case_and_a_red_badge(mixed, tmp_path):
    table = write_table(tmp_path / "episodes.parquet", mixed, {})
    write_and_show(table, tmp_path, ())
    assert json.loads((tmp_path / "verdict.json").read_text())["holds"] is False
    (suite,) = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("Hopper-v3", "2", "1")
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["geometric, constant(500), standard-1"]
    assert suite.find(".//failure").get("type") == "falls"
    assert json.loads((tmp_path / "badge.json").read_text())["message"] == "falls"
    calm = estimate_table(mixed.filter(disturbance="none"))
    assert json.loads(badge(calm))["color"] != "red"


def test_a_result_holds_if_all_of_it_does(mixed):
    assert not ExtrapolationResult(mixed, None).holds
    assert ExtrapolationResult(mixed.filter(disturbance="none"), None).holds


def test_a_requirement_that_is_met_ends_as_any_command_and_another_with_code_3(mixed, tmp_path, capsys):
    for rows, holds in ((mixed.filter(disturbance="none"), True), (mixed, False)):
        table = write_table(tmp_path / "episodes.parquet", rows, {})
        if holds:
            write_and_show(table, tmp_path, (), "holds", True)
        else:
            with pytest.raises(SystemExit, match=r"^3$"):
                write_and_show(table, tmp_path, (), "holds", True)
        said = capsys.readouterr()
        assert json.loads(said.out)["holds"] is holds
        assert ("falls in 3 of 8 episodes" in said.err) is not holds
