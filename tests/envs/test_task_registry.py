"""Names of tasks: what is there, what is offered instead of a wrong one, and what importing the package costs."""

import subprocess
import sys

import pytest

from perdure.envs import list_tasks, make_world
from perdure.errors import PerdureError

SUITES = {"EnvPool MuJoCo", "EnvPool dm_control", "EnvPool Shadow hand", "Home", "Gymnasium"}


def names(suite: str) -> set[str]:
    return {listing.name for listing in list_tasks(suite)}


@pytest.mark.parametrize("robot", ["Ant", "HalfCheetah", "Hopper", "Humanoid", "Swimmer", "Walker2d"])
def test_the_six_robots_are_there_as_v3_v4_and_v5(robot: str) -> None:
    assert {f"{robot}-v3", f"{robot}-v4", f"{robot}-v5"} <= names("EnvPool MuJoCo")
    spec = make_world(f"{robot}-v3", [1]).spec
    assert (spec.name, spec.suite, spec.default_horizon) == (f"{robot}-v3", "EnvPool MuJoCo", 1000)


def test_each_suite_has_its_tasks_and_only_those() -> None:
    assert {listing.suite for listing in list_tasks()} == SUITES
    assert {"InvertedPendulum-v5", "InvertedDoublePendulum-v4", "Reacher-v5"} <= names("EnvPool MuJoCo")
    assert {"CheetahRun-v1", "HumanoidWalk-v1", "CartpoleBalance-v1"} <= names("EnvPool dm_control")
    assert {"HandReach-v3", "HandManipulateBlock-v1"} <= names("EnvPool Shadow hand")
    assert names("Gymnasium") == {"gymnasium:<id>"}
    everything = [listing.name for listing in list_tasks()]
    assert len(everything) == len(set(everything))
    assert not any(name.startswith(("Pong", "MetaWorld", "Adroit", "FetchReach")) for name in everything)


def test_the_list_states_default_horizons() -> None:
    horizons = {listing.name: listing.default_horizon for listing in list_tasks()}
    assert horizons["Hopper-v3"] == 1000
    assert horizons["HandReach-v3"] == 50
    assert horizons["gymnasium:<id>"] is None


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("hopper-v3", "Hopper-v3"),
        ("Hoper-v3", "Hopper-v3"),
        ("Walker-v3", "Walker2d-v3"),
        ("cheetahrun", "CheetahRun-v1"),
        ("Pendulum-v1", "gymnasium:Pendulum-v1"),
    ],
)
def test_a_mistyped_task_is_answered_with_the_nearest_names(wrong: str, right: str) -> None:
    with pytest.raises(PerdureError, match=f"'{wrong}'.*{right}"):
        make_world(wrong, [1])


def test_an_environment_that_gymnasium_no_longer_makes_is_not_offered() -> None:
    with pytest.raises(PerdureError) as caught:
        make_world("Hopper-v2", [1])
    assert "gymnasium:Hopper" not in str(caught.value)


@pytest.mark.parametrize("wrong", ["", "qqqqqqqq", "Pong-v5"])
def test_a_task_like_no_other_gets_no_wild_guess(wrong: str) -> None:
    with pytest.raises(PerdureError) as caught:
        make_world(wrong, [1])
    assert not any(name in str(caught.value) for name in ("Hopper", "Ant-"))
    assert "perdure list" in str(caught.value)


@pytest.mark.parametrize("option", ["max_episode_steps", "threads", "num_envs"])
def test_what_a_world_sets_itself_is_no_option_in_a_task_name(option: str) -> None:
    with pytest.raises(PerdureError, match=f"{option} is not an option"):
        make_world(f"perdure/HomePlace-v0,{option}=2", [1])


def test_an_unknown_suite_is_answered_with_the_suites() -> None:
    with pytest.raises(PerdureError, match="'Atari'") as caught:
        list_tasks("Atari")
    assert all(suite in str(caught.value) for suite in SUITES)


def test_importing_the_package_loads_no_simulator() -> None:
    heavy = "{'envpool', 'gymnasium', 'jax', 'mujoco'}"
    code = f"import sys, perdure.envs; print(sorted({heavy} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
