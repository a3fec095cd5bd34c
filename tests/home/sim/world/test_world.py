"""The stepper: state against MuJoCo, lanes that do not know of each other, blow-ups that stay alone."""

import mujoco
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.sim.occupancy import free_space
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import SceneOptions, build_scene
from perdure.home.sim.sensors import BEAMS, SCAN_ANGLES, SCAN_RANGE, SkillGoal
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import episode_scene, load_episodes, start_pose
from tests.home.arm_poses import reach


@pytest.fixture(scope="module")
def episodes():
    return load_episodes("set_table", "val")


def begin(world, lane, episode, seed=0, **options):
    scene = episode_scene(episode)
    world.reset(
        lane,
        scene,
        start_pose(scene.apartment, episode, seed),
        skill_goal=SkillGoal(0, episode.goals[0].position, 5),
        **options,
    )
    return scene


def wiggle(rng, n):
    return rng.uniform(-1.0, 1.0, (n, ROBOT.action_size))


def test_sensors_agree_with_mujocos_own_kinematics(episodes):
    world, rng = VectorSimulator(1), np.random.default_rng(0)
    scene = begin(world, 0, episodes[0])
    for _ in range(25):
        world.step(wiggle(rng, 1))
    state, lane = world.sense(), world.simulator(0)
    data = mujoco.MjData(lane.model)
    data.qpos[:] = lane.qpos
    mujoco.mj_forward(lane.model, data)
    assert np.allclose(state.gripper[0], data.site("gripper").xpos, atol=1e-9)
    assert np.allclose(state.object[0], data.body("object_0").xpos, atol=1e-9)
    assert np.allclose(state.object_up[0], data.body("object_0").xmat.reshape(3, 3)[:, 2], atol=1e-9)
    handle = scene.apartment.articulations[5].handle_name
    assert np.allclose(state.handle[0], data.site(handle).xpos, atol=1e-9)
    yaw = state.base[0, 2]
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    assert np.allclose(about_z @ state.gripper_rotation[0], data.site("gripper").xmat.reshape(3, 3), atol=1e-9)


