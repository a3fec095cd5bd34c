"""Whatever a user gets wrong ends in one line on stderr and exit code 2, and never in a traceback."""

import os

import pytest

from perdure.cli.parse import sentence

TINY = ("--ppo.total-steps", 64, "--ppo.n-steps", 32, "--ppo.batch-size", 32, "--ppo.hidden-sizes", 4)
PENDULUM = ("train", "InvertedPendulum-v4")
EVALUATE = ("extrapolate", "{files}/timed.safetensors")

MISTAKES = {
    # mistake: (what the line must name, the command line)
    "unknown command": ("walk", "walk"),
    "unknown option": ("--stepz", *EVALUATE, "--stepz", 3),
    "bad flag value": ("--steps", *EVALUATE, "--steps", "many"),
    "missing flag value": ("--steps", *EVALUATE, "--steps"),
    "bad choice": ("robots", "list", "robots"),
    "unknown suite": ("'Atari'", "list", "tasks", "--suite", "Atari"),
    "train without a task": ("task", "train"),
    "unknown task": ("Hopper-v3", "train", "Hoper-v3"),
    "unknown Gymnasium task": ("Hoper-v9", "train", "gymnasium:Hoper-v9"),
    "unknown method": ("geometric", *PENDULUM, "--method", "geometrik"),
    "T_min > T_max": ("1000", *PENDULUM, "--ppo.protocol.horizon.low", 2000),
    "gamma > 1": ("gamma", *PENDULUM, "--ppo.protocol.gamma", 1.5),
    "no environments": ("n_envs", *PENDULUM, "--ppo.n-envs", 0),
    "no steps to train": ("total_steps", *PENDULUM, "--ppo.total-steps", 0),
    "minibatches that do not fit": ("batch_size", *PENDULUM, "--ppo.batch-size", 100),
    "a setting that is no number": ("log_std_init is nan; it must be a finite", *PENDULUM, "--ppo.log-std-init", "nan"),
    "an infinite setting": ("ent_coef is inf; it must be a finite", *PENDULUM, "--ppo.ent-coef", "inf"),
    "no seeds": ("seed", *PENDULUM, *TINY, "--seeds"),
    "a negative seed": ("-1", *PENDULUM, *TINY, "--seeds", -1),
    "the same seed twice": ("[3, 3]", *PENDULUM, *TINY, "--seeds", 3, 3),
    "a name that is no folder": ("..", *PENDULUM, *TINY, "--name", ".."),
    "no cores": ("cores", *PENDULUM, *TINY, "--cores", 0),
    "a method without a name": ("--method", *PENDULUM, "--method"),
    "no policies": ("policy", "extrapolate"),
    "no such policy": ("walker.safetensors", "extrapolate", "walker.safetensors"),
    "a folder as policy": ("folder", "extrapolate", "{files}"),
    "cut policy": ("cut.safetensors", "extrapolate", "{files}/cut.safetensors"),
    "edited policy": ("changed", "extrapolate", "{files}/edited.safetensors"),
    "foreign file as policy": ("foreign.txt", "extrapolate", "{files}/foreign.txt"),
    "empty file as policy": ("empty", "inspect", "{files}/empty"),
    "policies for two tasks": ("Hopper-v3", *EVALUATE, "{files}/other.safetensors"),
    "C < 0": ("-5", *EVALUATE, "--clocks", "constant:-5"),
    "a clock without steps": ("constant", *EVALUATE, "--clocks", "constant"),
    "an unknown clock": ("sundial", *EVALUATE, "--clocks", "sundial:12"),
    "no steps": ("steps", *EVALUATE, "--steps", 0),
    "no start states": ("eval_seeds", *EVALUATE, "--eval-seeds", 0),
    "no episodes": ("max_episodes", *EVALUATE, "--max-episodes", 0),
    "a place that is none": ("did you mean 'local'?", *PENDULUM, *TINY, "--on", "locl"),
    "a place that is none in an evaluation": ("here, local, ray or ray:ADDRESS", *EVALUATE, "--on", "cloud"),
    "no cores in an evaluation": ("cores", *EVALUATE, "--steps", 10, "--cores", 0),
    "inspect nothing": ("A policy file", "inspect"),
    "inspect a missing file": ("none.safetensors", "inspect", "none.safetensors"),
    "report of a missing table": ("none.parquet", "report", "none.parquet"),
    "report of a folder without a table": ("/episodes.parquet does not exist", "report", "{files}"),
    "report of a policy": ("timed.safetensors", "report", "{files}/timed.safetensors"),
    "an environment without a policy": ("no policy to evaluate", "extrapolate", "--env", "Pendulum-v1"),
    "out is a file": ("foreign.txt", *EVALUATE, *("--steps", 10, "--disturb", "none"), "--out", "{files}/foreign.txt"),
    "out is inside a file": ("foreign.txt", *PENDULUM, *TINY, "--out", "{files}/foreign.txt/runs"),
}


