"""Bodies left out of the search for contacts: no contact may be lost by it."""

import mujoco
import numpy as np
import pytest
from test_world import begin, wiggle

from perdure.home.sim import scene
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import load_episodes


def contacts(lane):
    """Pairs of geoms that touch when everything is searched, and when only what is near is."""
    found = []
    for everything in (True, False):
        model, data = lane.model, mujoco.MjData(lane.model)
        kept = model.body_contype.copy(), model.body_conaffinity.copy()
        if everything:
            model.body_contype[:] = lane.scene.nearby.contype
            model.body_conaffinity[:] = lane.scene.nearby.conaffinity
        mujoco.mj_copyData(data, model, lane.data)
        mujoco.mj_fwdPosition(model, data)
        model.body_contype[:], model.body_conaffinity[:] = kept
        found.append({tuple(sorted(pair)) for pair in data.contact.geom.tolist()})
    return found


def rummage(task):
    """A robot that rummages among its furniture for 12 seconds, arm stretched out: contacts seen, contacts lost."""
    world, rng, seen, lost = VectorSimulator(4), np.random.default_rng(0), 0, 0
    for lane, episode in enumerate(load_episodes(task, "val").episodes[:4]):
        begin(world, lane, episode, seed=lane)
    for step in range(360):
        actions = wiggle(rng, 4)
        actions[:, ROBOT.action.arm] = np.where(
            step < 60, (0.0, 1.0, 0.0, -1.0, 0.0, -0.5, 0.0), actions[:, ROBOT.action.arm]
        )
        actions[:, ROBOT.action.forward] = np.where(step % 60 < 40, 0.4, actions[:, ROBOT.action.forward])
        world.step(actions)
        if step % 10 == 0:
            for lane in range(4):
                everything, near = contacts(world.simulator(lane))
                seen, lost = seen + len(everything), lost + len(everything - near)
                assert near <= everything
    return seen, lost


@pytest.mark.parametrize("task", ["set_table", "prepare_groceries"])
def test_no_contact_is_lost(task):
    seen, lost = rummage(task)
    assert seen > 20
    assert lost == 0


def test_a_reach_too_short_loses_contacts(monkeypatch):
    monkeypatch.setattr(scene, "REACH", 0.1)
    assert rummage("set_table")[1] > 0


def test_most_of_a_room_is_left_out_once_it_sleeps():
    world = VectorSimulator(1)
    scene = begin(world, 0, load_episodes("set_table", "val").episodes[0])
    lane = world.simulator(0)
    assert np.array_equal(lane.model.body_contype, scene.nearby.contype)  # at first everything is awake
    for _ in range(30):
        world.step(np.zeros((1, ROBOT.action_size)))
    assert (lane.model.body_contype > 0).sum() < 0.7 * (scene.nearby.contype > 0).sum()
    lane.object(5)[1][:] = 1.0, 0.0, 0.0  # wakes it: what it may now hit must be searched
    world.step(np.zeros((1, ROBOT.action_size)))
    world.step(np.zeros((1, ROBOT.action_size)))
    assert np.array_equal(lane.model.body_contype, scene.nearby.contype)
