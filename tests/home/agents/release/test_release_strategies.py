"""The release strategies: what each does between the gripper_goal to let go and the opening of the hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.release import LAG, HandOver, HandOverView, Ik, ReleaseStrategy, lag, make_strategy
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import build_scene
from perdure.home.sim.sensors import SkillGoal
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import Place
from tests.home.arm_poses import reach

GRIP = 9


class Hasty:
    """Swings the arm and drives, and wants to let go at a given step."""

    needs_scan = False
    is_oracle = False

    def __init__(self, at=12, forward=0.3):
        self.at, self.forward = at, forward
        self.asked = 0

    def begin(self, world, lane, skill):
        pass

    def act(self, world, lanes, skill, state, progress):
        self.asked += 1
        actions = np.zeros((len(lanes), ROBOT.action_size))
        actions[:, 0] = self.forward
        actions[:, ROBOT.action.arm] = (-0.5, 0.5, 0.2, -0.3, 0.0, 0.5, 0.0)
        actions[:, GRIP] = np.where(progress.elapsed >= self.at, -1.0, 0.0)
        return actions

    def overtime(self, lane):
        return False


@pytest.fixture(scope="module")
def table():
    """A table, and the robot before it with a box in its hand, level, 10 cm above the surface."""
    apartment = make_apartment(0, 0)
    piece = next(p for p in apartment.pieces if p.kind == "table_01")
    surface = piece.receptacles[0]
    x, y, height = apartment.surface_to_room(surface, np.zeros(2))
    placement = Placement(
        "004_sugar_box", (float(x), float(y), float(height) + 0.3), (1.0, 0.0, 0.0, 0.0), surface.unique_name
    )
    scene = build_scene(apartment, [placement])
    depth = min(s.half[0] for s in piece.solids if s.role != "look")
    return apartment, scene, np.array([x, y, height]), piece.pose, depth


def start(table, clearance=0.10, rotation=None):
    _, scene, surface, pose, _ = table
    base = Pose(
        float(surface[0] + 0.8 * np.cos(pose.yaw)), float(surface[1] + 0.8 * np.sin(pose.yaw)), pose.yaw + np.pi
    )
    point = base.to_local(surface + np.array([0.0, 0.0, 0.088 + clearance]))
    found = reach(point, ROBOT.rest_arm, rotation=np.eye(3) if rotation is None else rotation)
    assert found.ok
    world = VectorSimulator(1)
    goal = tuple(float(v) for v in surface + np.array([0.0, 0.0, 0.088]))
    world.reset(0, scene, base, found.arm, held=0, skill_goal=SkillGoal(0, goal))
    return world


def play(world, agent, steps=250):
    """Runs place with an agent until the hand is open; the state of every step."""
    skill = Place()
    lanes = np.array([0])
    state = world.sense()
    progress, seen = skill.begin(state), [state]
    agent.begin(world, 0, skill)
    for _ in range(steps):
        action = skill.mask(agent.act(world, lanes, skill, state, progress), state)
        world.step(action)
        state = world.sense()
        progress = skill.advance(progress, state)
        seen.append(state)
        if progress.released[0]:
            return seen
    raise AssertionError("the hand never opened")


def test_the_policy_alone_lets_go_in_motion_and_a_stop_takes_that_away(table):
    speed = {}
    for name in ("rl", "stop"):
        seen = play(start(table), make_strategy(name, Hasty()))
        speed[name] = float(np.linalg.norm(seen[-2].gripper_velocity[0]))
    assert speed["rl"] > 0.2  # the control: without it a stop would prove nothing
    assert speed["stop"] < 0.03


@pytest.mark.parametrize("name", ["stop", "ik", "guarded"])
def test_the_base_comes_back_to_where_it_stood_when_the_policy_was_frozen(table, name):
    """At 0.75 m/s backwards the base rolls on; M3's stops at once."""
    agent = make_strategy(name, Hasty(at=8, forward=-0.75))
    seen = play(start(table), agent)
    frozen = 9  # the policy acted in eight steps; it asked to let go after the eighth
    away = [float(np.hypot(*(each.base[0, :2] - seen[frozen - 1].base[0, :2]))) for each in seen]
    assert max(away[frozen:]) > 0.03, "the control: without driving back it would be let go there"
    assert away[-2] < 0.012
    assert abs(seen[-2].base[0, 2] - seen[frozen - 1].base[0, 2]) < 0.012


@pytest.mark.parametrize("name", ["ik", "guarded"])
def test_beside_its_goal_nothing_is_lowered_and_a_label_says_so(table, name):
    """The thesis assumes that the hand is right above the goal region."""
    world = start(table)
    goal = np.add(world.skill_goal(0).goal, (0.2, 0.0, 0.0))
    world.assign(0, SkillGoal(0, tuple(map(float, goal))))
    agent = make_strategy(name, Hasty(at=0))
    seen = play(world, agent)
    assert agent.outcomes == ["not above the goal"]
    assert abs(seen[-2].gripper[0, 2] - seen[1].gripper[0, 2]) < 0.01


