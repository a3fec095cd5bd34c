"""``perdure home``: what its commands print and leave behind, and how they refuse."""

import gc
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from perdure.cli.home import Shown, main
from perdure.cli.home_options import parse_policies
from perdure.errors import PerdureError
from perdure.home.agents.release import ReleaseStrategy
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol import EvaluationProtocol, run_protocol
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import SKILLS
from perdure.home.tasks.planners import Planner
from tests.home.limits import shorten

sys.path.insert(0, str(Path(__file__).parent.parent / "home" / "evaluate" / "outcomes"))


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Logs of two episodes under two strategies, two steps for each of the first skills; and the first protocol."""
    folder, options = tmp_path_factory.mktemp("runs"), ExecutorOptions(settle_steps=2, scene=SceneOptions(rolling=0.0))
    oracles = dict.fromkeys(SKILLS, "oracle")
    first = EvaluationProtocol("set_table", "ik", episodes=2, policies=oracles, options=options)
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, 2, 4)
        for each in (first, replace(first, place="rl", options=replace(options, planner="closed"))):
            run_protocol(each, folder)
    return folder, first


def succeeded(process):
    assert process.returncode == 0, process.stderr
    assert "Traceback" not in process.stderr
    return process.stdout


COMMANDS = ("list", "episode", "plan", "video", "view", "train", "run", "analyze", "failures")


def test_help_lists_every_command(command, tmp_path):
    text = succeeded(command("home", cwd=tmp_path))
    assert [name for name in COMMANDS if f"perdure home {name} " not in text] == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(command, tmp_path, name):
    assert f"usage: perdure home {name}" in succeeded(command("home", name, "--help", cwd=tmp_path))


def test_the_help_lists_planners_and_release_strategies_of_other_packages(capsys):
    class Lazy(Planner):
        name = "lazy"
        words = "nothing is planned"

        def next(self, facts, succeeded=True):
            return None

    class Throw(ReleaseStrategy):
        name = "throw"
        words = "throw it there"

        def motion(self, view):
            yield from ()

    with pytest.raises(SystemExit):
        main("run", ["--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for words in ("lazy: nothing is planned", "throw: throw it there", "closed: planned again", "stop: stop first"):
        assert words in shown
    del Lazy, Throw
    gc.collect()


def test_the_british_spelling_of_analyze_works(command, tmp_path):
    assert "usage: perdure home analyze" in succeeded(command("home", "analyse", "--help", cwd=tmp_path))


def test_list_names_tasks_skills_and_objects(command, tmp_path):
    text = succeeded(command("home", "list", cwd=tmp_path))
    for name in ("tidy_house", "prepare_groceries", "set_table", "navigate", "open_drawer", "024_bowl", "013_apple"):
        assert name in text


def test_an_episode_is_told_and_drawn(command, tmp_path):
    out = tmp_path / "out.png"
    process = command("home", "episode", "set_table", "--split", "val", "--index", 3, "--render", out, cwd=tmp_path)
    assert "set_table/val/003" in process.stdout
    assert "024_bowl" in process.stdout
    assert process.stdout.count("\n") > 25
    if "no picture can be drawn here" in process.stderr:
        assert (process.returncode, len(process.stderr.strip().splitlines())) == (2, 1)
        pytest.skip("this machine has neither EGL nor OSMesa")
    assert succeeded(process)
    picture = out.read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000


def test_the_plan_is_printed_as_a_pddl_domain_and_problem(command, tmp_path):
    from unified_planning.io import PDDLReader

    domain, problem = succeeded(command("home", "plan", "set_table", "--pddl", cwd=tmp_path)).split("\n\n")
    read = PDDLReader().parse_problem_string(domain, problem)
    assert "open_fridge" in {action.name for action in read.actions}
    assert len(read.goals) > 0


def test_the_plan_of_set_table_opens_the_drawer_first(command, tmp_path):
    text = succeeded(command("home", "plan", "set_table", cwd=tmp_path))
    assert text.index("open_drawer") < text.index("pick") < text.index("close_drawer") < text.index("open_fridge")


def test_a_run_is_kept_and_analyzed(command, tmp_path):
    arguments = ("set_table", "--episodes", 1, "--policies", "place=oracle", "--on", "here", "--out", "kept")
    text = succeeded(command("home", "run", *arguments, cwd=tmp_path))
    assert "close_1" in text
    again = succeeded(command("home", "run", *arguments, cwd=tmp_path))  # nothing is run a second time
    assert again == text
    assert succeeded(command("home", "analyze", "kept", cwd=tmp_path)) in text
    page = tmp_path / "kept" / "set_table" / "val" / "rl-snapped-grasp-base-3-m-per-s" / "report.html"
    assert f"Report: {page}" in text
    assert "perdure home run set_table --episodes 1" in page.read_text()
    assert "scripted oracle" in page.read_text()
    printed = succeeded(command("home", "analyze", "kept", "--out", "page", cwd=tmp_path))
    assert printed.splitlines()[-1] == f"Report: {tmp_path / 'page' / 'report.html'}"
    assert "mine" in succeeded(command("home", "analyze", "kept", "--names", "mine", cwd=tmp_path))
    assert (tmp_path / "page" / "set-table-val-success.png").exists()
    process = command("home", "analyze", "kept", "--out", page, cwd=tmp_path)
    assert (process.returncode, process.stdout, process.stderr.count("\n")) == (2, "", 1)
    assert "report.html" in process.stderr


def test_results_that_cannot_go_into_a_file_are_refused_before_anything_runs(command, files, tmp_path):
    for arguments in (("run", "set_table"), ("analyze", files / "none.parquet")):
        process = command("home", *arguments, "--out", files / "foreign.txt" / "deeper", cwd=tmp_path)
        assert (process.returncode, process.stderr.count("\n")) == (2, 1)
        assert "foreign.txt/deeper" in process.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fly",), "unknown command home 'fly'"),
        (("plan", "set_tabel"), "set_tabel"),
        (("episode", "set_table", "--index", 100), "0 to 99"),
        (("episode", "set_table", "--split", "test"), "test"),
        (("run", "set_table", "--place", "throw"), "rl, stop, ik, guarded"),
        (("run", "set_table", "--place", "delta-1"), "2 or more"),
        (("run", "set_table", "--episodes", 0), "episodes"),
        (("run", "set_table", "--policies", "place"), "SKILL=FILE"),
        (("run", "set_table", "--policies", "place=no.safetensors"), "no.safetensors"),
        (("analyze", "nowhere"), "nowhere"),
        (("analyze", "a", "b", "--names", "mine"), "--names must be 2 words"),
        (("train", "juggle"), "juggle"),
        (("train", "place", "--seeds", 0, 0), "seeds must be different numbers"),
        (("train", "place", "--on", "nowhere"), "on must be here"),
        (("train", "place", "--variant", "gentle", "--method", "linear"), "--variant or --method"),
        (("run", "set_table", "--core", 2), "did you mean --cores?"),
        (("analyze", "nowhere", "--out", "page"), "nowhere"),
        (("video", "set_table", "--out", "film.avi"), ".mp4, .gif, .webp"),
        (("video", "set_table", "--place", "rl", "--out", "sheet.png"), ".mp4, .gif, .webp"),
        (("video", "set_table", "--place", "rl", "throw"), "rl, stop, ik, guarded"),
        (("video", "set_table", "--place", "rl", "--policies", "place"), "SKILL=FILE"),
        (("video", "set_table", "--release", 2), "0 to 1, not 2"),
        (("video", "set_table", "--logs", "nowhere"), "nowhere"),
        (("video", "set_table", "--train-seed", -1), "0 or more, not -1"),
        (("view", "set_table", "--place", "throw"), "rl, stop, ik, guarded"),
        (("view", "set_table", "--logs", "nowhere", "--planner", "closed"), "leave them out"),
    ],
)
def test_what_a_user_gets_wrong_ends_in_one_line(command, tmp_path, arguments, message):
    process = command("home", *arguments, cwd=tmp_path)
    assert process.returncode == 2
    assert len(process.stderr.strip().splitlines()) == 1, process.stderr
    assert message in process.stderr
    assert not list(tmp_path.iterdir())


def test_the_word_oracle_alone_means_every_skill():
    assert set(parse_policies(("oracle",))) >= {"pick", "place", "navigate"}
    assert set(parse_policies(("oracle",)).values()) == {"oracle"}
    assert parse_policies(("place=oracle",)) == {"place": "oracle"}
    with pytest.raises(PerdureError, match="SKILL=oracle"):
        parse_policies(("oracle", "place=oracle"))
    with pytest.raises(PerdureError, match="place"):
        parse_policies(("place=a", "place=b"))


def test_a_view_repeats_the_logged_runs_of_its_episode(ran):
    """Logs name what acted; --place and the seeds choose among them."""
    folder, protocol = ran
    episode, agents = Shown("set_table", index=1, logs=(folder,)).open()
    assert (episode.name, [agent.protocol.place for agent in agents]) == ("set_table/val/001", ["ik", "rl"])
    assert {policy.source for policy in agents[0].policies.values()} == {"oracle"}
    assert agents[0].protocol.options.scene == protocol.options.scene
    _, (alone,) = Shown("set_table", index=1, place=("rl",), logs=(folder,)).open()
    assert alone.protocol.strategy == Strategy("rl", "drag only", "closed", "oracle")
    with pytest.raises(PerdureError, match="set_table/val/001"):
        Shown("set_table", index=1, eval_seed=1, logs=(folder,)).open()


def test_a_view_without_logs_shows_learned_policies_under_each_strategy():
    _, agents = Shown("set_table", place=("rl", "guarded"), planner="closed", eval_seed=2).open()
    assert [agent.protocol.strategy.name for agent in agents] == [
        "rl, snapped grasp, base 3 m per s, closed",
        "guarded, snapped grasp, base 3 m per s, closed",
    ], "the physics that the shipped policies were trained with"
    assert all(policy.learned for agent in agents for policy in agent.policies.values())
    assert agents[0].protocol.options.eval_seed == 2
    _, (oracle,) = Shown("set_table", policies=("oracle",)).open()
    assert not any(policy.learned for policy in oracle.policies.values())
