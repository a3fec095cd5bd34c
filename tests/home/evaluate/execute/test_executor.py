"""The executor: open loop, lanes that do not know of each other, and what it writes down."""

from dataclasses import replace

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Scripted
from perdure.home.agents.release import HandOver, Stop
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate.execute import OVERTIME, Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import latched, stabilizing
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import SKILLS, get_skill
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planners import OpenLoop, Planner, needed_skills
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import NOTHING, SOMETHING_ELSE, TASKS, SkillStep, get_task
from tests.home.limits import shorten

LIMIT, MOST = 40, 450
"""Step limits of a skill and of the task."""


class Idle:
    """Does nothing, for ever."""

    needs_scan = False
    is_oracle = False

    def begin(self, world, lane, skill):
        pass

    def act(self, world, lanes, skill, state, progress):
        return np.zeros((len(lanes), ROBOT.action_size))

    def overtime(self, lane):
        return False


def run(agent, episodes, **options):
    skills = {name: get_skill(name) for name in SKILLS}
    agents = {name: Scripted() if name == "reset_arm" else agent for name in SKILLS}
    executor = Executor(skills, agents, ExecutorOptions(**options))
    return {log.index: log for log in executor.run(episodes)}


@pytest.fixture(scope="module")
def set_table():
    return load_episodes("set_table", "val")


@pytest.fixture(scope="module")
def solved(set_table):
    return run(Oracle(), [set_table[0]], lanes=1)[0]


@pytest.fixture(scope="module")
def idle(set_table):
    """An episode without clutter in which nobody does anything, with about a tenth of the benchmark's limits."""
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, LIMIT, MOST)
        return run(Idle(), [set_table[5]], lanes=1, settle_steps=5, scene=SceneOptions(clutter=False))[5]


def test_the_plan_runs_to_its_end_whatever_becomes_of_it(set_table, idle):
    log = idle
    plan = make_plan(set_table[5].home_task)
    assert log.runs[-1].ending == "task limit"
    for done, step in zip(log.runs[:-1], plan, strict=False):
        assert (done.skill, done.target) == (step.skill, step.target)
        # Reset-arm and, with an empty hand at rest, place are over at once by their own stop rules.
        assert done.end - done.begin == (1 if step.skill in ("reset_arm", "place") else LIMIT)
        assert done.ending == ("stopped" if step.skill in ("reset_arm", "place") else "timed out")
    assert not any(latched(log))


def test_an_episode_ends_at_the_limit_of_its_task(set_table, idle):
    assert idle.steps == MOST
    assert idle.length == idle.steps + 5
    assert idle.run_at(idle.steps) is None
    assert idle.run_at(idle.steps - 1) == idle.runs[-1]


def test_what_is_written_down_agrees_with_the_tasks_own_counting(solved):
    met = np.stack([stage.met(solved.history.facts) for stage in solved.home_task.stages], axis=-1)
    reached = np.zeros(met.shape[1], dtype=bool)
    for now in met[: solved.steps]:
        reached = np.logical_and.accumulate(reached | now)
    assert tuple(reached) == latched(solved)
    assert all(latched(solved))
    assert all(stabilizing(solved))
    assert [done.end for done in solved.runs][:-1] == [done.begin for done in solved.runs][1:]


def test_an_episode_does_not_depend_on_its_neighbors(set_table, solved):
    together = run(Oracle(), [set_table[3], set_table[0]], lanes=2, threads=2)[0]
    for name in ("base", "gripper", "up", "speed", "force"):
        assert np.array_equal(getattr(together.history, name), getattr(solved.history, name)), name
    assert np.array_equal(together.history.facts.object_positions, solved.history.facts.object_positions)
    assert together.runs == solved.runs


def test_another_evaluation_seed_is_another_run(set_table, solved, monkeypatch):
    for skill in SKILLS:
        monkeypatch.setattr(SKILLS[skill], "step_limit", 1)
    other = run(Idle(), [set_table[0]], lanes=1, eval_seed=1, settle_steps=1)[0]
    assert not np.allclose(other.history.base[0], solved.history.base[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settle_steps": 0}, "settle_steps must be 1 or more, not 0"),
        ({"lanes": 0}, "lanes must be 1 or more, not 0"),
        ({"scene": SceneOptions(physics_hz=90)}, "physics_hz must be 120 or more, not 90"),
        ({"scene": SceneOptions(targets=(0, 1))}, r"targets must be None where plans are executed, not \(0, 1\)"),
    ],
)
def test_an_execution_that_cannot_work_is_refused(options, message):
    with pytest.raises(PerdureError, match=message):
        ExecutorOptions(**options)