def test_ik_goes_straight_down_by_epsilon_with_the_base_still(table):
    strategy = HandOver(Hasty(at=0), Ik(epsilon=0.06))
    seen = play(start(table), strategy)
    way = seen[-2].gripper[0] - seen[1].gripper[0]
    assert way[2] == pytest.approx(-0.06, abs=0.006)
    assert np.hypot(*way[:2]) < 0.01
    assert np.abs(seen[-2].base - seen[1].base).max() < 0.01
    assert np.abs(seen[-2].gripper_rotation - seen[1].gripper_rotation).max() < 0.06
    assert strategy.outcomes == ["done"]


@pytest.mark.parametrize("clearance", [0.02, 0.12])
def test_a_guarded_descent_sets_the_object_down_and_does_not_press_on_it(table, clearance):
    strategy = make_strategy("guarded", Hasty(at=0))
    seen = play(start(table, clearance=clearance), strategy)
    assert strategy.outcomes == ["done"]
    bottom = seen[-2].object[0, 2] - 0.088 - table[2][2]
    assert abs(bottom) < 0.012
    assert abs(lag(HandOverView(seen[-2]))) < LAG / 2


def test_a_guarded_descent_into_free_air_ends_without_contact(table, monkeypatch):
    monkeypatch.setattr("perdure.home.agents.release.DEEPEST", 0.08)
    strategy = make_strategy("guarded", Hasty(at=0))
    seen = play(start(table, clearance=0.12), strategy)
    assert strategy.outcomes == ["no contact"]
    assert seen[-2].gripper[0, 2] - seen[1].gripper[0, 2] == pytest.approx(-0.08, abs=0.008)


def test_a_target_out_of_reach_is_a_labeled_fall_back(table):
    strategy = HandOver(Hasty(at=0), Ik(epsilon=0.9))
    seen = play(start(table), strategy)
    assert strategy.outcomes == ["out of reach"]
    assert abs(seen[-2].gripper[0, 2] - seen[1].gripper[0, 2]) < 0.02


def test_the_policy_is_not_asked_while_the_hand_over_runs(table):
    inner = Hasty(at=0)
    seen = play(start(table), make_strategy("ik", inner))
    assert inner.asked == 1
    assert len(seen) > 10


@pytest.mark.parametrize("name", ReleaseStrategy.kinds())
def test_at_the_time_out_the_release_strategy_runs(table, name, monkeypatch):
    """The executor gives a hand-over the time it needs; the policy alone gets none."""
    agent = make_strategy(name, Hasty(at=10**6))
    assert agent.overtime(0) == (name != "rl")
    if name == "rl":
        return
    world = start(table)
    skill, lanes = Place(), np.array([0])
    monkeypatch.setattr(Place, "step_limit", 5)
    state = world.sense()
    progress = skill.begin(state)
    agent.begin(world, 0, skill)
    for _ in range(200):
        world.step(skill.mask(agent.act(world, lanes, skill, state, progress), state))
        state = world.sense()
        progress = skill.advance(progress, state)
        if state.held[0] < 0:
            break
    assert state.held[0] < 0
    assert agent.outcomes


def test_unknown_strategies_are_refused():
    with pytest.raises(PerdureError, match="guarded"):
        make_strategy("gentle", Hasty())


def act(agent, world, lanes=(0,)):
    state, skill = world.sense(), Place()
    return agent.act(world, np.array(lanes), skill, state, skill.begin(state))


def test_a_hand_over_that_was_cut_off_does_not_go_on_in_the_next_place(table):
    world, inner = start(table), Hasty(at=0)
    agent = make_strategy("stop", inner)
    agent.begin(world, 0, Place())
    act(agent, world)
    inner.at = 99
    agent.begin(world, 0, Place())
    assert act(agent, world)[0, 0] == inner.forward, "the policy acts"


def test_a_hand_that_touches_down_too_early_is_blocked_and_not_done(table):
    agent = HandOver(Hasty(at=0), Ik(epsilon=0.12))
    play(start(table, clearance=0.02), agent)
    assert agent.outcomes == ["blocked"]


def test_an_object_that_leaves_the_hand_meanwhile_is_lost(table):
    world, agent = start(table), make_strategy("ik", Hasty(at=0))
    agent.begin(world, 0, Place())
    act(agent, world)
    world.simulator(0).release()
    act(agent, world)
    assert agent.outcomes == ["lost on the way"]


class OneLetsGo(Hasty):
    """Every lane drives at its own speed, and lane 1 wants to let go."""

    def act(self, world, lanes, skill, state, progress):
        actions = super().act(world, lanes, skill, state, progress)
        actions[:, 0], actions[:, GRIP] = 0.1 * (1 + lanes), np.where(lanes == 1, -1.0, 0.0)
        return actions


def test_a_hand_over_of_one_lane_leaves_the_others_to_their_policy(table):
    world, skill = start(table), Place()
    state = world.sense()[np.zeros(3, dtype=np.int64)]
    alike = SimpleNamespace(simulator=lambda lane: world.simulator(0))
    agent = make_strategy("stop", OneLetsGo())
    for _ in range(2):
        actions = agent.act(alike, np.arange(3), skill, state, skill.begin(state))
        assert actions[:, 0] == pytest.approx([0.1, 0.0, 0.3])


def test_the_way_back_of_the_base_is_in_its_own_frame(table):
    state = start(table).sense()
    view = HandOverView(replace(state, base=np.array([[1.0, 2.0, np.pi / 2]])))
    view.state = replace(state, base=np.array([[1.0, 1.9, np.pi / 2]]))
    assert view.base_error == pytest.approx((0.1, 0.0))
