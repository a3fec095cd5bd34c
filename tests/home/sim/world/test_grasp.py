"""The magic grasp, the release, and bodies that sleep and wake."""

import numpy as np
import pytest

from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.geoms import ROBOT_BIT
from perdure.home.sim.objects import KINDS, Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import SceneOptions, build_scene
from perdure.home.sim.sensors import SkillGoal
from perdure.home.sim.vector_simulator import VectorSimulator
from tests.home.arm_poses import reach

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def room():
    """An apartment, a table in it, and where the robot stands before it."""
    apartment = make_apartment(0, 0)
    piece = next(p for p in apartment.pieces if p.kind == "table_01")
    surface = piece.receptacles[0]
    x, y, z = (float(v) for v in apartment.surface_to_room(surface, np.zeros(2)))
    stand = Pose(x + 0.75 * np.cos(piece.pose.yaw), y + 0.75 * np.sin(piece.pose.yaw), piece.pose.yaw + np.pi)
    return apartment, np.array([x, y, z]), surface.unique_name, stand


def world_with(room, *offsets, kinds=None, above=0.25, held=-1, approach=None, back=0.0, **options):
    """Objects on the table at offsets from its middle, the gripper level and `above` the surface's middle.

    With `approach` the gripper points there, in the base frame, and its roll is free. The robot stands `back` farther
    away than usual.
    """
    apartment, middle, name, stand = room
    stand = Pose(stand.x - back * np.cos(stand.yaw), stand.y - back * np.sin(stand.yaw), stand.yaw)
    kinds = kinds or ["010_potted_meat_can"] * len(offsets)
    placements = [
        Placement(kind, tuple(np.add(middle, (*o, KINDS[kind].half[2] + 0.001)).tolist()), UPRIGHT, name)
        for kind, o in zip(kinds, offsets, strict=True)
    ]
    rotation = None
    if approach is None:
        rotation = np.eye(3)
    point = stand.to_local(middle + np.array([0.0, 0.0, above]))
    arm = reach(point, ROBOT.rest_arm, rotation=rotation, approach=approach)
    assert arm.ok
    world = VectorSimulator(1)
    scene = build_scene(apartment, placements, options=SceneOptions(**options))
    world.reset(0, scene, stand, arm.arm, held=held, skill_goal=SkillGoal(0))
    return world


def act(world, steps=1, **parts):
    action = np.zeros((1, ROBOT.action_size))
    for name, value in parts.items():
        action[0, {"grip": ROBOT.action.grip, "forward": ROBOT.action.forward, "arm": ROBOT.action.arm}[name]] = value
    for _ in range(steps):
        world.step(action)
    return world.sense()


def distance(world):
    state = world.sense()
    return float(np.linalg.norm(state.object[0] - state.gripper[0]))


@pytest.mark.parametrize(("away", "taken"), [(0.148, True), (0.153, False)])
def test_it_reaches_15_cm_and_no_farther(room, away, taken):
    world = world_with(room, (0.0, 0.0), above=0.0425 + away)
    assert distance(world) == pytest.approx(away, abs=0.001)
    assert bool(act(world, grip=1.0).held[0] == 0) is taken


def test_it_takes_the_nearest_object(room):
    world = world_with(room, (0.09, 0.0), (0.0, 0.05), above=0.14)
    assert act(world, grip=1.0).held[0] == 1


DOWN = np.array([0.5, 0.0, -0.8])
"""A hand that points to the table, 58 degrees down."""


def grasped_from_above(room, kind, rule):
    """Positions (steps, 3) and attitudes (steps, 3, 3) of an object along the gripper's axes while it is grasped."""
    world = world_with(room, (0.0, 0.0), kinds=[kind], above=0.16, approach=DOWN, grasp=rule)
    lane = world.simulator(0)
    positions, attitudes = [], []
    for _ in range(20):
        body = lane.data.body("object_0")
        positions.append(lane.gripper_axes.T @ (body.xpos - lane.gripper))
        attitudes.append(lane.gripper_axes.T @ body.xmat.reshape(3, 3))
        act(world, grip=1.0)
    assert lane.held == 0
    return lane, np.array(positions), np.array(attitudes)


def turned(attitudes):
    """Degrees between the first and the last one."""
    cosine = 0.5 * (np.trace(attitudes[0].T @ attitudes[-1]) - 1.0)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


