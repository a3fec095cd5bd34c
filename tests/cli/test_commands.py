"""What the commands print and leave behind when nothing is wrong."""

import json
import subprocess
import sys

import polars as pl
import pytest

import perdure as library
from perdure.cli import COMMANDS, HOME_COMMANDS
from perdure.policy import load_policy

SIX = ("Ant-v3", "HalfCheetah-v3", "Hopper-v3", "Humanoid-v3", "Swimmer-v3", "Walker2d-v3")
TINY = (
    *("--ppo.total-steps", 512, "--ppo.n-steps", 128, "--ppo.batch-size", 64),
    *("--ppo.n-epochs", 1, "--ppo.hidden-sizes", 8),
)


def succeeded(process):
    """The standard output of a process that had nothing to complain about."""
    assert process.returncode == 0, process.stderr
    assert "Traceback" not in process.stderr
    return process.stdout


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)], ids=["nothing", "--help", "-h"])
def test_help_lists_every_command(command, tmp_path, arguments):
    text = succeeded(command(*arguments, cwd=tmp_path))
    assert [name for name in COMMANDS if f"perdure {name} " not in text] == []


@pytest.mark.parametrize(
    "name",
    [*(name for name in COMMANDS if name != "home"), "train Hopper-v3", *(f"home {name}" for name in HOME_COMMANDS)],
)
def test_every_command_explains_itself_on_stdout(command, tmp_path, name):
    process = command(*name.split(), "--help", cwd=tmp_path)
    lines = succeeded(process).splitlines()
    assert lines[0].startswith(f"example: perdure {name}")
    assert lines[2].startswith("usage: perdure")
    assert lines[-1].startswith("More: https://")
    assert process.stderr == ""


def test_the_version_is_printed(command, tmp_path):
    assert succeeded(command("--version", cwd=tmp_path)).split() == ["perdure", library.__version__]


def test_list_tasks_names_the_six_tasks_of_the_thesis(command, tmp_path):
    assert set(SIX) <= set(succeeded(command("list", "tasks", cwd=tmp_path)).split())


def test_list_methods_names_every_method(command, tmp_path):
    from perdure.learn import METHODS

    text = succeeded(command("list", "methods", cwd=tmp_path))
    assert [name for name in METHODS if f"| {name} |" not in text] == []


def test_list_policies_names_every_shipped_file(command, tmp_path):
    from perdure.policy.files import shipped_policies

    lines = succeeded(command("list", "policies", cwd=tmp_path)).splitlines()
    assert [line.split()[0] for line in lines if line] == list(shipped_policies())


def test_inspect_shows_what_is_in_the_file(command, files, tmp_path):
    text = succeeded(command("inspect", files / "timed.safetensors", cwd=tmp_path))
    for part in ("InvertedPendulum-v4", "Linear()", "constant(50)", "made by a test", "12 weights"):
        assert part in text


def test_a_reader_that_leaves_early_causes_no_traceback():
    command = f"{sys.executable} -m perdure list policies | true"
    process = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=600)
    assert "Traceback" not in process.stderr


@pytest.fixture(scope="module")
def trained(command, tmp_path_factory):
    """A folder with one tiny run, and what training it printed."""
    folder = tmp_path_factory.mktemp("trained")
    arguments = ("train", "InvertedPendulum-v4", "--method", "geometric", *TINY, "--out", "runs", "--on", "here")
    return folder, succeeded(command(*arguments, cwd=folder))


def test_train_prints_where_the_policy_is(trained):
    folder, printed = trained
    path = folder / "runs" / "InvertedPendulum-v4" / "geometric" / "seed-0" / "policy.safetensors"
    assert printed.strip() == str(path)
    policy = load_policy(path)
    assert policy.task.name == "InvertedPendulum-v4"
    assert policy.weights["policy.0.weight"].shape == (4 + 5, 8)
    assert policy.clock.label == "constant(500)"


