"""Functions of any origin through the door: the same table as policy files, on worlds whose returns are known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import polars as pl
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from gymnasium.wrappers import NormalizeObservation, NormalizeReward, TimeLimit
from probes import Cue, Dial, Falling
from scripted import policy_for

import perdure
from perdure.envs import GymnasiumWorld, make_world
from perdure.errors import PerdureError, PerdureWarning
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.judge import BASELINES, read_baselines, read_judged
from perdure.evaluate.reference import constant_actions, measure_idle
from perdure.horizon import Fixed
from perdure.policy import Normalizer, TaskInfo, save_policy
from perdure.report import read_episodes, read_table
from perdure.report.estimates import _condition, estimate_table
from perdure.runs import Store
from perdure.wrappers import HorizonLimit

extrapolate = partial(perdure.extrapolate, disturb="none")
pytestmark = pytest.mark.usefixtures("short_idle")
HOPPER = TaskInfo("Hopper-v3", 11, (-1.0,) * 3, (1.0,) * 3)
LARGEST = np.finfo(np.float64).max
LIMITED = "test/Falling-v0"
gymnasium.register(LIMITED, Falling, max_episode_steps=10)
FACTS = ["clock", "eval_seed", "step", "return", "end_step", "end_reason"]


def still(observations):
    return np.zeros((len(observations), 1))


def ends(result):
    """Return of each episode at its end, in the order of start states."""
    return result.final["return"].to_list()


@pytest.fixture(scope="module")
def timed():
    return policy_for(HOPPER, seed=2, phi=True, method="linear")


@pytest.fixture(scope="module")
def by_file(timed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("file")
    path = save_policy(timed, folder / "timed.safetensors")
    asked = Extrapolation((path,), 60, ("constant:500", "countdown"), eval_seeds=3, disturb=("none",))
    return evaluate_files(asked, Execution(folder / "out", on="here"))


class TestAFunctionIsJudgedLikeAPolicyFile:
    def test_its_table_is_that_of_the_file(self, timed, by_file):
        def function(observations, *, elapsed, horizon):
            return timed.act_at(observations, elapsed, horizon)

        found = extrapolate(function, env="Hopper-v3", steps=60, clocks=("constant:500", "countdown"), eval_seeds=3)
        assert found.frame.select(FACTS).equals(by_file.frame.select(FACTS))
        same = ["idle_rate", "training_rate", "window", "policy_state", "policy_note", "outcome", "failed_step"]
        assert found.frame.select(same).equals(by_file.frame.select(same))
        assert found.frame["policy"].unique().to_list() == ["function"]

    def test_a_table_names_the_environment_that_was_run(self, timed):
        found = extrapolate(timed, "Hopper-v5", steps=20, clocks="countdown", eval_seeds=1, disturb="none")
        assert found.frame["task"].unique().to_list() == ["gymnasium:Hopper-v5"]

    def test_so_is_that_of_the_policy_itself_and_of_one_file(self, timed, by_file, tmp_path):
        options = {"steps": 60, "clocks": ["constant:500", "countdown"], "eval_seeds": 3}
        path = save_policy(timed, tmp_path / "timed.safetensors")
        for policy in (timed, path, [str(path)]):
            assert extrapolate(policy, **options, on="here").frame.equals(by_file.frame)

    def test_the_noise_of_a_file_without_reference_episodes_has_the_spread_that_they_had(self, timed, tmp_path):
        raw = replace(timed, normalizer=Normalizer.identity(timed.task.observation_size), reference=None)
        path, options = save_policy(raw, tmp_path / "raw.safetensors"), {"steps": 60, "eval_seeds": 2, "on": "here"}
        tables = [extrapolate(each, **options, disturb="observation_noise:0.5").frame for each in (raw, path)]
        assert tables[1].equals(tables[0])

    def test_another_function_has_another_table(self, by_file):
        def function(observations, *, elapsed, horizon):
            return np.zeros((len(observations), 3))

        found = extrapolate(function, env="Hopper-v3", steps=60, clocks=("constant:500", "countdown"), eval_seeds=3)
        assert not found.frame.select("return").equals(by_file.frame.select("return"))

    def test_a_clock_is_read_to_it_step_by_step(self):
        read = []

        def function(observations, *, elapsed, horizon):
            read.append((elapsed.tolist(), horizon.tolist()))
            return still(observations)

        extrapolate(function, Falling, steps=6, clocks=("constant:7", "countdown:4"), eval_seeds=1, training_horizon=3)
        assert read[0] == ([0.0] * 20, [3.0] * 20), "within the training horizon it is a countdown to its end"
        assert [row[0] for row in read[3:8]] == [[0.0, float(t)] for t in (0, 1, 2, 3, 4)]
        assert read[4][1] == [7.0, 4.0]


class TestWhatTheFunctionSees:
    def test_a_discrete_action_and_a_composed_observation_have_the_environments_form(self):
        seen = []

        def follow(observations):
            seen.append(observations)
            return observations["pointer"]

        result = extrapolate(follow, Dial, steps=40, eval_seeds=3, training_horizon=100)
        assert ends(result) == [40.0] * 3
        first = seen[-1]
        assert {name: (each.shape, each.dtype) for name, each in first.items()} == {
            "pointer": ((3,), np.int64), "grid": ((3, 2, 3), np.uint8), "pair": ((3, 2), np.int64),
        }  # fmt: skip
        assert (first["grid"][:, 0, 0] + 3 == first["pointer"]).all()
        assert (first["pair"] == np.stack([np.ones(3), first["pointer"] - 3], axis=1)).all()
        row = result.frame.row(0, named=True)
        assert row["training_rate"] == 1.0
        assert row["idle_rate"] == pytest.approx(1 / 3, abs=0.02)
        assert row["policy_state"] == "worked"

    def test_a_recurrent_policy_remembers_whatever_the_axis_of_its_episodes_and_whoever_ends(self):
        calls = []

        def remember(observations, state, episode_starts):
            calls.append((state is None, episode_starts.all(), episode_starts.any(), len(observations)))
            state = np.zeros((1, len(observations), 1)) if state is None else state
            state = np.where(episode_starts[None, :, None], observations[None], state)
            return state[0, :, 0].astype(int), state

        result = extrapolate(remember, Cue, steps=50, eval_seeds=8, training_horizon=30, recurrent=True)
        episodes = result.final
        assert set(episodes["end_step"]) == {20, 50}
        assert episodes["return"].to_list() == episodes["end_step"].to_list()
        assert calls[30] == (True, True, True, 8), "a new closed loop begins without a state"
        assert set(calls[31:]) == {(False, False, False, 8)}, "ended episodes are still there"

    def test_without_its_memory_it_earns_nothing_after_the_first_step(self):
        result = extrapolate(
            lambda seen: np.maximum(seen[:, 0], 0).astype(int), Cue, steps=50, eval_seeds=8, training_horizon=30
        )
        cue = result.final["return"].to_numpy()
        assert set(cue) <= {1.0, 20.0}
        assert (cue == 1.0).any()


class TestEnvironments:
    def test_an_id_a_factory_and_vectors_give_the_same_returns_and_limits_of_their_own_are_lifted(self):
        def limited():
            return gymnasium.make(LIMITED)

        vector = SyncVectorEnv([limited] * 3)
        wrapped = [lambda: TimeLimit(Falling(), 10)]  # it has no spec
        wrapped.append(AsyncVectorEnv(wrapped * 2))
        tables = [
            extrapolate(still, env, steps=70, eval_seeds=4)
            for env in (LIMITED, f"gymnasium:{LIMITED}", limited, vector, AsyncVectorEnv([limited] * 2), *wrapped)
        ]
        lasts = tables[0].final["end_step"].to_list()
        assert max(lasts) > 10, "beyond the limit"
        for table in tables:
            assert table.final["end_step"].to_list() == lasts
            assert ends(table) == [n * (n + 1) / 2 for n in lasts], "reward k at step k"
        assert [table.frame["task"][0] for table in tables[:3]] == [f"gymnasium:{LIMITED}"] * 2 + [LIMITED]
        assert {table.frame["train_horizon"][0] for table in tables} == {10}
        assert vector.envs[0].spec.max_episode_steps == 10
        vector.reset(seed=[1_000_000, 1_000_001, 1_000_002])
        cut = [vector.step(np.zeros((3, 1)))[3].all() for _ in range(10)]
        assert cut == [False] * 9 + [True], "the vector has its limit back"
        with pytest.raises(PerdureError, match="build it with a max_episode_steps"):
            extrapolate(still, AsyncVectorEnv([lambda: TimeLimit(limited(), 5)] * 2), steps=70, eval_seeds=4)

    def test_the_training_horizon_is_the_environments_limit_unless_it_is_given(self):
        def longest(env, **options):
            return extrapolate(still, env, steps=5, eval_seeds=1, **options).frame["train_horizon"][0]

        assert longest(LIMITED) == longest(lambda: gymnasium.make(LIMITED)) == 10
        assert longest(LIMITED, training_horizon=30) == 30
        assert longest(Falling) == 1000

    @pytest.mark.parametrize(
        ("env", "error", "message"),
        [
            ("Pendulum-v11", PerdureError, "did you mean .Pendulum-v1"),
            (gymnasium.make("Pendulum-v1"), PerdureError, "give the function that builds it"),
            (3, PerdureError, "a Gymnasium id, a task.*a factory.*not int"),
            (lambda: 3, PerdureError, "this function returned int"),
            (None, PerdureError, r"env \(--env\) is missing"),
            (gymnasium.make_vec("CartPole-v1", 2, "vector_entry_point"), PerdureError, "ends episodes after 500 steps"),
        ],
    )
    def test_what_is_none_is_refused(self, env, error, message):
        with pytest.raises(error, match=message):
            extrapolate(still, env, steps=10)

    def test_a_pool_of_envpool_is_refused_with_what_to_give(self):
        import envpool

        with pytest.raises(PerdureError, match="an EnvPool cannot be seeded again: give its task's name"):
            extrapolate(still, envpool.make_gymnasium("Hopper-v4", num_envs=1), steps=10)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda seen: np.zeros((len(seen), 2)), r"shape \(20, 1\).*\(20, 2\)"),
        (lambda seen: 0.0, r"shape \(20, 1\)"),
        (lambda seen: (still(seen), None), "returned a tuple; of Stable-Baselines3"),
        (lambda seen: np.full((len(seen), 1), np.nan), "at step 1 is not finite"),
        (lambda seen: ["left"] * len(seen), "not an array of numbers"),
    ],
)
def test_what_is_no_action_is_refused(function, message):
    with pytest.raises(PerdureError, match=message):
        extrapolate(function, Falling, steps=10)


def test_a_function_for_one_observation_is_told_that_it_gets_a_batch():
    def one(observation):
        return np.zeros((1, 2)) @ observation

    said = r"Falling, step 1: the policy raised ValueError: matmul.*gets 20 observations at once.*of shape \(20, 1\)"
    with pytest.raises(PerdureError, match=said):
        perdure.extrapolate(one, Falling, steps=10)


def test_a_discrete_action_out_of_range_is_refused():
    with pytest.raises(PerdureError, match="whole numbers from 3 to 5; lane 0 got 6"):
        extrapolate(lambda seen: np.full(len(seen["pointer"]), 6), Dial, steps=10)
    with pytest.raises(PerdureError, match=r"whole numbers from 3 to 5; lane 0 got 3\.5"):
        extrapolate(lambda seen: np.full(len(seen["pointer"]), 3.5), Dial, steps=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps must be at least 1"),
        ({"training_horizon": 0}, "training_horizon must be at least 1"),
        ({"clocks": 500}, "clocks must be a list or tuple of strings, got 500"),
        ({"steps": 10.5}, "steps must be a whole number, got 10.5"),
        ({"training_horizon": "1000"}, "training_horizon must be a whole number, got '1000'"),
        ({"name": ""}, "name must be text of 1 to 500 characters"),
        ({"name": "a\nb"}, "name must be text of 1 to 500 characters"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(options, message):
    with pytest.raises(PerdureError, match=message):
        extrapolate(lambda seen, **time: still(seen), Falling, **{"steps": 10, **options})


def test_an_unknown_option_is_refused_with_the_nearest_one():
    with pytest.raises(PerdureError, match=r"no option 'eval_seed'.*did you mean 'eval_seeds'"):
        extrapolate(still, Falling, eval_seed=1)


def test_options_may_be_one_object_and_keywords_stand_over_it():
    asked = Extrapolation(steps=20, eval_seeds=3, disturb=("none",))
    found = perdure.extrapolate(still, Falling, asked, eval_seeds=2)
    assert found.frame.equals(extrapolate(still, Falling, steps=20, eval_seeds=2).frame)
    with pytest.raises(PerdureError, match="policies as its first argument"):
        perdure.extrapolate(still, Falling, Extrapolation(("Hopper-v3/ppo",)))


def test_a_function_whose_clock_is_the_default_is_called_without_time():
    assert extrapolate(still, Falling, steps=5, eval_seeds=1, clocks="default").frame["clock"].unique().item() == "none"


def test_a_function_that_fails_ends_the_evaluation_at_once():
    """The episodes of other conditions, hours of them perhaps, are not run first."""
    calls = []

    def fails_when_deployed(seen):
        calls.append(len(seen))
        return still(seen) if len(seen) == 20 else None

    options = {"steps": 5, "training_horizon": 3, "eval_seeds": 2, "disturb": "action_noise:0,0.1"}
    with pytest.raises(PerdureError, match=r"must have shape \(2, 1\)"):
        perdure.extrapolate(fails_when_deployed, Falling, **options)
    assert [n for n in calls if n != 20] == [2]


def test_steps_may_be_a_whole_float():
    assert extrapolate(still, Falling, steps=2e1, eval_seeds=1).frame["test_horizon"][0] == 20


def test_every_environment_that_was_made_is_closed():
    counts = {"made": 0, "closed": 0}

    class Counted(Falling):
        def __init__(self):
            counts["made"] += 1

        def close(self):
            counts["closed"] += 1

    extrapolate(still, Counted, steps=10, eval_seeds=3)
    assert counts["made"] == counts["closed"] > 3


def test_a_recurrent_function_must_return_its_state():
    with pytest.raises(PerdureError, match=r"must return \(actions, state\)"):
        extrapolate(lambda seen, state, starts: still(seen), Falling, steps=10, recurrent=True)


def test_a_model_of_stable_baselines3_is_told_how_to_be_read():
    model = Path(__file__).parents[1] / "policy" / "readers" / "fixtures" / "ppo.zip"
    with pytest.raises(PerdureError, match=r"Policy\.from_sb3"):
        extrapolate(model, env="Pendulum-v1")


def test_the_folder_holds_the_table_and_the_page(tmp_path):
    result = extrapolate(still, Falling, steps=20, eval_seeds=2, out=tmp_path / "new", command="my script")
    frame, notes = read_table(result.path)
    assert frame.equals(result.frame.select(frame.columns))
    assert notes["command"] == "my script"
    assert (tmp_path / "new" / "report.html").stat().st_size > 10_000
    assert "still" in str(result)


def test_the_table_of_a_function_has_baselines_that_judge_it_again(tmp_path):
    result = extrapolate(still, Falling, steps=20, eval_seeds=2, out=tmp_path)
    assert list(read_baselines(tmp_path / BASELINES)) == [("still", 0)]
    (stored,), _ = read_episodes(result.path)
    (judged,), _ = read_judged(result.path)
    assert judged.facts.equals(stored.facts)


def test_a_table_that_nothing_could_make_again_is_not_replaced(timed, tmp_path):
    """A function has no identity: whether the table is of the same function is not known."""
    before = extrapolate(still, Falling, steps=20, eval_seeds=2, out=tmp_path).path.read_bytes()
    path = save_policy(timed, tmp_path / "timed.safetensors")
    called = []
    for again in (
        lambda: extrapolate(called.append, Falling, steps=30, out=tmp_path),
        lambda: extrapolate(path, steps=20, eval_seeds=1, on="here", out=tmp_path),
    ):
        with pytest.raises(PerdureError, match="another evaluation, which would be replaced: name another folder"):
            again()
    assert (tmp_path / "episodes.parquet").read_bytes() == before
    assert called == []


def test_an_evaluation_of_a_function_waits_for_another_into_its_folder(tmp_path):
    class OccupiedError(Exception):
        pass

    def refuse():
        raise OccupiedError

    with Store(tmp_path).exclusive("extrapolate"), pytest.raises(OccupiedError):
        extrapolate(still, Falling, steps=20, out=tmp_path, waiting=refuse)


def test_arguments_for_functions_are_refused_with_files(tmp_path):
    for options in ({"name": "mine"}, {"recurrent": True}):
        with pytest.raises(PerdureError, match="are for functions, not for files"):
            extrapolate("Hopper-v3/geometric", steps=5, **options)
    with pytest.raises(PerdureError, match="a policy file names its own"):
        extrapolate("Hopper-v3/geometric", steps=5, training_horizon=10)


class TestIdleWithDiscreteActions:
    def test_is_the_best_constant_action(self):
        world = make_world("gymnasium:CartPole-v1", range(20))
        idle = measure_idle(world, 50)
        assert (idle.zero, idle.random, idle.kind) == (1.0, 1.0, "best constant action")

    def test_every_action_of_few_is_tried_and_some_of_many(self):
        def spec(*nvec):
            class Many(Falling):
                action_space = gymnasium.spaces.MultiDiscrete(nvec, start=[1] * len(nvec))

            return GymnasiumWorld([Many], [0]).spec

        few = constant_actions(spec(2, 3))
        assert few.tolist() == [[1, 1], [1, 2], [1, 3], [2, 1], [2, 2], [2, 3]]
        many = constant_actions(spec(100, 100))
        assert len(np.unique(many, axis=0)) == 16
        assert many.min() == 1
        assert many.max() == 100
        more = constant_actions(spec(*[5] * 40))  # 5**40 actions: more than an int64 counts
        assert len(np.unique(more, axis=0)) == 16
        assert (more[0] == 1).all()
        assert (more[-1] == 5).all()


@pytest.mark.parametrize(("low", "high"), [(-LARGEST, LARGEST), (2.0, np.inf), (-np.inf, -2.0)])
def test_an_idle_robot_acts_within_any_box(low, high):
    class Boxed(Falling):
        action_space = gymnasium.spaces.Box(low, high, (1,), np.float64)

        def step(self, action):
            assert self.action_space.contains(action)
            acted.add(float(action[0]))
            return super().step(action)

    acted = set()
    assert np.isfinite(measure_idle(GymnasiumWorld([Boxed], [0])).rate)
    assert len(acted) > 3, "random actions differ"


def test_episodes_of_many_start_states_are_independent_of_their_batch():
    few = extrapolate(still, Falling, steps=70, eval_seeds=3)
    many = extrapolate(still, Falling, steps=70, eval_seeds=60)
    assert ends(few) == ends(many)[:3]
    lasts = many.final.select(pl.col("end_step"))["end_step"].to_numpy()
    assert ends(many) == [n * (n + 1) / 2 for n in lasts], "reward k at step k"


def test_a_factory_that_hands_out_one_environment_is_refused():
    one = gymnasium.make("Pendulum-v1")
    with pytest.raises(PerdureError, match="returned the same environment again"):
        extrapolate(lambda seen: np.zeros((len(seen), 1)), lambda: one, steps=5, eval_seeds=2)


def test_an_environment_with_a_training_horizon_is_refused():
    """Every episode would end at T, in a task that cannot fall."""

    def limited():
        return HorizonLimit(gymnasium.make("Pendulum-v1", max_episode_steps=-1), Fixed(50), "terminated")

    with pytest.raises(PerdureError, match="ends episodes at a training horizon"):
        extrapolate(lambda seen: np.zeros((len(seen), 1)), limited, steps=5, eval_seeds=1)
    with pytest.raises(PerdureError, match="ends episodes at a training horizon"):
        extrapolate(lambda seen: np.zeros((len(seen), 1)), SyncVectorEnv([limited] * 2), steps=5)


def normalized(wrapper, running):
    env = wrapper(gymnasium.make("Pendulum-v1"))
    env.update_running_mean = running
    return env


@pytest.mark.parametrize("wrapper", [NormalizeObservation, NormalizeReward])
@pytest.mark.parametrize("kind", [None, SyncVectorEnv, AsyncVectorEnv, "around the vector"])
def test_statistics_that_go_on_are_refused_and_those_of_training_are_not(wrapper, kind):
    """A reward that is divided by a running scale is another reward; the policy has not seen such observations."""

    def env(running):
        build = partial(normalized, wrapper, running)
        if kind != "around the vector":
            return build if kind is None else kind([build] * 2)
        vector = getattr(gymnasium.wrappers.vector, wrapper.__name__)(gymnasium.make_vec("Pendulum-v1", 2))
        vector.update_running_mean = running
        return vector

    with pytest.raises(PerdureError, match=r"running statistics \(\w+\) begin anew"):
        extrapolate(still, env(True), steps=5, eval_seeds=2)
    assert len(extrapolate(still, env(False), steps=5, eval_seeds=2).final) == 2


@pytest.mark.parametrize(("name", "value"), [("on", "lokal"), ("cores", 0)])
def test_where_files_run_is_checked_for_functions_too(name, value):
    with pytest.raises(PerdureError, match=f"{name}.*{value}"):
        extrapolate(still, Falling, steps=5, **{name: value})


def test_what_a_world_cannot_do_of_the_standard_set_is_said():
    with pytest.warns(PerdureWarning, match="standard-1 is applied without .*push.*: .*Pendulum-v1 cannot do it"):
        result = extrapolate(still, "Pendulum-v1", steps=20, eval_seeds=2, training_horizon=20, disturb="standard-1")
    (left_out,), (found,) = set(result.final["not_applied"]), estimate_table(result.frame).values()
    assert "friction, mass, push, strength" in left_out
    assert found[0].group.condition == f"standard-1 without {left_out}"
    verdicts = [replace(each.verdict, label=label) for each in found for label in ("holds", "falls")]
    assert all(f"under standard-1 without {left_out}" in _condition(each) for each in verdicts)


def test_a_folder_that_cannot_be_written_is_found_before_the_policy_is_called(tmp_path):
    (tmp_path / "blocked").write_text("")
    called = []
    with pytest.raises(NotADirectoryError):
        extrapolate(called.append, "envpool:InvertedPendulum-v4", steps=5, out=tmp_path / "blocked" / "out")
    assert called == []
