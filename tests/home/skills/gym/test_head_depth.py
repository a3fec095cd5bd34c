"""The head camera's depth image: right to geometry worked out by hand, and nothing but an addition."""

import os
import subprocess
import sys
from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest
from lanes import drive, make, random_actions

from perdure.errors import PerdureError
from perdure.home.sim.head_camera import FAR, SIDE, HeadCamera
from perdure.home.sim.robot import ROBOT, add_fetch
from perdure.home.skills.gym import HeadDepth, VectorHeadDepth

WALL, BASE = 2.5, (0.3, 0.1)
"""Where the wall's face is along x, and where the robot stands, in [m]."""
ASIDE = {"shoulder_pan_joint": 1.6, "shoulder_lift_joint": 1.5}
"""Joints that take the arm out of the picture."""
STEPS, SEEDS = 6, (5, 6, 7)


@pytest.fixture(scope="module")
def camera():
    try:
        made = HeadCamera()
    except PerdureError as error:
        pytest.skip(f"this machine has neither EGL nor OSMesa: {error}")
    yield made
    made.close()


def room(torso=0.15, yaw=0.0, ball=None):
    """A floor, a wall, the robot and perhaps a ball of 5 cm: what a camera needs of a lane."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(9.0, 9.0, 0.1))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 9.0, 4.0), pos=(WALL + 0.1, 0.0, 0.0))
    if ball is not None:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.05, 0.0, 0.0), pos=ball)
    add_fetch(spec, visuals=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    wanted = {"base_x": BASE[0], "base_y": BASE[1], "base_yaw": yaw, "torso_lift_joint": torso, **ASIDE}
    data.qpos[: len(ROBOT.joint_names)] = [wanted.get(name, 0.0) for name in ROBOT.joint_names]
    mujoco.mj_forward(model, data)
    return SimpleNamespace(model=model, data=data)


def eye_and_axes(x, y, yaw, torso):
    """M3's camera in the room: from (0.17, 0, 1.2) to (0.75, 0, 1.0) with the torso at 0.15. Rows: right, up, ahead."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    ahead = np.array([0.58, 0.0, -0.2]) / np.hypot(0.58, 0.2)
    right = np.array([0.0, -1.0, 0.0])
    axes = np.stack([right, np.cross(right, ahead), ahead]) @ turn.T
    return np.array([x, y, 0.0]) + turn @ [0.17, 0.0, 1.2 + torso - 0.15], axes


def rays(axes):
    """Through every pixel's middle, one meter deep: the picture is 2 m wide there. Shape (side, side, 3)."""
    across = (2.0 * np.arange(SIDE) + 1.0) / SIDE - 1.0
    columns = np.stack(np.broadcast_arrays(across, -across[:, None], 1.0), axis=-1)
    return columns @ axes


@pytest.mark.parametrize("yaw", [0.0, 0.3, -0.5])
def test_a_wall_ahead_is_as_far_as_geometry_says(camera, yaw):
    eye, _ = eye_and_axes(*BASE, yaw, 0.15)
    by_hand = (WALL - eye[0]) / (np.cos(yaw) * 0.58 / np.hypot(0.58, 0.2))
    middle = camera.take(room(yaw=yaw))[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1]
    assert middle.mean() == pytest.approx(by_hand, abs=0.01)


