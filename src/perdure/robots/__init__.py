"""Legged robots that track a velocity command: your exported policy on its own robot, from a contract in one YAML file.

Importing this package registers `perdure/VelocityCommand-v0`; the path of a contract is also the name of a task.
"""

import gymnasium

from perdure.robots import deployment, isaac_lab, leapp, legged_gym, unitree  # noqa: F401  (their readers register themselves)
from perdure.robots.contract import Contract
from perdure.robots.readers import read_contract

__all__ = ["Contract", "read_contract"]

gymnasium.register("perdure/VelocityCommand-v0", "perdure.robots.world:VelocityCommandEnv")
