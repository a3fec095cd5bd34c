"""Tasks with a goal: what is recorded of successes, and the verdict where a reached goal ends the episode."""

import math
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import polars as pl
import pytest
from probes import Falling, Reach
from scripted import policy_for

import perdure
from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.episodes import FIRST_EVAL_SEED, GoalRecorder
from perdure.evaluate.table import TABLE_FILE
from perdure.policy import TaskInfo, measure_reference, save_policy
from perdure.report import estimate_table, read_table, write_report
from perdure.report.estimates import advice, headline
from perdure.report.schema import GOALS
from perdure.runs import Store
from perdure.wrappers import StayAtGoal

pytestmark = pytest.mark.usefixtures("short_idle")
EPISODES = 20


def steps_to_goal(count=EPISODES):
    """Steps that the goal of each start state is away, read from the environment itself."""
    env, found = Reach(), []
    for seed in range(count):
        env.reset(seed=FIRST_EVAL_SEED + seed)
        found.append(round(10 * float(env.goal[0])))
    return np.array(found)


def approach(observations, farthest=math.inf):
    """Move to the goal, unless it is more steps away than `farthest`."""
    away = observations["desired_goal"] - observations["achieved_goal"]
    return np.where(observations["desired_goal"] < 0.1 * farthest + 0.05, 10.0 * away, 0.0)


def evaluated(function, episodes=EPISODES, **options):
    env = partial(Reach, **options)
    return perdure.extrapolate(function, env, steps=60, eval_seeds=episodes, training_horizon=20, name="reach")


def verdict_of(result):
    ((estimate,),) = estimate_table(result.frame).values()
    return estimate.verdict


class TestRecorder:
    @pytest.mark.parametrize("silent", [False, True])
    def test_agrees_with_counting_by_hand(self, silent):
        """Random reports of true, false and nothing; in some episodes the environment never says anything."""
        rng = np.random.default_rng(0)
        said = rng.choice([0.0, 1.0, np.nan], size=(200, 12), p=[0.4, 0.5, 0.1])
        said[:20] = np.nan
        lasts = rng.integers(1, 13, 200)
        recorder = GoalRecorder(200)
        for step in range(1, 13):
            running = np.flatnonzero(lasts >= step)
            values = said[running, step - 1]
            recorder.take(running, None if silent and np.isnan(values).all() else values, step)
        for row, last, found in zip(said, lasts, recorder.found.T, strict=True):
            text = "".join("x" if value == 1.0 else "." for value in row[:last])
            known = not np.isnan(row[:last]).all()
            first = text.index("x") + 1 if "x" in text else math.inf
            expected = (first, max(map(len, text.split("."))), float(text[-1] == "x")) if known else (math.nan,) * 3
            np.testing.assert_array_equal(found, expected)

    def test_a_step_of_which_nothing_is_said_ends_a_stay(self):
        recorder = GoalRecorder(1)
        for step, said in enumerate([np.ones(1), None, np.ones(1), None], start=1):
            recorder.take(np.zeros(1, np.int64), said, step)
        assert recorder.found[:, 0].tolist() == [1.0, 1.0, 0.0]


