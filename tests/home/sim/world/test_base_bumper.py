"""The base keeps off furniture as on a navigation mesh, and slides along it."""

from dataclasses import replace

import numpy as np
import pytest

from perdure.home.sim import occupancy, scene
from perdure.home.sim.occupancy import footprints
from perdure.home.sim.pieces import Pose, make_piece
from perdure.home.sim.robot import add_fetch
from perdure.home.sim.scene import build_scene
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import episode_scene, load_episodes

RADIUS = 0.29
"""Of the bumper in [m]: M3's 0.3 less 1 cm."""
DENT = 0.015
"""How far a base of 121 kg gets into furniture that it runs against at 1.5 m/s, for a moment, in [m]."""
FORWARD = np.eye(1, 11)


@pytest.fixture
def table(empty_room):
    """A room with nothing but a table in its middle, turned as nothing else is."""
    apartment, middle, _ = empty_room
    return replace(
        apartment, pieces=(make_piece("table_01", "table_01", Pose(float(middle[0]), float(middle[1]), 0.3)),)
    )


def driven(apartment, heading, steps=90):
    """The base's places while it drives toward the middle of the table from 1.8 m away."""
    world, pose = VectorSimulator(1, threads=1), apartment.pieces[0].pose
    start = Pose(pose.x - 1.8 * float(np.cos(heading)), pose.y - 1.8 * float(np.sin(heading)), heading)
    world.reset(0, build_scene(apartment, []), start)
    places = []
    for _ in range(steps):
        world.step(FORWARD)
        places.append(world.simulator(0).robot[:2].copy())
    return np.array(places)


def nearest(apartment, places):
    """How near the base's middle gets to the table's footprint in [m]."""
    return occupancy.clearance(places, footprints(apartment.pieces[0])).min()


@pytest.mark.parametrize("heading", np.linspace(0.0, 2.0 * np.pi, 7)[:-1])
def test_nobody_gets_under_a_table(table, heading):
    assert RADIUS - DENT < nearest(table, driven(table, heading)) < RADIUS, "it drives until it touches"


def test_without_the_skirt_a_robot_does_get_under_it(table, monkeypatch):
    def add_without(spec, *, visuals):
        add_fetch(spec, visuals=visuals)
        spec.delete(spec.geom("robot/base_bumper"))

    monkeypatch.setattr(scene, "add_fetch", add_without)
    assert nearest(table, driven(table, 0.3 + 0.5 * np.pi)) < RADIUS - 0.1


def test_a_base_that_meets_an_edge_slantwise_slides_along_and_past_it(table):
    heading = 0.3 + np.pi / 4.0
    places = driven(table, heading, steps=150)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) * 30.0
    assert RADIUS - DENT < nearest(table, places) < RADIUS, "it met it, and kept off at the corner, too"
    assert speed[5:-30].min() > 0.05


def test_objects_doors_and_drawers_do_not_meet_the_base_bumper():
    model = episode_scene(load_episodes("set_table", "val").episodes[0]).model
    bumper = model.geom("robot/base_bumper")
    answering = {model.geom(k).name for k in range(model.ngeom) if model.geom_conaffinity[k] & int(bumper.contype[0])}
    assert {"table_01/top", "fridge/back", "wall_0/slab"} <= answering
    moving = {model.geom(k).name for k in range(model.ngeom) if model.body_weldid[model.geom_bodyid[k]] != 0}
    assert not answering & moving
    assert int(bumper.conaffinity[0]) == 0
    half = bumper.size[0] + bumper.size[1]
    assert (bumper.pos[2] - half, bumper.pos[2] + half) == pytest.approx((0.05, 1.5))  # M3's navigation mesh
