"""A world that blew up ends its episode under its own name, is not paid for it, and is not taken for a healthy one."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from scripted import SCRIPTED, Script, evaluate, policy_for, world_of

from perdure.envs import make_world
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.evaluate import EpisodeSpec, evaluate_episodes
from perdure.evaluate.episodes import DIVERGED, SURVIVED, TERMINATED
from perdure.evaluate.reference import measure_idle
from perdure.policy import TaskInfo, measure_reference

STEPS = 50
HEALTHY = Script(reward=lambda step: float(step % 7), place=lambda step: 0.01 * step)


def at(step, wrong, usual=1.0):
    return lambda now: wrong if now == step else usual


BLOW_UPS = {
    "a reward that is not a number": Script(reward=at(20, np.nan)),
    "an infinite reward": Script(reward=at(20, np.inf)),
    "an infinite reward at once": Script(reward=lambda step: np.inf if step >= 20 else 1.0),
    "an observation that is not a number": Script(place=at(20, np.nan)),
    "an infinite observation": Script(place=at(20, -np.inf, usual=0.0)),
    "the pay for a teleport": Script(reward=at(20, 3_000.0)),
    "the price of a teleport": Script(reward=at(20, -3_000.0)),
    # Far away, then next to the start again: only the observation tells.
    "a snap back": Script(place=lambda step: 0.5 * step if step < 20 else 0.0),
}


@pytest.mark.parametrize("script", BLOW_UPS.values(), ids=BLOW_UPS)
def test_a_blow_up_ends_its_episode_unpaid_and_leaves_its_neighbors_alone(script):
    records = evaluate([HEALTHY, script, HEALTHY], STEPS)
    assert records.end_reason.tolist() == [SURVIVED, DIVERGED, SURVIVED]
    assert records.end_step.tolist() == [STEPS, 20, STEPS]
    assert records.returns[1, -1] == 19.0, "nineteen rewards before it, none for it or after it"
    quiet = evaluate([HEALTHY, Script(), HEALTHY], STEPS)
    np.testing.assert_array_equal(records.returns[[0, 2]], quiet.returns[[0, 2]])


def test_a_blow_up_at_the_step_of_a_fall_is_a_blow_up():
    records = evaluate([Script(reward=at(20, np.nan), falls_at=20)], STEPS)
    assert records.end_reason.tolist() == [DIVERGED]


NOT_BLOW_UPS = {
    "rewards that grow": Script(reward=lambda step: 1.5**step if step < 40 else 1.0),
    "a large first reward": Script(reward=lambda step: 1e6),
    "a walk back to the start": Script(place=lambda step: 0.5 * (step if step < 25 else 50 - step)),
    "finite numbers whose sum is infinite": Script(place=lambda step: 1e308, third=1e308),
    "a jump far away": Script(place=lambda step: 0.0 if step < 25 else 40.0),
}


@pytest.mark.parametrize("script", NOT_BLOW_UPS.values(), ids=NOT_BLOW_UPS)
def test_what_a_healthy_world_may_do_is_let_through(script):
    assert evaluate([script], STEPS).end_reason.tolist() == [SURVIVED]


def test_the_jump_of_a_hidden_divergence_is_paid_neither_in_the_reference_nor_to_an_idle_robot():
    jump = Script(reward=at(30, 3_000.0))
    reference = measure_reference(policy_for(SCRIPTED), 1, world_of([jump]))
    assert (reference.returns.tolist(), reference.lengths.tolist()) == ([29.0], [30])
    assert measure_idle(world_of([jump]), 50).rate == 1.0


GOALS = {
    "a goal that ends the episode": Script(reward=at(20, 100.0, usual=-0.1), falls_at=20),
    "a fall that costs much": Script(reward=at(20, -100.0, usual=0.3), falls_at=20),
}


@pytest.mark.parametrize("script", GOALS.values(), ids=GOALS)
@pytest.mark.parametrize("hidden", [False, True])
def test_the_reward_of_an_episode_s_last_step_is_paid_however_large(script, hidden):
    records = evaluate([script], STEPS, hidden)
    assert records.end_reason.tolist() == [TERMINATED]
    assert records.returns[0, -1] == pytest.approx(19 * script.reward(1) + script.reward(20))


def test_a_bonus_on_the_way_is_a_blow_up_only_where_the_engine_hides_them():
    """In EnvPool's MuJoCo nothing else tells a blow-up; elsewhere the engine reports it, or has none."""
    bonus = Script(reward=at(20, 100.0, usual=0.0))
    assert evaluate([bonus], STEPS, hides_divergence=False).end_reason.tolist() == [SURVIVED]
    assert evaluate([bonus], STEPS, hides_divergence=False).returns[0, -1] == 100.0
    assert evaluate([bonus], STEPS, hides_divergence=True).end_reason.tolist() == [DIVERGED]


@pytest.mark.parametrize(
    ("name", "hides"), [("HalfCheetah-v3", True), ("WalkerWalk-v1", True), ("gymnasium:HalfCheetah-v5", False)]
)
def test_only_mujoco_in_envpool_hides_a_divergence(name, hides):
    world = make_world(name, [0])
    assert world.spec.hides_divergence is hides
    world.close()


def task_of(name):
    world = make_world(name, [0])
    spec = world.spec
    world.close()
    return TaskInfo(name, spec.observation_size, tuple(spec.action_low), tuple(spec.action_high))


@pytest.mark.parametrize("name", ["HalfCheetah-v3", "Swimmer-v3"])
def test_two_thousand_steps_of_wild_actions_in_a_real_world_are_no_blow_up(name):
    episodes = [EpisodeSpec(0, None, seed, steps=2_000) for seed in range(3)]
    records = evaluate_episodes([policy_for(task_of(name))], episodes)
    assert records.end_reason.tolist() == [SURVIVED] * 3


class Thrown(gymnasium.Wrapper):
    """A MuJoCo environment that is thrown off at one step, so fast that its simulation blows up."""

    def __init__(self, env, when):
        super().__init__(env)
        self.when, self.steps = when, 0

    def reset(self, **options):
        self.steps = 0
        return self.env.reset(**options)

    def step(self, action):
        self.steps += 1
        if self.steps == self.when:
            data = self.unwrapped.data
            self.unwrapped.set_state(data.qpos.copy(), np.full_like(data.qvel, 1e9))
        return self.env.step(action)


def cheetahs(*when):
    def build(step):
        return lambda: Thrown(gymnasium.make("HalfCheetah-v5", max_episode_steps=-1, disable_env_checker=True), step)

    return GymnasiumWorld([build(step) for step in when], list(range(len(when))), "gymnasium:HalfCheetah-v5")


@pytest.mark.filterwarnings("ignore")  # MuJoCo and Gymnasium warn, as they should
def test_a_real_simulation_that_blows_up_ends_its_episode_and_no_other():
    policy = policy_for(task_of("gymnasium:HalfCheetah-v5"))
    episodes = [EpisodeSpec(0, None, seed, steps=60) for seed in range(3)]
    never = evaluate_episodes([policy], episodes, world=cheetahs(None, None, None))
    thrown = evaluate_episodes([policy], episodes, world=cheetahs(None, 30, None))
    assert never.end_reason.tolist() == [SURVIVED] * 3
    assert thrown.end_reason.tolist() == [SURVIVED, DIVERGED, SURVIVED]
    assert thrown.end_step[1] == 30
    step_29 = int(np.searchsorted(never.steps, 29))
    assert thrown.returns[1, -1] == never.returns[1, step_29], "what it had before, and nothing for the way back"
    np.testing.assert_array_equal(thrown.returns[[0, 2]], never.returns[[0, 2]])
