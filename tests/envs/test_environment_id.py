"""Which task an environment's name means."""

from __future__ import annotations

import pytest

from perdure.envs import is_task, list_tasks, make_world, task_of_environment
from perdure.envs.gymnasium import refuse_mujoco
from perdure.errors import PerdureError

MEANINGS = {
    "Hopper-v5": "gymnasium:Hopper-v5",
    "Hopper-v4": "gymnasium:Hopper-v4",
    "Hopper-v3": "Hopper-v3",  # Gymnasium's needs mujoco-py
    "Pendulum-v1": "gymnasium:Pendulum-v1",
    "envpool:Hopper-v5": "Hopper-v5",
    "gymnasium:Hopper-v5": "gymnasium:Hopper-v5",
    "HopperHop-v1": "HopperHop-v1",
    "walls:Corridor-v0": "gymnasium:walls:Corridor-v0",
    "gymnasium:walls:Corridor-v0": "gymnasium:walls:Corridor-v0",
}


@pytest.mark.parametrize("name", MEANINGS)
def test_a_name_means_gymnasiums_environment_if_gymnasium_can_make_it(name):
    task = task_of_environment(name)
    assert task == MEANINGS[name]
    assert is_task(task)


@pytest.mark.parametrize("name", ["Hopper-v3", "Hopper-v5", "Pendulum-v1"])
def test_the_task_can_be_built(name):
    world = make_world(task_of_environment(name), [0])
    assert world.reset().shape == (1, world.spec.observation_size)
    world.close()


def test_some_names_exist_in_both_so_that_the_rule_decides():
    envpool = {listing.name for listing in list_tasks("EnvPool MuJoCo")}
    assert {"Hopper-v3", "Hopper-v4", "Hopper-v5"} <= envpool


@pytest.mark.parametrize("name", ["Hoper-v5", "envpool:Hoper-v5"])
def test_an_unknown_name_is_refused_with_the_nearest(name):
    with pytest.raises(PerdureError, match=r"'Hoper-v5'.*Hopper-v5"):
        task_of_environment(name)


def test_an_empty_name_is_refused():
    with pytest.raises(PerdureError, match="empty"):
        task_of_environment(" ")


def test_what_gymnasium_cannot_make_is_said_without_its_traceback():
    with pytest.raises(PerdureError, match="without perdure") as caught:
        make_world("gymnasium:Hopper-v3", [0])
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__


def test_the_mujoco_that_is_known_to_be_wrong_is_refused_with_the_reason():
    with pytest.raises(PerdureError, match=r"4\.0\.0.*Cholesky"):
        refuse_mujoco("4.0.0")
    refuse_mujoco("3.17.0")