def test_without_clutter_the_log_ends_with_the_targets_alone(set_table, idle):
    assert [each.kind for each in idle.final_objects] == [each.kind for each in set_table[5].objects[:2]]


def test_skills_without_an_actor_are_refused():
    with pytest.raises(PerdureError, match="pick"):
        Executor({"pick": get_skill("pick")}, {}, None)


def test_a_skill_that_only_the_closed_loop_may_need_is_missed_before_anything_runs():
    skills = {name: get_skill(name) for name in needed_skills(get_task("prepare_groceries"), "open")}
    executor = Executor(skills, {name: Scripted() for name in skills}, ExecutorOptions(planner="closed"))
    with pytest.raises(PerdureError, match=r"^the plan needs open_fridge, but only navigate, "):
        list(executor.run(load_episodes("prepare_groceries", "val").episodes[:1]))


def test_skills_of_the_oracle_count_as_scripted(solved, idle):
    assert all(each.scripted == (each.skill != "reset_arm") for each in solved.runs)
    assert not any(each.scripted for each in idle.runs)


def planning(monkeypatch, *steps):
    """Lets the plan be these steps (None: a settling time); returns a list that grows whenever it is asked."""
    asked = []
    usual = OpenLoop.next

    def begin(self, episode, fallback):
        Planner.__init__(self, episode, fallback)
        self._steps = iter(steps)

    def ask(self, facts, succeeded=True):
        asked.append(succeeded)
        return usual(self, facts, succeeded)

    monkeypatch.setattr(OpenLoop, "__init__", begin)
    monkeypatch.setattr(OpenLoop, "next", ask)
    return asked


def test_a_planner_is_asked_again_after_the_settling_time(set_table, monkeypatch):
    """One that has another skill only then, as when an object rolled away after the plan."""
    planning(monkeypatch, SkillStep("reset_arm", 0), None, SkillStep("reset_arm", 0), None)
    log = run(Idle(), [set_table[0]], lanes=1, settle_steps=7)[0]
    first, second = log.runs
    assert (first.begin, second.begin - first.end) == (0, 7)
    assert (log.steps, log.length) == (second.end, second.end + 7)
    shorten(monkeypatch, LIMIT, first.end + 7)
    assert len(run(Idle(), [set_table[0]], lanes=1, settle_steps=7)[0].runs) == 1, "the task's limit is over"


@pytest.mark.parametrize("diverges", [False, True])
def test_a_planner_is_not_asked_about_a_world_that_diverged(set_table, monkeypatch, diverges):
    """In the last step of its settling time. The control is asked once more, and so is the next episode in the lane."""
    asked, counts = planning(monkeypatch, SkillStep("reset_arm", 0), None), {}

    def observe(world, running):
        each = running[0]
        if diverges and (each.episode.index, each.settling) == (0, 6):
            world.simulator(0).qvel[:] = np.nan
        counts[each.episode.index] = len(asked)

    agents = {name: Scripted() for name in SKILLS}
    executor = Executor({name: get_skill(name) for name in SKILLS}, agents, ExecutorOptions(lanes=1, settle_steps=7))
    first, second = executor.run(set_table.episodes[:2], observe)
    assert (first.diverged, second.diverged) == (diverges, False)
    assert bool(first.final_objects) != diverges, "the divergence has put them back to their start"
    assert (counts[0], counts[1] - counts[0]) == (2 if diverges else 3, 3)
    assert first.length == second.length - diverges, "what follows a divergence is not recorded"


@pytest.mark.parametrize("diverges", [False, True])
def test_a_skill_does_not_succeed_in_a_world_that_diverged(set_table, monkeypatch, diverges):
    """The world goes back to its start, where the arm rests as reset_arm wants it."""
    planning(monkeypatch, SkillStep("pick", 0), SkillStep("reset_arm", 0), None)
    shorten(monkeypatch, LIMIT, MOST)

    def observe(world, running):
        each = running[0]
        if diverges and each.current is not None and each.current.skill == "reset_arm" and each.step == each.began:
            world.simulator(0).qvel[:] = np.nan

    skills = {name: get_skill(name) for name in SKILLS}
    agents = {name: Scripted() if name == "reset_arm" else Oracle() for name in SKILLS}
    executor = Executor(skills, agents, ExecutorOptions(lanes=1, settle_steps=7))
    (log,) = executor.run(set_table.episodes[:1], observe)
    assert (log.diverged, log.runs[1].skill, log.runs[1].success) == (diverges, "reset_arm", not diverges)


