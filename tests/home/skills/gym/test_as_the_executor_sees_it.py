"""A learner's environment and the executor show the same numbers for the same world."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from lanes import begin_at, make

from perdure.home.evaluate import execute
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.plan_starts import found_states
from perdure.home.sim.pieces import Pose
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import SKILLS, get_skill, learned_skills, make_skill_goal
from perdure.home.skills.environment import HomeSkillVectorEnv
from perdure.home.skills.place import VARIANTS
from perdure.home.skills.starts import region
from perdure.home.tasks.episodes import episode_scene, load_episodes, start_pose
from perdure.home.tasks.planning import make_plan

STEPS, SCENE = 15, SceneOptions(clutter=False, physics_hz=120)


class EnoughError(Exception):
    """Raised to end a run of the executor."""


class Waiting:
    """Stands still through the skills before the one that is looked at."""

    needs_scan = True
    is_oracle = False

    def overtime(self, lane):
        return False

    def begin(self, world, lane, skill):
        pass

    def act(self, world, lanes, skill, state, progress):
        return np.zeros((len(lanes), 11))


class Watching(Waiting):
    """Acts by stored actions, and keeps what it saw."""

    def __init__(self, actions):
        self.actions, self.seen = actions, []

    def act(self, world, lanes, skill, state, progress):
        self.seen.append(skill.observe(state, progress)[0])
        if len(self.seen) > len(self.actions):
            raise EnoughError
        return skill.expand_action(self.actions[len(self.seen) - 1][None], state)


def stopping(name, always, **options):
    """The skill, but it stops after every step, or never."""
    return type(name, (SKILLS[name],), {"stop": lambda self, state, progress: np.full(len(state), always)})(**options)


@pytest.mark.parametrize(
    ("name", "options"),
    [*((name, {}) for name in learned_skills()), *(("place", options) for options in VARIANTS.values())],
)
def test_the_environment_shows_what_the_executor_shows_to_the_last_bit(name, options):
    episode = load_episodes("set_table", "val")[0]
    if name.startswith("close"):  # nothing would be left to do
        episode = replace(episode, opened={episode.container(0): 0.45, "top_door": 2.0})
    plan = make_plan(episode.home_task)
    before = [step.skill for step in plan].index(name)
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (STEPS, get_skill(name, **options).action_size))
    watching = Watching(actions)
    skills = {each: stopping(each, each != name, **(options if each == name else {})) for each in SKILLS}
    agents = {each: watching if each == name else Waiting() for each in SKILLS}
    with pytest.raises(EnoughError):
        list(Executor(skills, agents, ExecutorOptions(lanes=1, threads=1, scene=SCENE)).run([episode]))

    env = HomeSkillVectorEnv(1, skill=name, task="set_table", split="val", episodes=1, threads=1, **options)

    def begin(world, lane, rng):
        """To where the executor was when the skill began: the same start, and as many steps of standing still."""
        scene = episode_scene(episode, SCENE)
        world.reset(lane, scene, start_pose(scene.apartment, episode, 0))
        for _ in range(before):
            world.step(np.zeros((1, 11)))
        world.assign(lane, make_skill_goal(episode, plan[before], world.simulator(lane)))

    env.sampler = SimpleNamespace(begin=begin)
    shown = [env.reset(seed=0)[0][0]]
    for action in actions:
        observations, _, terminated, *_ = env.step(action[None])
        assert not terminated[0]
        shown.append(observations[0])
    np.testing.assert_array_equal(shown, watching.seen)
    assert np.ptp(shown, axis=0).max() > 0.05  # the robot did move


def test_a_recorded_retry_has_the_goal_that_the_executor_gives_it(monkeypatch):
    """The robot stands where a pick may begin; each skill ends after a step. So the second attempt goes elsewhere."""
    episode, navigate = load_episodes("tidy_house", "val")[0], get_skill("navigate")
    space, cells = region(episode.apartment(), {}, get_skill("pick").aim(episode, 0, {}))
    here = space.centers[cells[len(cells) // 2]]
    monkeypatch.setattr(execute, "start_pose", lambda *given: Pose(*here.tolist(), 0.0))
    found, goals, shown = [], [], []

    def observe(world, running):
        step = running[0].current
        if (step.skill, step.attempt) == ("navigate", 2):
            found.extend(found_states(world, running))
            goals.append(world.skill_goal(0))
            state = world.sense(None, navigate.scan_reach, navigate.needs_neighbors)
            shown.append(navigate.observe(state, navigate.begin(state))[0])
            raise EnoughError

    options = ExecutorOptions(lanes=1, threads=1, scene=SCENE, planner="closed")
    agents = {each: Waiting() for each in SKILLS}
    with pytest.raises(EnoughError):
        list(Executor({each: stopping(each, True) for each in SKILLS}, agents, options).run([episode], observe))
    (row,), (goal,) = found, goals
    assert row.attempt == 2
    np.testing.assert_allclose(row.stood, [here] * len(row.stood), atol=0.05)
    starts = [navigate.recorded_start(episode, each) for each in (row, msgspec.structs.replace(row, stood=()))]
    for start, same in zip(starts, (True, False), strict=True):  # the control has forgotten where attempts stood
        env = begin_at(make("navigate", "tidy_house", targets=(0,)), start)
        seen, _ = env.reset(seed=0)
        known = env.world.skill_goal(0)
        assert np.array_equal(known.route.values, goal.route.values) == same
        assert np.allclose(seen, shown, atol=0.005) == same
        assert (known.aim, known.toward, known.goal) == (goal.aim, goal.toward, goal.goal)
        env.close()
