"""The executor: open loop, lanes that do not know of each other, and what it writes down."""

import numpy as np
import pytest

from perdure.home.agents import Scripted
from perdure.home.agents.oracle import Oracle
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import LIMITS, goal_stabilizing, handling_of, latched_stages
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.sim.world import ACTION_SIZE
from perdure.home.skills import SKILLS, get_skill


class Idle:
    """Does nothing, for ever."""

    sees = False

    def begin(self, world, lane, skill):
        pass

    def act(self, world, lanes, skill, state, progress):
        return np.zeros((len(lanes), ACTION_SIZE))

    def overtime(self, lane):
        return False


def run(actor, episodes, **options):
    skills = {name: get_skill(name) for name in SKILLS}
    actors = {name: Scripted() if name == "reset_arm" else actor for name in SKILLS}
    executor = Executor(skills, actors, ExecutorOptions(**options))
    return {log.episode.name: log for log in executor.run(episodes)}


@pytest.fixture(scope="module")
def set_table():
    return load_episodes("set_table", "val")


@pytest.fixture(scope="module")
def solved(set_table):
    return run(Oracle(), [set_table[0]], lanes=1)[set_table[0].name]


def test_the_plan_runs_to_its_end_whatever_becomes_of_it(set_table):
    log = run(Idle(), [set_table[5]], lanes=1)[set_table[5].name]
    plan = set_table[5].home_task.skills
    assert log.skills[-1].ending == "task limit"
    for done, step in zip(log.skills[:-1], plan, strict=False):
        assert (done.skill, done.target) == (step.skill, step.target)
        # Reset-arm and, with an empty hand at rest, place are over at once by their own stop rules.
        assert done.end - done.begin == (1 if step.skill in ("reset_arm", "place") else LIMITS[step.skill])
        assert done.ending == ("stopped" if step.skill in ("reset_arm", "place") else "timed out")
    assert not log.latched.any()


def test_an_episode_ends_at_the_limit_of_its_task(set_table):
    log = run(Idle(), [set_table[5]], lanes=1, settle_steps=5)[set_table[5].name]
    assert log.steps == set_table[5].home_task.max_steps
    assert len(log.active) == log.steps + 5


def test_what_is_written_down_agrees_with_the_tasks_own_counting(solved):
    task = solved.episode.home_task
    before_settling = solved.facts[: solved.steps]
    assert np.array_equal(latched_stages(task, before_settling)[-1], solved.latched)
    assert solved.latched.all()
    assert goal_stabilizing(solved.facts, handling_of(task, solved.active)).all()
    assert [done.end for done in solved.skills][:-1] == [done.begin for done in solved.skills][1:]


def test_an_episode_does_not_depend_on_its_neighbors(set_table, solved):
    together = run(Oracle(), [set_table[3], set_table[0], set_table[8]], lanes=2, threads=2)[solved.episode.name]
    for name in ("base", "gripper", "object_up", "object_speed", "contact_force", "active"):
        assert np.array_equal(getattr(together, name), getattr(solved, name)), name
    assert np.array_equal(together.facts.object_positions, solved.facts.object_positions)
    assert together.skills == solved.skills


def test_another_evaluation_seed_is_another_run(set_table, solved):
    other = run(Idle(), [set_table[0]], lanes=1, eval_seed=1, settle_steps=0)[solved.episode.name]
    assert not np.allclose(other.base[0], solved.base[0])


def test_skills_without_an_actor_are_refused():
    with pytest.raises(HomeError, match="pick"):
        Executor({"pick": get_skill("pick")}, {}, None)