class TestAnEpisodeThatEndsAtItsGoal:
    def test_is_a_success_with_its_time_and_no_fall(self):
        result, away = evaluated(approach), steps_to_goal()
        episodes = result.final
        assert set(episodes["outcome"]) == {"reaches its goal"}
        assert episodes["goal_first_step"].to_list() == episodes["end_step"].to_list() == away.tolist()
        assert set(episodes["goal_at_end"]) == {1.0}
        assert set(episodes["goal_longest_stay"]) == {1.0}
        verdict = verdict_of(result)
        said = f"reaches its goal in 20 of 20 episodes, after {np.median(away):.0f} steps (median)"
        assert (verdict.label, verdict.short) == ("reaches its goal", f"reach: {said}")
        assert verdict.sentence.startswith(f"reach: {said}.")
        assert list(verdict.caveats) == ["met few disturbances"]
        assert result.summary["reaches_its_goal"].to_list() == [1.0]

    @pytest.mark.parametrize("count", [18, 17])
    def test_nine_in_ten_are_enough(self, count):
        """Of a table in which all of 20 episodes reach their goal, all but `count` are made to end without it."""
        frame = evaluated(approach).frame
        missed = pl.col("eval_seed") >= count
        frame = frame.with_columns(
            outcome=pl.when(missed).then(pl.lit("unknown")).otherwise("outcome"),
            goal_first_step=pl.when(missed).then(math.inf).otherwise("goal_first_step"),
        )
        ((estimate,),) = estimate_table(frame).values()
        middle = np.median(steps_to_goal(count))
        said = f"reaches its goal in {count} of 20 episodes, after {middle:.0f} steps (median)"
        timed = estimate_table(frame.with_columns(step_seconds=0.04))["Reach"][0].verdict.sentence
        assert f" steps (median, {0.04 * middle:.3g} s)" in timed
        assert estimate.verdict.label == ("reaches its goal" if count == 18 else "misses its goal")
        assert said in estimate.verdict.sentence
        assert float(estimate.working.estimate[-1]) == 1.0, "neither has failed"

    def test_what_does_not_get_there_misses_it_and_rewards_do_not_judge(self):
        away = steps_to_goal()
        result = evaluated(partial(approach, farthest=6))
        reached = int((away <= 6).sum())
        assert 0 < reached < 18
        verdict = verdict_of(result)
        assert verdict.label == "misses its goal"
        assert verdict.short == f"reach: misses its goal in {20 - reached} of 20 episodes"
        assert f"; reaches its goal in {reached} of 20 episodes, after " in verdict.sentence
        assert set(result.final.filter(pl.col("end_step") == 60)["goal_first_step"]) == {math.inf}
        ((estimate,),) = estimate_table(result.frame).values()
        assert float(estimate.working.estimate[-1]) == 1.0, "none has failed, and none was left unwatched"

    def test_a_cut_at_the_goal_counts_as_with_stable_baselines3(self):
        """Episodes of 8 steps that say at their last one whether they succeeded, and go on after the first success."""
        result = evaluated(approach, ends=False, cut_after=8)
        away = steps_to_goal()
        outcomes = np.array(result.final["outcome"])
        assert (outcomes == np.where(away <= 8, "reaches its goal", "cut")).all()
        assert set(outcomes) == {"reaches its goal", "cut"}
        assert set(estimate_table(result.frame)["Reach"][0].group.verdicts) == {"reaches its goal", "misses its goal"}

    def test_one_condition_that_reaches_it_is_enough_to_know_that_the_task_has_a_goal(self, tmp_path):
        idle = evaluated(lambda seen: np.zeros((len(seen["observation"]), 1))).frame
        table = pl.concat(
            [evaluated(approach).frame, idle.with_columns(disturbance=pl.lit("push:9"), not_applied=pl.lit(""))]
        )
        result = estimate_table(table.with_columns(step_seconds=0.04))
        calm, pushed = (each.verdict for each in result["Reach"])
        assert (calm.label, pushed.label) == ("reaches its goal", "misses its goal")
        assert headline([calm, pushed]).endswith("; under push:9 misses its goal in 20 of 20 episodes")
        assert advice([calm, pushed]) != advice([calm]), "the failing condition decides"
        page = write_report(result, tmp_path, "", ()).read_text()
        assert "reaches its goal in 20 of 20" in page
        assert "Speed while working" not in page, "reward until the goal is no speed"
        falls = pl.when(pl.col("eval_seed") < 5).then(pl.lit("falls")).otherwise("outcome")
        shaken = table.head(len(table) // 2).with_columns(
            outcome=falls, disturbance=pl.lit("push:1"), step_seconds=0.04
        )
        ((estimate,),) = estimate_table(shaken).values()
        walked = estimate.group["end_step"].sum() * 0.04 / 3600
        assert estimate.group.failure_rate.exposure_hours == pytest.approx(walked), "not beyond the goal"


class TestATaskThatGoesOn:
    def test_success_once_at_the_end_and_its_longest_stay_are_said(self):
        result, away = evaluated(approach, ends=False, sparse=False), steps_to_goal()
        episodes = result.final
        assert "reaches its goal" not in set(episodes["outcome"])
        assert episodes["goal_longest_stay"].to_list() == (61 - away).tolist()
        stays = np.sort(61 - away)
        said = (
            f"success once in 20 of 20 episodes, after {np.median(away):.0f} steps (median), at the end in 20; "
            f"longest stay {np.median(stays):.0f} steps (median), {stays[1]} or more in nine of ten"
        )
        assert said in verdict_of(result).sentence
        table = str(result).splitlines()
        assert table[-2].endswith("success once  success at end  longest stay")
        assert table[-1].split()[-5:] == ["100", "%", "100", "%", f"{np.median(stays):.0f}"]

    def test_one_that_never_succeeds_says_so(self):
        result = evaluated(lambda seen: np.zeros((len(seen["observation"]), 1)), ends=False, sparse=False)
        assert "success once in 0 of 20 episodes." in verdict_of(result).sentence

    def test_staying_is_counted_by_the_wrapper_too(self):
        env = lambda: StayAtGoal(Reach(ends=False), steps=5)  # noqa: E731
        found = perdure.extrapolate(approach, env, steps=60, eval_seeds=EPISODES, training_horizon=20).final
        assert found["goal_first_step"].to_list() == (steps_to_goal() + 4).tolist()


def test_without_reports_nothing_is_known_or_shown():
    result = perdure.extrapolate(lambda seen: np.zeros((len(seen), 1)), Falling, steps=70, eval_seeds=3, disturb="none")
    assert result.frame.select(pl.col(*GOALS).is_nan().all()).row(0) == (True, True, True)
    assert "success" not in str(result)