def test_frames_are_turned_the_right_way(episodes):
    world = VectorSimulator(1)
    scene = episode_scene(episodes[0])
    world.reset(0, scene, Pose(4.0, 2.0, np.pi / 2))
    state = world.sense()
    assert np.allclose(state.in_base(np.array([[4.0, 3.0, 0.5]])), [[1.0, 0.0, 0.5]], atol=1e-12)
    assert np.allclose(state.turned_to_base(np.array([[1.0, 0.0, 0.0]])), [[0.0, -1.0, 0.0]], atol=1e-12)
    assert np.allclose(state.gripper_in_base[0], ROBOT.rest_position, atol=1e-5)
    forward = state.turned_to_gripper(state.gripper * 0.0 + np.array([[0.0, 1.0, 0.0]]))
    assert np.allclose(forward[0], state.gripper_rotation[0].T @ [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("column", "expected"), [(ROBOT.action.forward, (1.0, 0.0, 0.0)), (ROBOT.action.turn, (0.0, 0.0, 1.0))]
)
def test_the_base_drives_as_fast_as_it_is_told(episodes, column, expected):
    world = VectorSimulator(1)
    scene = build_scene(episodes[0].apartment(), [])
    start = start_pose(scene.apartment, episodes[0], 0)
    world.reset(0, scene, start)
    action = np.zeros((1, ROBOT.action_size))
    action[0, column] = 0.4
    before = world.sense().base[0]
    for _ in range(20):
        world.step(action, base_speed=0.5)
    moved = world.sense()
    along = moved.base[0] - before
    way = np.array([along[0] * np.cos(start.yaw) + along[1] * np.sin(start.yaw), 0.0, along[2]])
    assert np.allclose(way, np.array(expected) * 0.2 * 20 / 30, atol=0.02)
    assert np.allclose(moved.base_velocity[0], np.array(expected) * 0.2, atol=0.01)


@pytest.mark.parametrize("heading", [0.0, 20.0, 45.0])
def test_the_base_keeps_its_line_and_brakes_alike_at_every_heading(empty_room, heading):
    apartment, middle, _ = empty_room
    world, yaw = VectorSimulator(1), np.radians(heading)
    world.reset(0, build_scene(apartment, []), Pose(middle[0], middle[1], yaw))
    begin, most, action = world.sense().base[0, :2], 0.0, np.zeros((1, ROBOT.action_size))
    action[0, ROBOT.action.forward] = 1.0
    for _ in range(15):
        world.step(action)
        most = max(most, abs(world.sense().base_velocity[0, 1]))
    before = world.sense().base[0, :2]
    for _ in range(20):
        world.step(np.zeros((1, ROBOT.action_size)))
    after = world.sense().base[0, :2]
    assert np.linalg.norm(after - before) == pytest.approx(0.073, abs=0.003)
    assert abs((after - begin) @ [-np.sin(yaw), np.cos(yaw)]) < 0.005
    assert most < 0.02


@pytest.mark.parametrize(("options", "fastest"), [({}, 1.0), ({"base_speed": 3.0}, 3.0), ({"base_speed": 0.3}, 0.3)])
def test_the_base_is_no_faster_than_the_physics_allows(empty_room, options, fastest):
    apartment, middle, _ = empty_room
    world = VectorSimulator(1)
    world.reset(0, build_scene(apartment, [], options=SceneOptions(**options)), Pose(middle[0] - 2.0, middle[1], 0.0))
    action = np.zeros((1, ROBOT.action_size))
    action[0, ROBOT.action.forward] = 1.0
    for _ in range(20):
        world.step(action, base_speed=3.0)
    assert world.sense().base_velocity[0, 0] == pytest.approx(fastest, rel=0.02)
    action[0, [ROBOT.action.forward, ROBOT.action.turn]] = 0.0, 1.0
    for _ in range(20):
        world.step(action, base_speed=3.0)
    assert world.sense().base_velocity[0, 2] == pytest.approx(fastest, rel=0.02)


def test_furniture_stops_the_base(episodes):
    apartment = episodes[0].apartment()
    sofa = next(piece for piece in apartment.pieces if piece.kind == "sofa")
    x, y = sofa.pose.to_room(np.array([1.6, 0.0]))
    world = VectorSimulator(1)
    world.reset(0, build_scene(apartment, []), Pose(float(x), float(y), sofa.pose.yaw + np.pi))
    action = np.zeros((1, ROBOT.action_size))
    action[0, ROBOT.action.forward] = 1.0
    for _ in range(60):
        world.step(action)
    front = sofa.pose.to_local(world.sense().base[:, :2])[0, 0]
    assert 0.7 < front < 0.9  # its own radius of 0.285 m before the seat's edge at 0.48 m
    assert abs(world.sense().base_velocity[0, 0]) < 0.02


def test_arm_steps_move_the_servos_targets_and_the_arm_follows(episodes):
    world = VectorSimulator(1)
    world.reset(0, build_scene(episodes[0].apartment(), []), start_pose(episodes[0].apartment(), episodes[0], 0))
    action = np.zeros((1, ROBOT.action_size))
    action[0, ROBOT.action.arm] = (1.0, 0.0, 0.0, -0.5, 0.0, 0.0, 2.0)  # the last one is cut to 1
    for _ in range(10):
        world.step(action)
    state = world.sense()
    assert np.allclose(
        state.arm_target[0] - ROBOT.rest_arm, 10 * 0.025 * np.array([1, 0, 0, -0.5, 0, 0, 1]), atol=1e-12
    )
    assert np.abs(state.arm - state.arm_target).max() < 0.05


def test_a_lane_depends_on_nothing_but_itself(episodes):
    """Alone, beside others, on two threads and stepped in parts: the same bits."""
    runs = []
    for lanes, threads, mine in ((1, 1, 0), (3, 1, 1), (3, 2, 2)):
        world, rng = VectorSimulator(lanes, threads), np.random.default_rng(7)
        for lane in range(lanes):
            begin(world, lane, episodes[3 if lane == mine else 11 + lane])
        for step in range(30):
            actions = np.random.default_rng(step).uniform(-1, 1, (lanes, ROBOT.action_size))
            actions[mine] = wiggle(rng, 1)
            if lanes == 3 and step % 2:
                world.step(actions[[mine]], np.array([mine]))
            else:
                world.step(actions)
        runs.append((world.simulator(mine).qpos.copy(), world.sense(np.array([mine]))))
        world.close()
    for qpos, state in runs[1:]:
        assert np.array_equal(qpos, runs[0][0])
        for name in ("gripper", "contact_force", "base_velocity", "object_up"):
            assert np.array_equal(getattr(state, name), getattr(runs[0][1], name)), name


def test_a_lane_that_is_used_again_is_as_good_as_new(episodes):
    used, fresh = VectorSimulator(1), VectorSimulator(1)
    begin(used, 0, episodes[1], held=3)
    for _ in range(20):
        used.step(wiggle(np.random.default_rng(1), 1))
    begin(used, 0, episodes[2])
    begin(used, 0, episodes[1])
    begin(fresh, 0, episodes[1])
    for step in range(20):
        action = wiggle(np.random.default_rng(step), 1)
        used.step(action)
        fresh.step(action)
    assert np.array_equal(used.simulator(0).qpos, fresh.simulator(0).qpos)
    assert np.array_equal(used.simulator(0).model.geom_conaffinity, fresh.simulator(0).model.geom_conaffinity)


def test_a_lane_that_blows_up_is_put_back_alone(episodes):
    disturbed, calm = VectorSimulator(2), VectorSimulator(2)
    for world in (disturbed, calm):
        begin(world, 0, episodes[0])
        begin(world, 1, episodes[1])
    start = disturbed.simulator(0).qpos.copy()
    for step in range(6):
        actions = wiggle(np.random.default_rng(step), 2)
        if step == 3:
            disturbed.simulator(0).qvel[20] = np.nan
        disturbed.step(actions)
        calm.step(actions)
        assert disturbed.sense().diverged.tolist() == [step == 3, False]
        if step == 3:
            assert np.array_equal(disturbed.simulator(0).qpos, start)
        assert all(np.isfinite(getattr(disturbed.sense(), name)).all() for name in ("base", "object", "gripper"))
    assert np.array_equal(disturbed.simulator(1).qpos, calm.simulator(1).qpos)


@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])
def test_the_scan_measures_a_wall(empty_room, heading):
    """1.5 m before each of the four walls of an empty room, so that every direction of the room is looked at."""
    bare, middle, half = empty_room
    forward = np.array([np.cos(heading), np.sin(heading)])
    x, y = (float(v) for v in middle + forward * (np.abs(forward * half).sum() - 1.5))
    world = VectorSimulator(1)
    world.reset(0, build_scene(bare, []), Pose(x, y, heading))
    ranges = world.sense(scan_reach=SCAN_RANGE).scan[0]
    assert ranges.shape == (BEAMS,)
    ahead = np.cos(SCAN_ANGLES) > np.cos(np.radians(30.0))
    assert np.allclose(ranges[ahead] * np.cos(SCAN_ANGLES[ahead]), 1.5, atol=0.03)
    assert ranges.max() <= SCAN_RANGE
    assert np.all(world.sense().scan == SCAN_RANGE)


