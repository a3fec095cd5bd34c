"""Parts of an evaluation, each against numbers worked out by hand: start states, idle robots, movement, references."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from probes import Dial, Falling
from scripted import SCRIPTED, evaluate, policy_for
from test_records import SCRIPTS, STEPS
from test_verdict import scale_of

import perdure
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.envs.world import MAX_SEED
from perdure.errors import PerdureError
from perdure.evaluate import EpisodeSpec, Extrapolation
from perdure.evaluate.episodes import FIRST_EVAL_SEED, MovementRecorder
from perdure.evaluate.reference import Idle, _idle_actions, _joined, _RunningStd, measure_idle
from perdure.evaluate.table import episode_table
from perdure.evaluate.verdict import make_score_scale
from perdure.policy import Reference
from perdure.report.estimates import MOTIONLESS

run = partial(perdure.extrapolate, steps=70, training_horizon=20, disturb="none")


def still(seen):
    return np.zeros((len(seen), 1))


def test_a_first_evaluation_seed_leaves_out_the_start_states_before_it():
    many, some = run(still, Falling, eval_seeds=3).final, run(still, Falling, eval_seeds=2, first_eval_seed=1).final
    assert some["eval_seed"].to_list() == [1, 2]
    assert some["end_step"].to_list() == many["end_step"].to_list()[1:]


def test_seeds_of_the_disturbed_part_are_checked_at_the_door_too():
    with pytest.raises(PerdureError, match="first_eval_seed"):
        Extrapolation(("p",), first_eval_seed=MAX_SEED - FIRST_EVAL_SEED - 1, eval_seeds=2)


def test_every_start_state_meets_its_own_disturbances():
    found = run(still, Falling, steps=4, eval_seeds=3, disturb="action_noise:0.1")
    assert len(set(found.final["return"])) == 3


def test_reference_episodes_start_from_different_states():
    seen = []
    run(lambda each: seen.append(each[:, 0].copy()) or still(each), Falling, eval_seeds=1)
    assert len(set(seen[0])) > 5


@pytest.mark.parametrize("kind", [float, np.float32, np.int64, int])
def test_measures_belong_to_their_episode_whatever_the_type_of_the_number(kind):
    class Drifting(Falling):
        def step(self, action):
            return *super().step(action)[:4], {"heading_error": kind(self.lasts)}

    found = run(still, Drifting, eval_seeds=4).final
    assert found["heading_error"].to_list() == found["end_step"].to_list()


def test_random_discrete_actions_are_all_of_them():
    spec = GymnasiumWorld([Dial], [0]).spec
    assert set(_idle_actions(spec, np.random.default_rng(0))[-1](500).ravel()) == {3.0, 4.0, 5.0}


def test_the_idle_rate_of_discrete_actions_is_that_of_the_best_one():
    class Middle(Dial):
        def step(self, action):
            return super().step(action)[0], float(action == 4), False, False, {}

    assert measure_idle(GymnasiumWorld([Middle], [0]), 20).zero == 1.0


def movement(place, std=1.0):
    """Of a robot whose first of three components is `place(step)`, in the first and the last tenth."""
    recorder = MovementRecorder([policy_for(SCRIPTED, std=std)], 1000)
    for step in range(1, 1001):
        before, after = (np.array([[place(at), 0.0, 0.0]]) for at in (step - 1, step))
        moved = SimpleNamespace(observations=after)
        recorder.take(SimpleNamespace(episodes=np.array([0]), before=before, step=moved), step)
    return recorder.movement[:, 0]


@pytest.mark.parametrize(("std", "first", "last"), [(1.0, 0.2, 0.4), (2.0, 0.1, 0.2)])
def test_movement_is_in_units_of_the_spread_and_of_the_first_and_last_tenth(std, first, last):
    alternates = movement(lambda step: (0.6 if step < 500 else 1.2) * (step % 2 == 0), std=std)
    assert alternates == pytest.approx([first, last])


@pytest.mark.parametrize("rate", [10, 100, 1000])
def test_a_robot_that_walks_moves_at_every_control_rate(rate):
    """A stride of one second in one of three components, and one that a robot only drifts by."""
    assert (movement(lambda step: 1.4 * np.sin(2 * np.pi * step / rate)) > MOTIONLESS).all()
    assert (movement(lambda step: 0.001 * step / rate) < MOTIONLESS).all()


def test_the_table_tells_movement_at_the_end_from_that_at_the_beginning():
    records = evaluate(SCRIPTS, STEPS)
    episodes = [EpisodeSpec(0, None, k, steps=STEPS) for k in range(len(SCRIPTS))]
    frame = episode_table(["p"], [policy_for(SCRIPTED)], episodes, records)
    np.testing.assert_array_equal(frame.filter(step=STEPS)["movement_last"].to_numpy(), records.movement[1])


def test_the_spread_of_observations_is_their_standard_deviation():
    rows, running = np.random.default_rng(0).normal(5.0, [1.0, 3.0], (50, 2)), _RunningStd(2)
    for part in (rows[:20], rows[20:]):
        running.update(SimpleNamespace(before=part))
    np.testing.assert_allclose(running.std, rows.std(axis=0))


def reference(low=-1.0, high=1.0, horizon=10, reward=0.0, terminated=False, episodes=1):
    rewards, ends = np.full((episodes, horizon // 10), 10.0 * reward), np.full(episodes, terminated)
    return Reference(horizon, rewards, np.full(episodes, horizon), ends, np.array([low]), np.array([high]))


def test_joined_references_have_seen_what_each_has():
    joined = _joined([reference(-2.0, 0.0), reference(-1.0, 3.0)])
    assert (joined.observation_low.tolist(), joined.observation_high.tolist()) == ([-2.0], [3.0])


def test_an_episode_that_ends_at_its_horizon_is_no_fall_in_training():
    whole = reference(horizon=100, reward=2.0, terminated=True, episodes=3)
    assert make_score_scale(whole, Idle(0.0, 0.0), math.nan).training_falls == 0.0


def test_a_policy_that_beats_random_actions_by_little_has_not_worked():
    assert scale_of([4.5] * 3, zero=0.0, random=4.0).policy_state == "never worked"
    assert not scale_of([1.0] * 3, zero=1.0, random=0.5).survival, "not every step pays the same"
