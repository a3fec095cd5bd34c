"""Start states recorded from plans: what they hold, and that an environment begins in them."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from perdure.errors import PerdureError
from perdure.home.evaluate import plan_starts
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.sim.scene import EARLIER, SceneOptions
from perdure.home.skills import environment, get_skill
from perdure.home.skills.environment import HomeSkillVectorEnv, SkillEnvOptions
from perdure.home.skills.starts import TOUCH, put, read_plan_starts, touching
from perdure.home.tasks.episodes import load_episodes

FRIDGE_DOOR = CONTAINERS["fridge"].links[0]
POOL = SimpleNamespace(episodes=load_episodes("set_table", "val").episodes[:3])
USED = {
    **{"pick": {0, 1}, "place": {0, 1}, "navigate": {0, 1}},
    **{"open_drawer": {0}, "close_drawer": {0}, "open_fridge": {1}, "close_fridge": {1}},
}
"""The targets with which SetTable uses each skill."""


@pytest.fixture(scope="module", autouse=True)
def recorded(tmp_path_factory):
    """Three episodes that stand for the training pool, in a cache folder of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(plan_starts, "train_pool", lambda task: POOL)
        patch.setattr(environment, "train_pool", lambda task, count=None: POOL)
        patch.setattr(plan_starts, "RUNS", 1)
        # The physics that the shipped policies were trained with, so that their plans go on to the end.
        earlier = partial(ExecutorOptions, scene=SceneOptions(**EARLIER))
        patch.setattr(plan_starts, "ExecutorOptions", earlier)
        plan_starts.record_plan_starts("set_table")
        yield {skill: by_target(read_plan_starts("set_table", skill)) for skill in USED}


def by_target(rows):
    found = {}
    for row in rows:
        found.setdefault((row.episode, row.step[1]), []).append(row)
    return found


def restored(skill, number, row):
    """A lane of an environment that was brought to a recorded state."""
    env = HomeSkillVectorEnv(skill=skill, task="set_table", threads=1)
    env.reset(seed=0)
    start = get_skill(skill).recorded_start(POOL.episodes[number], row)
    put(env.world, 0, env.sampler.scene(number, row.step[1]), start)
    return env, start


def test_a_plan_leaves_start_states_of_every_skill_and_a_lane_can_begin_in_them(recorded):
    """In most of them; the others are drawn again, as the objects that are no target are not recorded."""
    assert {skill: {target for _, target in found} for skill, found in recorded.items()} == USED
    touched, first = [], [(skill, *key, rows[0]) for skill, found in recorded.items() for key, rows in found.items()]
    for skill, number, target, row in first:
        env, start = restored(skill, number, row)
        lane, state = env.world.simulator(0), env.world.sense()
        touched.append(touching(lane))
        assert state.base[0] == pytest.approx(row.base)
        assert state.object[0] == pytest.approx(row.pose[0], abs=0.005)  # a held one hangs on the gripper point
        assert state.goal[0] == pytest.approx(POOL.episodes[number].goals[target].position)
        assert (lane.held == 0) == ("place" in row.step)
        assert (start.skill_goal.route is not None) == (skill == "navigate")
        env.close()
    assert np.mean(np.array(touched) <= TOUCH) > 0.5


def test_what_the_plan_did_before_is_in_the_states(recorded):
    """The benchmark's conditions of the stage before: a fridge is open from 1.42 rad, an object placed at 0.15 m."""
    picks = [row for (_, target), rows in recorded["pick"].items() if target == 1 for row in rows]
    assert min(row.opened[FRIDGE_DOOR] for row in picks) >= 1.4
    for (number, target), rows in recorded["close_fridge"].items():
        goal = POOL.episodes[number].goals[target].position
        assert np.linalg.norm(np.subtract(rows[0].pose[0], goal)) < 0.15
    assert not any(FRIDGE_DOOR in row.opened for rows in recorded["open_drawer"].values() for row in rows)


def test_half_the_starts_of_training_are_recorded_ones(recorded):
    known = {row.base for rows in recorded["place"].values() for row in rows}
    options = {"skill": "place", "task": "set_table", "episodes": len(POOL.episodes), "threads": 1}
    for training, low, high in ((True, 0.3, 0.7), (False, 0.0, 0.0)):
        env = HomeSkillVectorEnv(60, training=training, **options)
        env.reset(seed=0)
        share = np.mean([tuple(base) in known for base in env.world.sense().base.tolist()])
        assert low <= share <= high
        env.close()


def test_a_recorded_goal_is_where_the_planner_takes_the_object_to_be(recorded):
    """Not where it was at first: the bowl moves with its drawer; what fell is faced where it lies."""
    row = next(row for (_, target), rows in recorded["pick"].items() if target == 0 for row in rows)
    episode = POOL.episodes[row.episode]
    assert np.linalg.norm(np.subtract(row.seen[1], episode.objects[0].position)) > 0.3
    fallen = replace(row, seen=(episode.goals[0].receptacle, (1.0, 2.0, 0.03)), pose=((1.0, 2.0, 0.03), row.pose[1]))
    start = get_skill("pick").recorded_start(episode, fallen)
    assert start.skill_goal.aim == (1.0, 2.0, 0.03)
    assert start.moved[0].position == (1.0, 2.0, 0.03)


@pytest.mark.parametrize("touches", [False, True])
def test_further_attempts_are_drawn_more_often(recorded, monkeypatch, touches):
    """Half of all draws are recorded: five of eight of those from the one retry beside three first attempts."""
    first, draws = next(iter(recorded["pick"].values()))[0], 2000
    rows = [*(replace(first, attempt=1, base=(float(k), 0.0, 0.0)) for k in range(3)), replace(first, attempt=2)]
    monkeypatch.setattr(environment, "read_plan_starts", lambda task, skill: rows)
    sampler = environment.EpisodeSampler(SkillEnvOptions("pick", "set_table", training=True))
    sampler._skill = SimpleNamespace(recorded_start=lambda episode, row: row, draw_start=lambda *given: None)
    drawn = []

    def begin(world, lane, scene, draw, episode, target, rng):
        """A recorded start that touches something is drawn afresh, in the same episode and for the same target."""
        drawn.append([draw(episode, target, rng) for _ in range(1 + touches)])
        assert drawn[-1][0] is None or (episode.index, target) == (first.episode, first.step[1])

    monkeypatch.setattr(environment, "begin", begin)
    monkeypatch.setattr(environment.EpisodeSampler, "scene", lambda *given: None)
    world = SimpleNamespace(simulator=lambda lane: SimpleNamespace(set_rolling=lambda lever: None))
    rng = np.random.default_rng(0)
    for _ in range(draws):
        sampler.begin(world, 0, rng)
    for row, share in [(None, 1 / 2), *((row, 1 / 16) for row in rows[:3]), (rows[3], 5 / 16)]:
        found = np.mean([each[0] == row for each in drawn])
        assert abs(found - share) < 4.0 * np.sqrt(share * (1.0 - share) / draws)
    assert not any(each[1] for each in drawn if touches)


def test_without_a_record_training_says_what_makes_it(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(PerdureError, match="record_plan_starts"):
        environment.EpisodeSampler(SkillEnvOptions("place", "set_table", training=True))
