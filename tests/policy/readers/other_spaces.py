"""Pendulums with other spaces, registered in Gymnasium for models of Stable-Baselines3."""

import gymnasium
import numpy as np
from gymnasium.envs.classic_control import PendulumEnv

TWO_GEARS = "PendulumTwoGears-v0"
DICT = "PendulumDict-v0"


class TwoGears(gymnasium.ActionWrapper):
    """The torque is -2, 0 or 2, in the second gear halved."""

    def __init__(self):
        super().__init__(PendulumEnv())
        self.action_space = gymnasium.spaces.MultiDiscrete([3, 2])

    def action(self, action):
        """Return the torque."""
        direction, gear = action
        return np.array([2.0 * (direction - 1) / (1 + gear)], np.float32)


class DictObservation(gymnasium.ObservationWrapper):
    """Speed and direction of the pendulum, each with its name."""

    def __init__(self):
        super().__init__(PendulumEnv())
        box = gymnasium.spaces.Box
        spaces = {"speed": box(-8, 8, (1,), np.float32), "direction": box(-1, 1, (2,), np.float32)}
        self.observation_space = gymnasium.spaces.Dict(spaces)

    def observation(self, observation):
        """Return the named parts."""
        return {"speed": observation[2:], "direction": observation[:2]}


for name, kind in ((TWO_GEARS, TwoGears), (DICT, DictObservation)):
    gymnasium.register(name, kind, max_episode_steps=200)