@pytest.mark.parametrize("kind", ["024_bowl", "013_apple", "007_tuna_fish_can"])
def test_a_grasp_keeps_the_attitude_and_closes_the_distance_bit_by_bit(room, kind):
    lane, positions, attitudes = grasped_from_above(room, kind, "kept")
    assert turned(attitudes) < 1.0
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() < 0.015
    assert np.linalg.norm(positions[0]) - np.linalg.norm(positions[-1]) > 0.04
    assert 0.0 <= lane.hand.clearance(0, 0.1) < 0.003


def test_the_control_a_snapping_grasp_turns_it_and_it_jumps(room):
    lane, positions, attitudes = grasped_from_above(room, "024_bowl", "snapped")
    assert turned(attitudes) > 45.0
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() > 0.1
    assert np.linalg.norm(positions[-1]) < 0.01
    assert lane.hand.clearance(0, 0.1) < 0.0


def test_a_full_hand_takes_nothing_more_and_an_empty_one_with_nothing_near_takes_nothing(room):
    world = world_with(room, (0.3, 0.0), (0.0, 0.0), above=0.15, held=0)
    assert act(world, grip=1.0).held[0] == 0
    assert act(world_with(room, (0.3, 0.3)), grip=1.0).empty_hand[0]


def test_a_handle_goes_before_an_object_and_the_drawer_follows_the_hand(room):
    apartment = room[0]
    link = "drawer2_top"
    handle = apartment.handle_to_room(link, 0.0)
    pose = apartment.piece_of(link).pose
    front = np.array([np.cos(pose.yaw), np.sin(pose.yaw), 0.0])
    stand = Pose(float(handle[0] + 0.8 * front[0]), float(handle[1] + 0.8 * front[1]), pose.yaw + np.pi)
    arm = reach(stand.to_local(handle + 0.08 * front), ROBOT.rest_arm, approach=(1.0, 0.0, -0.3))
    assert arm.ok
    near = Placement("009_gelatin_box", tuple(float(v) for v in handle + 0.1 * front + (0, 0, 0.03)), UPRIGHT, room[2])
    scene = build_scene(apartment, [near])
    number = scene.links.index(link)
    world = VectorSimulator(1)
    world.reset(0, scene, stand, arm.arm, skill_goal=SkillGoal(0, link=number))
    first = act(world, grip=1.0)
    assert (first.held_link[0], first.held[0]) == (number, -1)
    error = first.hold_error[0]
    state = act(world, 30, forward=-0.25)
    assert state.link_position[0] == pytest.approx(0.25, abs=0.04)
    assert state.hold_error[0] == pytest.approx(error, abs=0.02)
    let_go = act(world, 30, grip=-1.0)
    assert let_go.empty_hand[0]
    assert abs(let_go.link_velocity[0]) < 0.01  # it stays where it was left


def test_what_is_held_stays_in_the_hand_while_the_arm_swings(room):
    world = world_with(room, (0.0, 0.0), kinds=["004_sugar_box"], above=0.4, held=0)
    worst = 0.0
    for step in range(60):
        state = act(world, arm=np.sin(0.3 * step) * np.array([1, 1, -1, 1, 1, -1, 1]), forward=0.3 * np.cos(0.2 * step))
        worst = max(worst, state.hold_error[0])
    assert worst < 0.01


def test_a_release_keeps_the_objects_velocity(room):
    world = world_with(room, (0.0, 0.0), above=0.4, held=0)
    for _ in range(8):
        act(world, arm=(1, 0, 0, 0, 0, 0, 0))
    velocity = world.simulator(0).object(0)[1]
    before = velocity.copy()
    assert np.linalg.norm(before[:2]) > 0.2
    act(world, arm=(1, 0, 0, 0, 0, 0, 0), grip=-1.0)
    assert np.allclose(velocity[:2], before[:2], atol=0.08)
    assert velocity[2] - before[2] == pytest.approx(-9.81 / 30, abs=0.1)


def placed_can(room, rule):
    """A can that stands on the table where the hand has released it, and the largest speed that it had since."""
    above = KINDS["002_master_chef_can"].half[2] + 0.002
    world = world_with(room, (0.0, 0.0), kinds=["002_master_chef_can"], above=above, held=0, back=0.1, grasp=rule)
    fastest = 0.0
    for _ in range(10):
        act(world, grip=-1.0)
        fastest = max(fastest, np.linalg.norm(world.simulator(0).object(0)[1]))
    act(world, 20)
    return world, fastest