class Forward(Idle):
    """Drives straight on."""

    def act(self, world, lanes, skill, state, progress):
        actions = super().act(world, lanes, skill, state, progress)
        actions[:, ROBOT.action.forward] = 0.3
        return actions


def test_where_failed_attempts_stood_is_kept_for_the_next_one(set_table, monkeypatch):
    """A pick after a failed navigation: where that ended and the pick began, and where the pick timed out."""
    shorten(monkeypatch, 10, 1000)
    planning(monkeypatch, SkillStep("navigate", 1, "pick"), SkillStep("pick", 1), SkillStep("reset_arm", 1), None)
    skills, places, kept = {name: get_skill(name) for name in SKILLS}, [], {}

    def observe(world, running):
        places.append(world.simulator(0).robot[:2].copy())
        kept.update(running[0].stood)

    agents = {name: Scripted() if name == "reset_arm" else Forward() for name in SKILLS}
    (log,) = Executor(skills, agents, ExecutorOptions(lanes=1, settle_steps=1)).run([set_table[0]], observe)
    runs = [(each.skill, each.success) for each in log.runs]
    assert runs == [("navigate", False), ("pick", False), ("reset_arm", True)]
    drove, picked, _ = (places[each.end - 1] for each in log.runs)
    assert np.linalg.norm(picked - drove) > 0.05, "the control: they are two places"
    assert set(kept) == {("pick", 1), ("reset_arm", 1)}
    np.testing.assert_allclose(kept["pick", 1], [drove, drove, picked], atol=1e-9)
    np.testing.assert_allclose(kept["reset_arm", 1], [picked], atol=1e-9)  # it did not fail


class Holding(Idle):
    """Keeps the hand closed for ever; `patient` asks for more time, as the release strategies do."""

    def __init__(self, patient):
        self.patient = patient

    def act(self, world, lanes, skill, state, progress):
        actions = super().act(world, lanes, skill, state, progress)
        actions[:, ROBOT.action.grip] = 1.0
        return actions

    def overtime(self, lane):
        return self.patient


def until_placed(episode, monkeypatch):
    """The episode, whose plan ends when the first object is placed."""
    plan = make_plan(episode.home_task)
    first = next(k for k, step in enumerate(plan) if step.skill == "place")
    monkeypatch.setitem(TASKS, "half", replace(episode.home_task, name="half", sequence=plan[: first + 1]))
    return replace(episode, task="half")


@pytest.mark.parametrize(("patient", "extra"), [(False, 0), (True, OVERTIME)])
def test_a_hand_that_never_opens_is_opened_by_force_at_the_time_limit_or_after_the_overtime(
    set_table, patient, extra, monkeypatch
):
    skills = {name: get_skill(name) for name in SKILLS}
    agents = {name: Scripted() if name == "reset_arm" else Oracle() for name in SKILLS} | {"place": Holding(patient)}
    (log,) = Executor(skills, agents, ExecutorOptions(lanes=1)).run([until_placed(set_table[0], monkeypatch)])
    run = next(each for each in log.runs if each.skill == "place")
    held = np.asarray(log.history.facts.held)
    assert held[run.begin] == run.target, "the control: the object is in the hand"
    assert (run.ending, run.forced_release, run.end - run.begin) == ("timed out", True, skills["place"].limit + extra)
    assert held[run.end - 1] == run.target
    assert held[run.end + 1] != run.target
    (release,) = (each for each in log.releases if each.target == run.target)
    assert release.step == run.end - 1


class EnoughError(Exception):
    """The pick has been seen."""


def test_without_fallback_the_policy_tries_on_and_the_target_is_given_up():
    skills, oracle = {name: get_skill(name) for name in SKILLS}, Oracle()
    agents = {name: Scripted() if name == "reset_arm" else oracle for name in SKILLS} | {"pick": Idle()}
    options = ExecutorOptions(lanes=1, threads=1, planner="closed", fallback="none")
    picks = []

    def observe(world, running):
        step = running[0].current
        if step is not None and step.skill == "pick" and (step.target, step.attempt) not in picks:
            picks.append((step.target, step.attempt))
            assert not step.scripted
            if step.target != picks[0][0]:
                raise EnoughError

    executor = Executor(skills, agents, options)
    with pytest.raises(EnoughError):
        list(executor.run([load_episodes("tidy_house", "val")[0]], observe))
    first = picks[0][0]
    assert picks[:-1] == [(first, attempt) for attempt in range(1, 6)]