def test_the_scan_agrees_with_rays_through_the_model(episodes):
    """MuJoCo's own rays, in many planes from the floor up: the nearest of them is what the scan says."""
    world, rng = VectorSimulator(1), np.random.default_rng(0)
    scene = build_scene(episodes[0].apartment(), [])
    space, compared = free_space(scene.apartment), 0
    opened = {scene.links[k]: 0.3 for k in range(0, len(scene.links), 2)}
    groups, geom = np.array([1, 1, 0, 1, 0, 0], dtype=np.uint8), np.full(1, -1, dtype=np.int32)
    for x, y in space.centers[rng.integers(len(space.centers), size=6)]:
        pose = Pose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))
        world.reset(0, scene, pose, opened=opened)
        ranges, lane = world.sense(scan_reach=SCAN_RANGE).scan[0], world.simulator(0)
        lane.qpos[scene.robot_qpos][:2] += 100.0  # out of the rays' way
        mujoco.mj_forward(lane.model, lane.data)
        for beam in range(BEAMS):
            angle = pose.yaw + SCAN_ANGLES[beam]
            ray = np.array([np.cos(angle), np.sin(angle), 0.0])
            hits = [
                mujoco.mj_ray(lane.model, lane.data, np.array([x, y, z]), ray, groups, 1, -1, geom)
                for z in np.arange(0.055, 1.5, 0.02)
            ]
            found = min([SCAN_RANGE, *(hit for hit in hits if hit >= 0.0)])
            compared += abs(found - ranges[beam]) < 0.02
    assert compared >= 0.97 * 6 * BEAMS  # a beam that grazes a corner, or a foot thinner than the planes lie apart