def driven_into_it(world):
    """How far a can goes while the robot drives forward by a hand's breadth."""
    before = world.sense()
    after = act(world, 20, forward=0.2)
    assert 0.08 < np.linalg.norm(after.base[0, :2] - before.base[0, :2]) < 0.15
    way = np.linalg.norm(after.object[0] - before.object[0])
    assert world.simulator(0).touched(1)[0] == (way > 0.01)
    return way


def test_a_placed_can_collides_with_the_hand_again_and_is_not_hurled_away(room):
    world, fastest = placed_can(room, "kept")
    assert fastest < 0.3
    assert world.sense().object_up[0, 2] > 0.99
    assert driven_into_it(world) > 0.05


def test_the_control_with_the_snapping_grasp_it_passes_through_the_robot_until_the_reset(room):
    world, _ = placed_can(room, "snapped")
    assert driven_into_it(world) < 0.005
    lane = world.simulator(0)
    geoms = lane.scene.object_geoms[0]
    assert not (lane.model.geom_conaffinity[geoms] & ROBOT_BIT).any()
    world.reset(0, lane.scene, Pose(0.0, 0.0, 0.0))
    assert (lane.model.geom_conaffinity[geoms] & ROBOT_BIT).all()


def test_an_object_inside_the_hand_collides_with_it_after_half_a_second(room):
    world = world_with(room, (0.0, 0.0), kinds=["003_cracker_box"], above=0.235, approach=DOWN)
    act(world, grip=1.0)
    lane = world.simulator(0)
    geoms = lane.scene.object_geoms[0]
    lane.object(0)[0][2] += 0.02  # into the hand
    lane.hand.hold_object(0)
    solid = []
    for _ in range(20):
        act(world, grip=-1.0)
        solid.append(bool((lane.model.geom_conaffinity[geoms] & ROBOT_BIT).all()))
    assert solid == [False] * 15 + [True] * 5


def test_two_objects_that_were_both_held_still_collide(room):
    """Each is taken and let go in turn, the second above the first: it comes to rest on top, not inside."""
    half = 0.0418
    world = world_with(room, (0.0, 0.0), (0.3, 0.0), above=0.02, held=0)
    act(world, 20, grip=-1.0)
    lane = world.simulator(0)
    lower = lane.object(0)[0][:3].copy()
    above = np.add(lower, (0.0, 0.0, 2.0 * half + 0.01))
    lane.hand.hold_object(1)
    act(world, grip=-1.0)
    pose = lane.object(1)[0]  # let go right above the other, upright and at rest
    pose[:3], pose[3:] = above, lane.object(0)[0][3:]
    lane.object(1)[1][:] = 0.0
    act(world, 60)
    assert lane.object(1)[0][2] - lane.object(0)[0][2] == pytest.approx(2.0 * half, abs=0.002)


def asleep(world, number):
    lane = world.simulator(0)
    if not hasattr(lane.data, "body_awake") and not hasattr(lane.data, "tree_asleep"):
        pytest.skip("this MuJoCo does not say who sleeps")
    body = lane.model.body(f"object_{number}").id
    tree = lane.model.body_treeid[body]
    return bool(lane.data.tree_asleep[tree] >= 0)


def test_objects_at_rest_sleep_and_wake_when_grasped(room):
    world = world_with(room, (0.0, 0.0), (0.25, 0.25), above=0.15)
    act(world, 60)
    assert asleep(world, 0)
    assert asleep(world, 1)
    act(world, 2, grip=1.0)
    assert world.sense().held[0] == 0
    assert not asleep(world, 0)
    assert asleep(world, 1)  # the control: nobody touched this one
    act(world, 20, arm=(0, -1, 0, 0, 0, 0, 0))
    assert world.sense().hold_error[0] < 0.01


def test_a_sleeping_object_wakes_when_the_robot_touches_it(room):
    world = world_with(room, (0.0, 0.0), kinds=["003_cracker_box"], above=0.3)
    act(world, 60)
    assert asleep(world, 0)
    before = world.sense().object[0].copy()
    for _ in range(40):
        act(world, arm=(0, 1, 0, 0.6, 0, 0.4, 0))
    assert np.linalg.norm(world.sense().object[0] - before) > 0.01