def test_a_time_limit_that_is_reported_as_a_termination_is_suspected():
    hint = "every episode ends at step 30: the environment may report its time limit as a termination"
    limited = evaluated(partial(approach, farthest=0), ends=False, falls_after=30)
    assert hint in verdict_of(limited).sentence
    assert set(limited.final["outcome"]) == {"falls"}
    few = evaluated(partial(approach, farthest=0), ends=False, falls_after=30, episodes=7)
    assert "time limit" not in str(few), "seven may fall at one step by chance"
    falling = perdure.extrapolate(
        lambda seen: np.zeros((len(seen), 1)), Falling, steps=70, eval_seeds=8, disturb="none"
    )
    assert "time limit" not in str(falling), "these end at different steps"
    assert "time limit" not in str(evaluated(approach, ends=False, falls_after=30)), "these end at their goal"


class TestANamedInfo:
    def test_is_read_instead(self):
        env = partial(Reach, key="there")
        options = {"steps": 20, "eval_seeds": 3, "training_horizon": 20}
        assert set(perdure.extrapolate(approach, env, **options).final["outcome"]) == {"falls"}
        found = perdure.extrapolate(approach, env, success="there", **options).final
        assert set(found["outcome"]) == {"reaches its goal"}

    def test_is_noted_in_the_table_whoever_writes_it(self, tmp_path):
        options = {"steps": 20, "eval_seeds": 2, "training_horizon": 20, "success": "there"}
        result = perdure.extrapolate(approach, partial(Reach, key="there"), out=tmp_path / "out", **options)
        result.write(tmp_path / "again")
        notes = [read_table(tmp_path / folder / TABLE_FILE)[1] for folder in ("out", "again")]
        assert notes[0]["success"] == "there"
        assert notes[1] == notes[0]

    @pytest.mark.parametrize(
        ("success", "message"),
        [("nowhere", r"info\['nowhere'\].*is missing; there are is_success"), ("", "must be the name of an info")],
    )
    def test_that_is_not_there_is_refused(self, success, message):
        with pytest.raises(PerdureError, match=message):
            perdure.extrapolate(approach, Reach, steps=20, success=success)

    def test_belongs_to_what_finished_episodes_depend_on(self, tmp_path):
        gymnasium.register("test/Scored-v0", Scored, max_episode_steps=10)
        task = TaskInfo("gymnasium:test/Scored-v0", 1, (-1.0,), (1.0,))
        path = save_policy(policy_for(task), tmp_path / "p.safetensors")

        def first(success):
            asked = Extrapolation((path,), 20, eval_seeds=2, disturb=("none",), success=success)
            return (
                evaluate_files(asked, Execution(tmp_path / "out", on="here", cores=1))
                .final["goal_first_step"]
                .to_list()
            )

        assert first(None) == [2.0, 2.0]
        with pytest.raises(PerdureError, match="another folder"):
            first("late")
        (tmp_path / "out" / TABLE_FILE).unlink()
        assert [first("late"), first("late")] == [[5.0, 5.0], [5.0, 5.0]]
        assert len(Store(tmp_path / "out").keys("groups")) == 2

    @pytest.mark.parametrize("stored", [False, True])
    @pytest.mark.parametrize("in_process", [False, True])
    def test_tells_falls_from_successes_within_the_training_horizon_too(self, tmp_path, stored, in_process):
        """All reference episodes end at step 5 of 10, with "late" true and "success" false."""
        if "test/Ending-v0" not in gymnasium.registry:
            gymnasium.register("test/Ending-v0", Ending, max_episode_steps=10)
        policy = policy_for(TaskInfo("gymnasium:test/Ending-v0", 1, (-1.0,), (1.0,)))
        policy = replace(policy, reference=measure_reference(policy)) if stored else policy
        assert not stored or policy.reference.terminated.all()
        path = save_policy(policy, tmp_path / "p.safetensors")

        def falls(success):
            asked = {"steps": 20, "eval_seeds": 2, "disturb": ("none",), "success": success}
            if in_process:
                return perdure.extrapolate(policy, **asked).final["training_falls"].to_list()
            return (
                evaluate_files(Extrapolation((path,), **asked), Execution(on="here", cores=1))
                .final["training_falls"]
                .to_list()
            )

        assert (falls(None), falls("late")) == ([1.0, 1.0], [0.0, 0.0])

    def test_is_refused_where_an_engine_has_no_infos(self):
        with pytest.raises(PerdureError, match="EnvPool's tasks have none"):
            perdure.extrapolate("Hopper-v3/geometric", steps=5, success="is_success", on="here", disturb="none")


class Scored(gymnasium.Env):
    """Is successful from step 2 on, by another entry of the info from step 5 on."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1), {}

    def step(self, action):
        self.steps += 1
        return np.zeros(1), 0.0, False, False, {"success": self.steps >= 2, "late": self.steps >= 5}


class Ending(Scored):
    """Ends at step 5 and says so under another name."""

    def step(self, action):
        observation, reward, *_ = super().step(action)
        return observation, reward, self.steps >= 5, False, {"success": False, "late": self.steps >= 5}
