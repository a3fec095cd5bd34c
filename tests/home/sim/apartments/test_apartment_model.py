"""The MuJoCo model of an apartment against closed forms and against the record it was built from."""

import math

import mujoco
import numpy as np
import pytest

from perdure.home.sim.apartments import build_apartment, make_apartment
from perdure.home.sim.geoms import BUMPER_BIT


@pytest.fixture(scope="module")
def apartment():
    return make_apartment(1, 3)


@pytest.fixture(scope="module")
def model(apartment):
    return build_apartment(apartment).compile()


def state(model, **positions):
    data = mujoco.MjData(model)
    for joint, q in positions.items():
        data.joint(joint).qpos = q
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_handles_of_the_model_are_where_the_record_says(apartment, model, share):
    for moving in apartment.articulations:
        q = share * moving.limit[1]
        data = state(model, **{moving.joint: q})
        assert data.site(moving.handle_name).xpos == pytest.approx(apartment.handle_to_room(moving.link, q), abs=1e-9)


def test_handle_of_the_fridge_is_at_the_published_place(apartment, model):
    """0.62 m from the hinge, 1.138 m above the floor, 0.44 m before the fridge's middle when closed."""
    place = apartment.piece("fridge").pose.to_local(state(model).site("fridge_push_point").xpos)
    assert place == pytest.approx([0.440, -0.326 + 0.620, 1.138], abs=1e-6)


def test_door_swings_out_and_towards_its_hinge(apartment, model):
    """At a right angle the handle stands straight out before the hinge: 0.62 m and the 0.1 m it is off the door."""
    data = state(model, top_door_hinge=math.pi / 2)
    place = apartment.piece("fridge").pose.to_local(data.site("fridge_push_point").xpos)
    assert place == pytest.approx([0.340 + 0.620, -0.326 - 0.100, 1.138], abs=1e-6)


def test_drawers_have_the_published_range_masses_and_middles(model):
    masses = {"drawer1_top": 5, "drawer1_bottom": 5, "drawer2_top": 4, "drawer2_middle": 4, "drawer2_bottom": 4}
    masses |= {"drawer3": 4, "drawer4": 6}
    for link, mass in masses.items():
        body = model.body(link)
        assert body.mass[0] == mass
        assert model.jnt_range[body.jntadr[0]] == pytest.approx([0.0, 0.5])
    assert model.body("top_door").mass[0] == 8
    assert model.jnt_range[model.joint("top_door_hinge").id] == pytest.approx([0.0, 2.36])


def coast(model, joint, speed):
    """How far a joint moves on after being let go at some speed."""
    model.opt.timestep = 1.0 / 960.0
    data = mujoco.MjData(model)
    start = 0.1
    data.joint(joint).qpos, data.joint(joint).qvel = start, speed
    mujoco.mj_step(model, data, nstep=480)
    return data.joint(joint).qpos[0] - start


@pytest.mark.parametrize("joint", ["middle_slide_top", "left_slide_top", "top_door_hinge"])
def test_a_part_let_go_coasts_by_its_speed_times_the_decay_time(apartment, joint):
    """x(t) = v tau (1 - exp(-t / tau)) with tau = 1 / (120 ln(1 / 0.7)) s: 1.17 cm from 0.5 m/s."""
    tau = 1.0 / (120.0 * math.log(1.0 / 0.7))
    assert tau == pytest.approx(0.02336, abs=1e-5)
    model = build_apartment(apartment, visuals=False).compile()
    assert coast(model, joint, 0.5) == pytest.approx(0.5 * tau, rel=0.05)


def test_a_model_without_visuals_has_the_same_collisions(apartment, model):
    plain = build_apartment(apartment, visuals=False).compile()
    solid = [model.geom(g).name for g in range(model.ngeom) if model.geom_contype[g]]
    assert [plain.geom(g).name for g in range(plain.ngeom)] == solid
    assert plain.ngeom < model.ngeom
    assert (model.geom_contype == model.geom_conaffinity & ~BUMPER_BIT).all()


def test_a_ball_dropped_on_a_table_stays_at_the_height_of_the_table(apartment):
    spec = build_apartment(apartment, visuals=False)
    table = apartment.piece("table_01").pose
    ball = spec.worldbody.add_body(name="ball", pos=(table.x, table.y, 0.85))
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.03, 0.03, 0.03), mass=0.2)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    assert data.body("ball").xpos == pytest.approx([table.x, table.y, 0.77], abs=2e-3)
    assert np.abs(data.joint("middle_slide_top").qpos) < 1e-4
