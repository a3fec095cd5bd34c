"""Conditions of an evaluation: which there are, what they apply, and several of them in one table."""

from functools import partial

import gymnasium
import numpy as np
import polars as pl
import pytest
from probes import Dial, Falling

import perdure
from perdure.disturbances import STANDARDS, parse_disturbances
from perdure.envs import make_world, task_spec
from perdure.envs.disturbances import disturbed_task
from perdure.errors import PerdureError, PerdureWarning
from perdure.evaluate import Execution, Extrapolation, evaluate_files, extrapolate
from perdure.evaluate.reference import measure_idle
from perdure.report import read_table
from perdure.report.groups import make_groups
from perdure.runs import Store

HOPPER = "Hopper-v3"
PPO = ("Hopper-v3/ppo",)


def conditions(task=HOPPER, **options):
    spec = task_spec(task)
    found = Extrapolation(PPO, **options).conditions(spec, lambda each: make_world(disturbed_task(task, each), [0]))
    return [(each.label, each.steps, each.eval_seeds) for each in found]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, [("none", 100_000, 3), ("standard-1", 10_000, 36)]),
        ({"steps": 500, "eval_seeds": 2}, [("none", 500, 2), ("standard-1", 10_000, 36)]),
        ({"hours": 1}, [("none", 450_000, 3), ("standard-1", 10_000, 36)]),  # 0.008 s a step
        ({"disturb": ("none",)}, [("none", 100_000, 3)]),
        ({"disturb": ("none",), "steps": 50}, [("none", 50, 3)]),
        ({"disturb": ("standard-1",), "eval_seeds": 7}, [("standard-1", 10_000, 7)]),
        ({"disturb": ("push:0.5", "mass:1.2"), "steps": 9}, [("mass:1.2 push:0.5", 9, 36)]),
        ({"disturb": ("push:0.1,0.2", "mass:2")}, [(f"mass:2 push:{v}", 10_000, 36) for v in (0.1, 0.2)]),
    ],
)
def test_steps_and_start_states_are_those_of_the_part_that_is_named(options, expected):
    assert conditions(**options) == expected


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"disturb": ()}, "disturb must name something"),
        ({"disturb": ("none", "push:1")}, "none cannot be combined with disturbances: none push:1"),
        ({"disturb": ("push:1", "push:2")}, "named twice"),
        ({"disturb": ("standard-2",)}, "standard-1"),
        ({"disturb": "push:1"}, "disturb must be a tuple"),
        ({"hours": 1, "steps": 5}, "steps or hours, not both"),
        ({"hours": 0}, "hours must be a number above 0"),
        ({"hours": "1"}, "hours must be a number above 0"),
    ],
)
def test_what_makes_no_sense_is_refused_at_the_door(options, words):
    with pytest.raises(PerdureError, match=words):
        Extrapolation(PPO, **options)


def test_hours_need_an_environment_that_tells_its_control_rate():
    with pytest.raises(PerdureError, match=r"its attribute dt\): give steps, not hours"):
        extrapolate(np.zeros_like, Falling, hours=1)


def test_a_named_disturbance_that_the_world_cannot_do_is_refused_and_one_of_the_standard_left_out():
    asked, calls = {"steps": 20, "eval_seeds": 1, "training_horizon": 10}, []
    with pytest.raises(PerdureError, match="MuJoCo"):
        extrapolate(calls.append, Falling, **asked, disturb="push:1")
    assert calls == []
    found = extrapolate(lambda seen: np.zeros((len(seen), 1)), Falling, **asked, disturb="standard-1").final
    assert found["not_applied"].to_list() == ["friction, mass, push, strength"]
    assert found["disturbance"].to_list() == ["standard-1"]


def test_every_kind_of_the_standard_is_applied_where_it_can_be():
    spec = task_spec(HOPPER)
    _, found = Extrapolation(PPO).conditions(spec, lambda each: make_world(disturbed_task(HOPPER, each), [0]))
    assert found.disturbances == parse_disturbances(STANDARDS["standard-1"])
    assert found.not_applied == ""


class Reach(Falling):
    observation_space = gymnasium.spaces.Dict(
        {"observation": Falling.observation_space, "desired_goal": gymnasium.spaces.Box(-1.0, 1.0, (1,))}
    )

    def reset(self, **options):
        seen, info = super().reset(**options)
        return {"observation": seen, "desired_goal": np.zeros(1, np.float32)}, info

    def step(self, action):
        seen, *rest = super().step(action)
        return {"observation": seen, "desired_goal": np.zeros(1, np.float32)}, *rest