def test_a_retry_begins_elsewhere_and_the_last_resort_is_scripted():
    """A pick that never grasps is tried three times, from different places, and then by the oracle, which succeeds."""
    skills, oracle = {name: get_skill(name) for name in SKILLS}, Oracle()
    agents = {name: Scripted() if name == "reset_arm" else oracle for name in SKILLS} | {"pick": Idle()}
    picks, stood = [], []

    def observe(world, running):
        step = running[0].current
        if step.skill == "pick" and (not picks or picks[-1][0] != step.attempt):
            picks.append((step.attempt, step.scripted))
            stood.append(world.sense().base[0, :2].copy())
        if step.skill == "place":
            raise EnoughError

    executor = Executor(skills, agents, ExecutorOptions(lanes=1, threads=1, planner="closed"))
    with pytest.raises(EnoughError):
        list(executor.run([load_episodes("tidy_house", "val")[0]], observe))
    assert picks == [(1, False), (2, False), (3, False), (4, True)]
    stood = np.array(stood[:-1])  # the oracle chooses its own place
    apart = np.linalg.norm(stood[:, None] - stood, axis=2)[np.triu_indices(len(stood), 1)]
    assert apart.min() > 0.2  # the cells are 0.3 m apart; the robot stops within 0.1 m of one


class Keeps(Idle):
    """Does nothing, with this object or handle in its hand from the first step on."""

    def __init__(self, hold):
        self.hold = hold

    def act(self, world, lanes, skill, state, progress):
        if progress.elapsed[0] == 0:
            cos, sin = np.cos(state.base[0, 2]), np.sin(state.base[0, 2])
            axes = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ state.gripper_rotation[0]
            self.hold(world.simulator(int(lanes[0])), state.gripper[0], axes)
        return super().act(world, lanes, skill, state, progress)


def hold_object(lane, gripper, axes):
    lane.hand.hold_from_start(0, placed=False)


def hold_handle(lane, gripper, axes):
    lane.hand.hold_link(0, axes.T @ (lane.handles[0] - gripper), lane.handles[0])


@pytest.mark.parametrize(
    ("step", "hold", "forced", "held"),
    [
        (SkillStep("navigate", 0, "place"), hold_object, False, 0),
        (SkillStep("open_drawer", 0), hold_handle, True, SOMETHING_ELSE),
    ],
)
def test_a_hand_is_opened_by_force_after_skills_that_end_with_an_empty_one(
    set_table, monkeypatch, step, hold, forced, held
):
    shorten(monkeypatch, 5, 1000)
    planning(monkeypatch, step, None)
    log = run(Keeps(hold), [set_table[0]], lanes=1, settle_steps=3)[0]
    (only,) = log.runs
    assert (only.ending, only.forced_release) == ("timed out", forced)
    assert [log.history.facts.held[k] for k in (only.end - 1, only.end)] == [held, NOTHING if forced else held]


def test_tilt_and_speed_of_objects_are_mujocos(set_table, monkeypatch):
    shorten(monkeypatch, 20, 1000)
    planning(monkeypatch, SkillStep("pick", 0), None)
    seen = []

    def observe(world, running):
        lane = world.simulator(0)
        if not seen:  # thrown up, spinning
            lane.object(0)[0][:3] = [*lane.robot[:2], 2.5]
            lane.qvel[lane.scene.object_qvel[0] + np.arange(6)] = (0.3, 0.4, 0.0, 2.0, 1.0, 0.5)
        seen.append((lane.data.body("object_0").xmat[8], np.linalg.norm(lane.object(0)[1])))

    agents = {name: Idle() for name in SKILLS}
    options = ExecutorOptions(lanes=1, settle_steps=3)
    (log,) = Executor({name: get_skill(name) for name in SKILLS}, agents, options).run([set_table[0]], observe)
    up, speed = np.array(seen).T
    assert np.ptp(up) > 0.02
    assert speed.max() > 0.2
    np.testing.assert_allclose(log.history.up[1:, 0], up[1:], atol=1e-3)
    np.testing.assert_allclose(log.history.speed[1:, 0], speed[1:], atol=1e-6)


def test_the_oracle_counts_as_scripted_inside_a_release_strategy_too(set_table, monkeypatch):
    shorten(monkeypatch, 2, 6)
    planning(monkeypatch, SkillStep("place", 0), None)
    log = run(HandOver(Oracle(), Stop()), [set_table[0]], lanes=1, settle_steps=3)[0]
    assert [each.scripted for each in log.runs] == [True]
