"""The cure: further training that makes a policy hold, as data (`Recipe`) and as a training run (`Recipe.run`).

A policy that walks within its training episodes, and falls when it is disturbed or when they no longer end, is trained
further: with a longer horizon, under noise on its actions, for a fraction of its first training. `perdure.learn.start`
says what is kept: the network and the statistics of the observations.

| setting | value | why |
|---|---|---|
| gamma | 0.999 | a horizon of 1,000 steps: a fall that is seconds away costs what it will cost |
| disturbance | `action_noise:0.1` | the policy meets the states from which it has to recover |
| steps | 300,000 | minutes on one core |
| log standard deviation | -1 (HalfCheetah: -1.5) | as wide as at the start of a training, exploration makes it fall |

Under `standard-1` it raises the work of Hopper and of Walker2d and lowers that of HalfCheetah, which holds without it
(`results/cure/README.md`). To train with gamma = 0.999 from the start is no shortcut on Hopper: most runs hardly walk.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from perdure.envs import TaskSpec, task_spec
from perdure.horizon import HorizonProtocol, robot_of, usual_preset
from perdure.learn.config import Further, PPOConfig
from perdure.learn.presets import METHODS, TUNED, ZOO, default_clock, method_config
from perdure.learn.run import TrainRun
from perdure.learn.start import check_start, start_file
from perdure.policy import Normalizer, Policy, TaskInfo, load_policy

NAME = "cured"
"""Names the training runs of the recipe, and so their folder and the label of their policies."""
LOG_STD = -1.0
LOG_STDS = {"HalfCheetah": -1.5}
"""Of robots for which another one was measured: the Zoo's preset of HalfCheetah starts at -2."""
FALLING_STEP_SIZE = "cleanrl"
"""Preset of Stable-Baselines3's defaults with a step size that falls linearly to 0."""


@dataclass(frozen=True)
class Recipe(Further):
    """Settings of the further training, without the policy. The defaults are those that were measured."""

    def run(self, start: Path, task: str, seeds: tuple[int, ...] = (0,), name: str = NAME) -> TrainRun:
        """Return the training that continues a policy, one run for each seed.

        Args:
            start: Policy file, or a folder with one for each seed, as `TrainRun.start` takes it.
            task: The task to train in.
            seeds: Training seeds.
            name: Names the runs' folder.

        Raises:
            PerdureError: There is no such policy or task, or the policy cannot be continued, with the reason.
        """
        policy = load_policy(start_file(start, seeds[0]))
        return TrainRun(
            task,
            name,
            self.config(policy, task),
            seeds,
            base_method=base_method(policy, task),
            disturb=self.disturb,
            start=start,
        )

    def config(self, policy: Policy, task: str) -> PPOConfig:
        """Return the settings with which a policy is trained further: those of the task's preset, and the recipe's.

        A policy with a time-to-go input keeps the horizon protocol that it was trained with, because its input would
        mean something else without it. Where that has no discount, only the noise is new.

        Raises:
            PerdureError: As `run`.
        """
        spec = task_spec(task)
        usual = method_config("ppo", task, spec.observation_size, recipe_preset(task), spec.default_horizon)
        config = usual.continued(policy)
        protocol = replace(config.protocol, gamma=self.longer_gamma(policy.protocol))
        if policy.has_clock:
            protocol = policy.protocol
            if protocol.gamma < 1.0:
                protocol = replace(protocol, gamma=self.longer_gamma(protocol))
        if any(name.endswith(".scale") for name in policy.weights):
            config = replace(config, protocol=protocol, conditioning="film")
        config = replace(
            config, protocol=protocol, total_steps=self.total_steps, log_std_init=start_log_std(task, spec)
        )
        check_start(policy, config, spec)
        return config

    def longer_gamma(self, protocol: HorizonProtocol) -> float:
        """Return the discount of the further training: the recipe's, or the policy's own if that looks further ahead.

        It is never shortened, because a policy that was trained with 0.9999 would lose what it knows of later steps.
        It is not made ten times longer either: beyond 0.999 nothing was measured, and the error of the critic grows
        with the horizon. A policy that was trained without a discount gets the recipe's: a new critic without one is
        determined only up to a constant.
        """
        if self.gamma <= protocol.gamma < 1.0:
            return protocol.gamma
        return self.gamma


def further_config(config: PPOConfig, task: str) -> PPOConfig:
    """Return the settings of the further training `config.then` of the policy that these settings train."""
    assert config.then is not None
    return Recipe(**asdict(config.then)).config(_untrained(config, task_spec(task)), task)


def _untrained(config: PPOConfig, spec: TaskSpec) -> Policy:
    """Return a policy with the network of these settings, all of its weights 0: what is known before training."""
    sizes = (spec.observation_size + config.protocol.embedding_size, *config.hidden_sizes, spec.action_size)
    weights = {"log_std": np.zeros(spec.action_size, np.float32)}
    for layer, shape in enumerate(pairwise(sizes)):
        weights[f"policy.{layer}.weight"] = np.zeros(shape, np.float32)
        weights[f"policy.{layer}.bias"] = np.zeros(shape[1], np.float32)
    seen = Normalizer(np.zeros(spec.observation_size), np.ones(spec.observation_size), config.clip_obs)
    return Policy(TaskInfo.of(spec), weights, config.activation, seen, config.protocol, default_clock(config))


def recipe_preset(task: str) -> str:
    """Return the preset of hyperparameters with which a task's policies are continued.

    Where RL Zoo tuned a robot and its preset is the usual one, that was measured and is used (its step size is
    constant and small). For any other task, Stable-Baselines3's defaults with a falling step size: nobody has tuned a
    constant one there, and a step size that ends at 0 leaves a policy that no longer changes when it is deployed.
    """
    if usual_preset(task) == ZOO and robot_of(task) in TUNED:
        return ZOO
    return FALLING_STEP_SIZE


def start_log_std(task: str, spec: TaskSpec) -> float:
    """Return the log standard deviation at the start of the further training.

    It was measured on robots whose actions go from -1 to 1. Elsewhere it is the same share of half the action range,
    of the narrowest action component.
    """
    widths = spec.action_high - spec.action_low
    half = 0.5 * float(widths.min())
    log_std = LOG_STDS.get(robot_of(task), LOG_STD)
    if not 0.0 < half < math.inf:
        return log_std
    return log_std + math.log(half)


def base_method(policy: Policy, task: str) -> str | None:
    """Return the training method whose settings the further training changes; None where no method is like it.

    A policy without a time-to-go input is continued as plain PPO, another one as the method that made it.
    """
    if not policy.has_clock:
        return "ppo"
    own = policy.protocol
    spec = task_spec(task)
    for method in METHODS:
        usual = method_config(method, task, spec.observation_size, limit=spec.default_horizon).protocol
        if (usual.embedding, usual.horizon, usual.end) == (own.embedding, own.horizon, own.end):
            return method
    return None