@pytest.mark.parametrize(
    ("env", "act", "why"),
    [
        (Dial, lambda seen: seen["pointer"], "discrete actions"),
        (Reach, lambda seen: np.zeros((len(seen["observation"]), 1)), "a goal"),
    ],
)
def test_a_task_with_discrete_actions_or_a_goal_is_calm_and_says_so(env, act, why, monkeypatch):
    monkeypatch.setattr("perdure.evaluate.reference.measure_idle", partial(measure_idle, steps=20))
    with pytest.warns(PerdureWarning, match=f"standard-1, because .* has {why}"):
        found = extrapolate(act, env, steps=20, eval_seeds=2, training_horizon=10).final
    assert found["disturbance"].to_list() == ["none"] * 2
    assert why in found["not_applied"][0]


def test_conditions_stand_in_one_table_and_later_ones_run_alone(tmp_path):
    """One level first; then the same with another one, which must not run the first again."""
    few = {"steps": 120, "eval_seeds": 2, "on": "here"}
    calm = extrapolate(PPO, disturb="none", **few)
    extrapolate(PPO, disturb="action_noise:0", out=tmp_path, **few)
    before = set(Store(tmp_path).keys("groups"))
    started = []
    noisy = extrapolate(
        PPO, disturb="action_noise:0,0.3", out=tmp_path, **few, observe=lambda each: started.append(set(each))
    )
    assert not before & started[-1]
    frame = noisy.frame
    assert frame["disturbance"].unique(maintain_order=True).to_list() == ["action_noise:0", "action_noise:0.3"]
    quiet = frame.filter(disturbance="action_noise:0")
    assert quiet["return"].equals(calm.frame["return"]), "no noise at all is calm"
    assert frame["step_seconds"].unique().to_list() == [0.008]
    assert noisy.summary["disturbance"].to_list() == ["action_noise:0", "action_noise:0.3"]
    both = pl.concat([calm.frame, frame])
    lines = [group.line for group in make_groups(both)]
    assert lines == ["ppo", "ppo under action_noise:0", "ppo under action_noise:0.3"]


def test_calm_and_disturbed_episodes_of_other_lengths_share_a_table_a_report_and_a_process(monkeypatch, tmp_path):
    """The default, with short parts; in workers and in this process alike."""
    monkeypatch.setattr("perdure.evaluate.options.DISTURBED_STEPS", 90)
    monkeypatch.setattr("perdure.evaluate.options.DISTURBED_SEEDS", 3)
    asked = Extrapolation(PPO, 150, eval_seeds=2)
    by_file = evaluate_files(asked, Execution(tmp_path / "file", on="here"))
    shape = by_file.final.select("disturbance", "eval_seed", "test_horizon").rows()
    assert shape == [("none", 0, 150), ("none", 1, 150), *(("standard-1", seed, 90) for seed in range(3))]
    assert by_file.final["not_applied"].to_list() == [""] * 5
    assert read_table(by_file.path)[0].equals(by_file.frame.select(read_table(by_file.path)[0].columns))
    here = extrapolate(perdure.load_policy(PPO[0]), steps=150, eval_seeds=2)
    assert here.frame.drop("policy").equals(by_file.frame.drop("policy"))
    assert "ppo under standard-1" in here.write(tmp_path / "here").read_text()


@pytest.mark.parametrize(
    "robot", ["Ant", "HalfCheetah", "Hopper", "Humanoid", "HumanoidStandup", "InvertedDoublePendulum",
              "InvertedPendulum", "Pusher", "Reacher", "Swimmer", "Walker2d"],
)  # fmt: skip
def test_envpool_robots_step_as_long_as_gymnasiums(robot):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)  # about outdated versions
        env = gymnasium.make(f"{robot}-v5")
    ours = task_spec(f"{robot}-v4").step_seconds
    assert ours == pytest.approx(env.unwrapped.dt)
    assert task_spec(f"gymnasium:{robot}-v5").step_seconds == ours


@pytest.mark.parametrize(("dt", "expected"), [(0.05, 0.05), (None, np.nan), (0.0, np.nan), ("fast", np.nan)])
def test_an_environment_of_ones_own_says_how_long_a_step_is(dt, expected):
    class Timed(Dial):
        pass

    Timed.dt = dt
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(gymnasium.registry, "Timed-v0", gymnasium.envs.registration.EnvSpec("Timed-v0", Timed))
        assert task_spec("gymnasium:Timed-v0").step_seconds == pytest.approx(expected, nan_ok=True)