def failed(process):
    """The one line a failure consists of."""
    code, stdout, stderr = process.returncode, process.stdout, process.stderr
    assert code == 2, stderr
    assert stdout == ""
    assert stderr.count("\n") == 1, stderr
    assert stderr.startswith("perdure: ")
    assert "Traceback" not in stderr
    line = stderr.removeprefix("perdure: ").strip()
    assert line == " ".join(line.split())
    return line


def arguments_of(mistake, files):
    """What a line about a mistake must name, and the command line that makes it."""
    names, *arguments = MISTAKES[mistake]
    return names, [str(argument).replace("{files}", str(files)) for argument in arguments]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_ends_in_one_line_that_names_it(command, files, tmp_path, mistake):
    names, arguments = arguments_of(mistake, files)
    assert names in failed(command(*arguments, cwd=tmp_path))


def test_a_process_ends_as_its_main_function_does(process, files, tmp_path):
    names, arguments = arguments_of("cut policy", files)
    assert names in failed(process(*arguments, cwd=tmp_path))


def test_a_fault_of_the_program_is_not_passed_off_as_the_users(command, monkeypatch, tmp_path):
    monkeypatch.setattr("perdure.cli.commands.tasks", lambda suite: int("a bug"))
    with pytest.raises(ValueError, match="a bug"):
        command("list", cwd=tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="the administrator may write anywhere")
def test_a_folder_that_may_not_be_written_is_named(command, files, tmp_path):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    arguments = ("extrapolate", files / "timeless.safetensors", "--steps", 10, "--eval-seeds", 1, "--disturb", "none")
    line = failed(command(*arguments, "--out", locked / "out", cwd=tmp_path))
    assert "locked" in line
    assert "Permission denied" in line


def test_a_full_disk_leaves_no_half_written_report(process, files, tmp_path):
    few = ("--steps", 200, "--eval-seeds", 2, "--disturb", "none", "--on", "here")
    arguments = ("extrapolate", files / "timeless.safetensors", *few)
    line = failed(process(*arguments, "--out", tmp_path / "out", cwd=tmp_path, longest_file_kb=2))
    assert "too large" in line or "No space" in line
    assert not (tmp_path / "out" / "report.html").exists()
    assert not (tmp_path / "out" / "episodes.parquet").exists()


def test_the_sentence_of_a_framed_message_is_what_stands_before_its_first_rule():
    box = """\
╭─ Value error ──────────────────────────────╮
│ Error parsing --steps: no number of steps  │
│ can be read off 'many'.                    │
│ ────────────────────────────────────────── │
│ For full helptext, see perdure --help      │
╰────────────────────────────────────────────╯
"""
    assert sentence(box) == "--steps: no number of steps can be read off 'many'"


def test_a_message_without_a_frame_is_kept_whole():
    assert sentence("something\n  else\n") == "something else"


def test_a_worker_process_that_fails_ends_in_one_line_and_leaves_no_run(command, tmp_path, monkeypatch):
    monkeypatch.setattr("perdure.runs.workers._START", "import perdure.no_such_worker")
    assert "no_such_worker" in failed(command("train", "InvertedPendulum-v4", "--seeds", 0, 1, cwd=tmp_path))
    assert not list(tmp_path.glob("runs/*/*/seed-*"))