def test_a_finished_run_is_not_trained_again(command, trained):
    folder, printed = trained
    before = (folder / printed.strip()).stat().st_mtime_ns
    again = command("train", "InvertedPendulum-v4", "--method", "geometric", *TINY, "--out", "runs", cwd=folder)
    assert succeeded(again) == printed
    assert (folder / printed.strip()).stat().st_mtime_ns == before


def test_a_run_that_other_code_made_is_taken_and_told_of_in_one_line(command, trained):
    folder, printed = trained
    record = (folder / printed.strip()).parent / "unit.json"
    before = record.read_text()
    record.write_text(json.dumps({**json.loads(before), "sources": ["another"]}))
    again = command("train", "InvertedPendulum-v4", "--method", "geometric", *TINY, "--out", "runs", cwd=folder)
    record.write_text(before)
    assert succeeded(again) == printed
    told = [line for line in again.stderr.splitlines() if "another version of perdure" in line]
    assert len(told) == 1
    assert told[0].startswith("perdure: 1 of 1 results")
    assert "OtherSourceWarning" not in again.stderr


def test_a_run_of_the_same_name_with_other_settings_is_refused(command, trained):
    folder, _ = trained
    other = ("train", "InvertedPendulum-v4", "--method", "geometric", *TINY, "--ppo.clip-range", 0.1, "--out", "runs")
    process = command(*other, cwd=folder)
    assert process.returncode == 2
    assert process.stderr.count("\n") == 1
    assert "clip_range" in process.stderr


@pytest.fixture(scope="module")
def extrapolated(command, trained):
    """The same folder after an evaluation, and what that printed."""
    folder, printed = trained
    clocks = ("--clocks", "constant:0", "constant:500", "countdown")
    arguments = (*clocks, "--steps", 50, "--eval-seeds", 2, "--disturb", "none", "--on", "here", "--out", "carried")
    return folder, succeeded(command("extrapolate", printed.strip(), *arguments, cwd=folder))


def test_extrapolate_writes_one_row_for_each_lane_and_recorded_step(extrapolated):
    folder, _ = extrapolated
    frame = pl.read_parquet(folder / "carried" / "episodes.parquet")
    assert frame["step"].max() == 50
    assert set(frame["clock"]) == {"constant(0)", "constant(500)", "countdown(50)"}
    lanes = frame.select("clock", "eval_seed").unique()
    assert len(lanes) == 3 * 2
    assert len(frame) == len(lanes) * frame["step"].n_unique()


def test_clocks_of_a_policy_without_a_time_to_go_are_told_to_have_no_effect(command, extrapolated, tmp_path):
    few = ("--steps", 20, "--eval-seeds", 1, "--disturb", "none", "--on", "here", "--out", "few")
    told = "no policy here has a time-to-go input, so --clocks has no effect"
    process = command("extrapolate", "Hopper-v3/ppo", "--clocks", "constant:500", *few, cwd=tmp_path)
    succeeded(process)
    assert told in process.stderr
    process = command(
        "extrapolate", "Hopper-v3/geometric", "--clocks", "constant:500", *few, "--out", "more", cwd=tmp_path
    )
    succeeded(process)
    assert told not in process.stderr


def test_extrapolate_writes_its_report_and_says_where(extrapolated):
    folder, printed = extrapolated
    page = folder / "carried" / "report.html"
    assert str(page) in printed.replace("\n", "")
    assert "perdure extrapolate" in page.read_text()


def test_report_is_made_again_from_the_table_alone(command, extrapolated, tmp_path):
    folder, _ = extrapolated
    page = (folder / "carried" / "report.html").read_bytes()
    for name, table in (("of the file", "carried/episodes.parquet"), ("of the folder", "carried")):
        succeeded(command("report", folder / table, "--out", tmp_path / name, cwd=tmp_path))
        assert (tmp_path / name / "report.html").read_bytes() == page