def test_depth_is_planar_up_to_the_edge(camera):
    """The ray to the edge is longer by 1 / cos, the depth is not: a wall across has one depth along a whole row."""
    eye, axes = eye_and_axes(*BASE, 0.0, 0.15)
    top = camera.take(room())[: SIDE // 2].astype(np.float64)
    seen = rays(axes)[: SIDE // 2]
    np.testing.assert_allclose(top, (WALL - eye[0]) / seen[..., 0], atol=0.002)
    cosine = 1.0 / np.linalg.norm(seen, axis=-1)
    np.testing.assert_allclose(eye[0] + (top / cosine) * (seen[..., 0] * cosine), WALL, atol=0.002)
    assert np.ptp(top, axis=1).max() < 0.002
    assert cosine[-1, 0] == pytest.approx(np.sqrt(0.5), abs=0.01)


@pytest.mark.parametrize("torso", [0.05, 0.15, 0.3])
def test_the_camera_rises_with_the_torso(camera, torso):
    eye, axes = eye_and_axes(*BASE, 0.0, torso)
    floor = camera.take(room(torso=torso))[-1, SIDE // 2 :]
    np.testing.assert_allclose(floor, -eye[2] / rays(axes)[-1, SIDE // 2 :, 2], atol=0.002)


@pytest.mark.parametrize("ball", [(1.5, 0.1, 0.9), (1.2, -0.5, 0.8), (2.0, 0.8, 1.4)])
def test_an_object_is_where_it_is_projected_and_as_far(camera, ball):
    eye, axes = eye_and_axes(*BASE, 0.0, 0.15)
    right, up, ahead = axes @ (np.array(ball) - eye)
    row, column = (round((1.0 + each / ahead) * SIDE / 2.0 - 0.5) for each in (-up, right))
    ray = rays(axes)[row, column]
    a, b, c = ray @ ray, ray @ (np.array(ball) - eye), (np.array(ball) - eye) @ (np.array(ball) - eye) - 0.05**2
    assert camera.take(room(ball=ball))[row, column] == pytest.approx((b - np.sqrt(b * b - a * c)) / a, abs=0.002)


def test_nothing_and_what_is_far_is_ten_meters(camera):
    lane = room(yaw=np.pi)
    assert camera.take(lane)[0, 0] == FAR
    assert camera.take(lane).max() == FAR


@pytest.mark.parametrize(("skill", "task"), [("pick", "set_table"), ("place", "tidy_house")])
def test_real_lanes_are_seen_as_rays_hit_them(camera, skill, task):
    env = make(skill, task, lanes=2, clutter=True)
    drive(env, (1, 2), np.stack([random_actions(env, 5, seed) for seed in range(2)], axis=1))
    groups = np.array([1, 1, 1, 1, 0, 0], dtype=np.uint8)
    for lane in map(env.world.simulator, range(2)):
        x, y, yaw, torso = lane.robot[:4]
        eye, axes = eye_and_axes(x, y, yaw, torso)
        some = rays(axes)[3::6, 3::6].reshape(-1, 3)
        geom = np.zeros(1, dtype=np.int32)
        hit = np.array([mujoco.mj_ray(lane.model, lane.data, eye, ray, groups, 1, -1, geom) for ray in some])
        off = np.abs(camera.take(lane)[3::6, 3::6].ravel() - np.where(hit < 0.0, FAR, np.minimum(hit, FAR)))
        assert np.mean(off < 0.005) > 0.98  # the rest are edges, and arms drawn with 28 sides
    env.close()


def test_the_same_state_gives_the_same_image_to_the_last_bit(camera):
    lane = room(yaw=0.2)
    other = HeadCamera()
    np.testing.assert_array_equal(camera.take(lane), camera.take(lane))
    np.testing.assert_array_equal(camera.take(lane), other.take(lane))
    other.close()
    np.testing.assert_array_equal(camera.take(lane), camera.take(lane))


@pytest.fixture(scope="module")
def course(camera):
    """Three lanes driven with the camera: the actions, and what came of them."""
    env = VectorHeadDepth(make("pick", "set_table", lanes=3))
    actions = np.stack([random_actions(env, STEPS, seed) for seed in SEEDS], axis=1)
    seen = drive(env, SEEDS, actions)
    assert all(env.observation_space.contains(step[0]) for step in seen)
    env.close()
    return actions, seen


def test_all_but_the_image_is_as_without_it_to_the_last_bit(course):
    actions, seen = course
    for one, other in zip(seen, drive(make("pick", "set_table", lanes=3), SEEDS, actions), strict=True):
        np.testing.assert_array_equal(one[0]["state"], other[0])
        for mine, theirs in zip(one[1:4], other[1:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_lanes_see_what_single_environments_see(course):
    actions, seen = course
    for lane, seed in enumerate(SEEDS):
        env = HeadDepth(gymnasium.make("perdure/HomePick-v0", task="set_table", split="val", episodes=3))
        alone = [env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions[:, lane])]
        assert all(env.observation_space.contains(each) for each in alone)
        for one, all_lanes in zip(alone, seen, strict=True):
            np.testing.assert_array_equal(one["head_depth"], all_lanes[0]["head_depth"][lane])
            np.testing.assert_array_equal(one["state"], all_lanes[0]["state"][lane])
        env.close()


def test_images_change_as_the_robot_moves(course):
    _, seen = course
    assert (seen[0][0]["head_depth"] != seen[-1][0]["head_depth"]).any(axis=(1, 2)).all()


def test_many_scenes_share_what_is_drawn_with_and_look_as_with_a_camera_of_their_own(camera, monkeypatch):
    """Graphics memory is taken once for scenes with a bowl, their only mesh, and once for scenes without."""
    made, real = [], mujoco.MjrContext
    monkeypatch.setattr(mujoco, "MjrContext", lambda *given: made.append(1) or real(*given))
    env = VectorHeadDepth(make("pick", "set_table", lanes=12, episodes=6))
    seen = env.reset(seed=0)[0]["head_depth"]
    lanes = [env.unwrapped.world.simulator(number) for number in range(12)]
    assert len({lane.scene for lane in lanes}) > 2
    assert {lane.model.nmesh for lane in lanes} == {0, 1}
    assert len(made) == 2
    for image, lane in zip(seen, lanes, strict=True):
        own = HeadCamera()
        np.testing.assert_array_equal(image, own.take(lane) / np.float32(FAR))
        own.close()
    env.close()


def test_what_does_not_fit_is_refused(monkeypatch):
    with pytest.raises(PerdureError, match="env must be a home skill environment"):
        HeadDepth(gymnasium.make("CartPole-v1"))
    with pytest.raises(PerdureError, match="1 to"):
        HeadCamera(0)
    monkeypatch.setenv("MUJOCO_GL", "off")
    with pytest.raises(PerdureError, match="switches pictures off"):
        VectorHeadDepth(make("pick", "set_table"))


def test_nothing_is_drawn_for_those_who_do_not_wrap():
    script = """
import sys, perdure.home.skills.gym as gym
env = gym.HomeSkillEnv(skill="pick", task="set_table", split="val", episodes=1)
env.reset(seed=1)
env.step(env.action_space.sample())
drawn = ("OpenGL", "mujoco.egl", "mujoco.osmesa", "perdure.home.pictures")
print(*[name for name in sys.modules if name.startswith(drawn)])
"""
    free = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}  # MuJoCo loads what it names
    command = [sys.executable, "-c", script]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600, env=free)
    assert loaded.stdout.split() == []
