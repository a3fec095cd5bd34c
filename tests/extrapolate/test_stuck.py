"""A lane that lives on and achieves nothing is seen."""

from __future__ import annotations

import gymnasium
import numpy as np
from scripted import Script, evaluate, policy_for

from perdure.envs.gymnasium_world import GymnasiumWorld
from perdure.extrapolate import LaneSpec, evaluate_lanes
from perdure.extrapolate.stuck import StuckWatch
from perdure.policy import TaskInfo


def stuck(*rewards_by_lane, steps=5_000):
    """Steps in stuck phases after ``steps`` steps, by lane."""
    watch = StuckWatch(len(rewards_by_lane))
    lanes = np.arange(len(rewards_by_lane))
    for step in range(1, steps + 1):
        watch.add(lanes, np.array([float(reward(step)) for reward in rewards_by_lane]), step)
    return watch.stuck_steps.tolist()


def test_only_windows_below_a_tenth_of_the_first_thousand_steps_are_stuck():
    assert stuck(
        lambda step: 1.0,
        lambda step: 1.0 if step <= 2_000 else 0.0,
        lambda step: 1.0 if step <= 1_000 else 0.11,
        lambda step: 1.0 if step <= 1_000 else 0.09,
        lambda step: 0.0 if 1_000 < step <= 2_000 else 1.0,
        lambda step: 1.0 if step <= 1_000 else -1.0,
    ) == [0, 3_000, 0, 4_000, 1_000, 4_000]


def test_a_lane_that_never_earned_anything_has_nothing_to_fall_behind():
    assert stuck(lambda step: 0.0, lambda step: -1.0, lambda step: float(step > 1_000)) == [0, 0, 0]


def test_an_unfinished_window_is_not_judged():
    assert stuck(lambda step: float(step <= 1_000), steps=1_999) == [0]
    assert stuck(lambda step: float(step <= 1_000), steps=2_000) == [1_000]


def test_a_lane_that_ends_in_the_middle_of_a_window_keeps_the_judgement_of_the_whole_ones():
    records = evaluate([Script(reward=lambda step: float(step <= 1_000), falls_at=2_500), Script()], 4_000)
    assert records.stuck_steps[:, -1].tolist() == [1_000, 0]
    assert records.stuck_steps[0].tolist() == sorted(records.stuck_steps[0])


class Flipped(gymnasium.Wrapper):
    """A cheetah that is laid on its back at one step."""

    def __init__(self, env, when):
        super().__init__(env)
        self.when, self.steps = when, 0

    def step(self, action):
        self.steps += 1
        if self.steps == self.when:
            data = self.unwrapped.data
            pose = data.qpos.copy()
            pose[1:] = 0.0
            pose[2] = np.pi
            self.unwrapped.set_state(pose, np.zeros_like(data.qvel))
        return self.env.step(action)


def test_a_real_cheetah_laid_on_its_back_lives_on_and_is_called_stuck():
    """It is paid for staying the right way up first, because random weights do not run."""

    def build(when):
        def make():
            env = gymnasium.make("HalfCheetah-v5", max_episode_steps=-1, disable_env_checker=True)
            upright = gymnasium.wrappers.TransformReward(
                env, lambda reward: float(np.cos(env.unwrapped.data.qpos[2]) > 0) * (1 + 0 * reward)
            )
            return Flipped(upright, when)

        return make

    world = GymnasiumWorld([build(None), build(1_500)], [0, 1], "gymnasium:HalfCheetah-v5")
    task = TaskInfo("gymnasium:HalfCheetah-v5", 17, (-1.0,) * 6, (1.0,) * 6)
    policy = policy_for(task)
    policy.weights["policy.0.weight"][:] = 0.0  # it lies still
    records = evaluate_lanes([policy], [LaneSpec(0, None, 0), LaneSpec(0, None, 1)], 3_000, world=world)
    assert records.end_step.tolist() == [3_000, 3_000], "nothing ends a cheetah's episode"
    assert records.stuck_steps[:, -1].tolist() == [0, 1_000]
    assert records.last_tenth.tolist() == [1.0, 0.0]
