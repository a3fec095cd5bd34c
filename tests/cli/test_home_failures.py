"""``perdure home failures``: what it prints and draws, how it tells of a replay that went otherwise, how it refuses."""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from perdure.__main__ import main
from perdure.errors import PerdureError
from perdure.film import open_context
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.files import read_logs, write_logs
from perdure.home.evaluate.protocol import EvaluationProtocol, run_protocol
from perdure.home.skills import SKILLS
from tests.home.limits import shorten

sys.path.insert(0, str(Path(__file__).parent.parent / "home" / "evaluate" / "outcomes"))
from home_stories import good

ORACLES = dict.fromkeys(SKILLS, "oracle")


def noted(place="rl"):
    """The notes of logs of a release strategy."""
    return {"protocol": json.dumps(asdict(EvaluationProtocol("set_table", place)))}


OF_IT = "{strategy}, training seed -1, set_table/val/000, evaluation seed 0, open_0, {why}, 024_bowl"


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """An episode that had three steps for each skill, so that the drawer stayed shut; a replay has no more."""
    options = ExecutorOptions(lanes=1, settle_steps=2)
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, 3, 12)
        protocol = EvaluationProtocol("set_table", "rl", episodes=1, policies=ORACLES, options=options)
        (path,) = run_protocol(protocol, tmp_path_factory.mktemp("runs"))
        yield read_logs(path)[0]


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs `perdure home failures ARGUMENTS` in this process: its code, what it says, what it complains of."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["perdure", "home", "failures", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


@pytest.fixture
def pictures(monkeypatch):
    """Small ones; skips where none can be drawn."""
    monkeypatch.setattr("perdure.home.failures.SIZE", (240, 160))
    monkeypatch.setattr("perdure.home.pictures.Studio.shadows", 256)
    try:
        open_context(16, 16).free()
    except PerdureError:
        pytest.skip("this machine has neither EGL nor OSMesa")


def hit(record):
    """The same episode, but its log says that the arm hit something with 3000 N while it reached for the drawer."""
    runs = [replace(run, force=3000.0) if run.skill == "open_drawer" else run for run in record.runs]
    return replace(record, runs=tuple(runs), place="ik", eval_seed=0)


def test_a_right_label_is_drawn_and_a_wrong_one_reported(record, pictures, command, tmp_path):
    write_logs(tmp_path / "rl.parquet", [record], noted())
    write_logs(tmp_path / "ik.parquet", [hit(record)], noted("ik"))
    code, printed, complaint = command(tmp_path, "--out", tmp_path / "out", "--policies", "oracle")
    lines = {line.split(", ")[0]: line for line in printed.splitlines()}
    paths = {
        strategy: tmp_path / "out" / f"set_table-val-{strategy}-train--1-eval-0-000.png" for strategy in ("rl", "ik")
    }
    assert lines["rl"] == f"{OF_IT.format(strategy='rl', why='door not open')}, {paths['rl']}"
    another_label = "replayed: open_0, door not open, 024_bowl"
    assert lines["ik"] == f"{OF_IT.format(strategy='ik', why='collision')}, {paths['ik']}, {another_label}"
    assert len(lines) == 2
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths.values())
    assert code.startswith("perdure: 1 of 2 episodes got another label")  # a sentence means exit code 1
    assert complaint == ""


def test_logs_without_failures_are_no_mistake(command, tmp_path):
    write_logs(tmp_path / "logs.parquet", [good()], noted())
    assert command(tmp_path, "--counting", "latched") == (0, "no episode of these logs failed (latched)\n", "")


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("nowhere",), "nowhere"),
        ((), "logs"),
        (("{logs}", "--count", 0), "count must be 1 or more, not 0"),
        (("{logs}", "--seed", -1), "seed must be 0 or more, not -1"),
        (("{logs}", "--counting", "twice"), "twice"),
        (("{logs}", "--policies", "juggle=oracle"), "juggle"),
        (("{logs}", "--policies", "place=no.safetensors"), "no.safetensors"),
        (("{logs}", "--policies", "place"), "SKILL=FILE"),
        (("{logs}", "--out", "{logs}/deeper"), "Not a directory"),
        (("{logs}", "{logs}"), "both hold"),
        (("{foreign}",), "foreign.parquet does not say with which options it was made"),
        (("{changed}",), "is not the episode that this package has"),
    ],
)
def test_what_a_user_gets_wrong_ends_in_one_line(record, command, tmp_path, monkeypatch, arguments, names):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("perdure.home.failures.replay_failure", lambda *given: pytest.fail("it was found out too late"))
    others = {
        "logs": record,
        "foreign": replace(record, place="TP+SRL"),
        "changed": replace(record, episode_hash="other"),
    }
    for name, each in others.items():
        write_logs(tmp_path / f"{name}.parquet", [each], {} if name == "foreign" else noted())
    files = {name: f"{name}.parquet" for name in others}
    code, printed, complaint = command("--out", "out", *(str(each).format(**files) for each in arguments))
    assert (code, printed, complaint.count("\n")) == (2, "", 1)
    assert names in complaint
    assert not (tmp_path / "out").exists()