def test_a_scan_that_looks_less_far_sees_the_same_within_its_reach(episodes):
    rng, world, met = np.random.default_rng(2), VectorSimulator(4), 0
    scene = episode_scene(episodes.episodes[4])
    space = free_space(scene.apartment)
    for _ in range(5):
        for lane, (x, y) in enumerate(space.centers[rng.integers(len(space.centers), size=4)]):
            world.reset(lane, scene, Pose(float(x), float(y), rng.uniform(-3, 3)))
        far = world.sense(scan_reach=SCAN_RANGE).scan
        for near in (0.5, 1.3, 3.0):
            seen = world.sense(scan_reach=near).scan
            assert np.array_equal(seen, np.where(far <= near, far, SCAN_RANGE))
            met += (seen < SCAN_RANGE).sum()
    assert met > 100


def test_the_scan_of_a_lane_does_not_depend_on_its_neighbors(episodes):
    rng = np.random.default_rng(1)
    scenes = [episode_scene(episode) for episode in episodes.episodes[:3]]
    together, alone = VectorSimulator(3), VectorSimulator(1)
    poses = [
        Pose(*scene.apartment.pieces[0].pose.to_room(np.array([1.5, 0.0]))[:2], rng.uniform(-3, 3)) for scene in scenes
    ]
    for lane, (scene, pose) in enumerate(zip(scenes, poses, strict=True)):
        together.reset(lane, scene, pose)
    for lane, (scene, pose) in enumerate(zip(scenes, poses, strict=True)):
        alone.reset(0, scene, pose)
        assert np.array_equal(together.sense(None, 2.0).scan[lane], alone.sense(None, 2.0).scan[0])


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((1, 3)), "shape"),
        (np.full((1, ROBOT.action_size), np.nan), "finite"),
        (np.zeros((2, ROBOT.action_size)), "shape"),
    ],
)
def test_wrong_actions_are_refused(episodes, actions, message):
    world = VectorSimulator(1)
    begin(world, 0, episodes[0])
    with pytest.raises(PerdureError, match=message):
        world.step(actions)


def test_wrong_worlds_are_refused():
    with pytest.raises(PerdureError, match="at least one lane"):
        VectorSimulator(0)
    with pytest.raises(PerdureError, match="not reset"):
        VectorSimulator(1).simulator(0)
    with pytest.raises(PerdureError, match="physics_hz"):
        SceneOptions(physics_hz=100)


def test_scenes_are_kept_and_never_changed(episodes):
    scene = episode_scene(episodes[4])
    assert episode_scene(episodes[4]) is scene
    before = scene.model.geom_conaffinity.copy()
    world = VectorSimulator(1)
    begin(world, 0, episodes[4], held=0)
    world.step(wiggle(np.random.default_rng(0), 1))
    assert np.array_equal(scene.model.geom_conaffinity, before)
    assert not np.array_equal(world.simulator(0).model.geom_conaffinity, before)


def test_inverse_kinematics_and_the_lane_agree_on_where_the_gripper_is(episodes):
    world = VectorSimulator(1)
    found = reach((0.7, 0.1, 0.9), ROBOT.rest_arm)
    world.reset(
        0, build_scene(episodes[0].apartment(), []), start_pose(episodes[0].apartment(), episodes[0], 0), found.arm
    )
    assert np.allclose(world.sense().gripper_in_base[0], (0.7, 0.1, 0.9), atol=1e-3)


def test_the_scan_knows_the_present_only_not_when_one_looked_before(episodes):
    """A door that opens bit by bit, seen all the way and seen once: the same furniture, the same ranges."""
    scene = episode_scene(episodes[0])
    fridge = scene.apartment.piece_of("top_door").pose
    x, y = fridge.to_room(np.array([1.6, 0.0]))
    watched, once = VectorSimulator(1), VectorSimulator(1)
    for world in (watched, once):
        world.reset(0, scene, Pose(float(x), float(y), fridge.yaw + np.pi))
    door = scene.link_qpos[scene.links.index("top_door")]
    seen = []
    for angle in np.linspace(0.0, 1.2, 250):
        for world in (watched, once):
            world.simulator(0).qpos[door] = angle
        seen.append(watched.sense(scan_reach=SCAN_RANGE).scan[0])
        assert len(seen) % 50 or np.array_equal(seen[-1], once.sense(scan_reach=SCAN_RANGE).scan[0])
    assert not np.array_equal(seen[0], seen[-1])  # the door is in view
