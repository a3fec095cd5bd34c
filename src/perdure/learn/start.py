"""Training that continues a policy: its network and its observation statistics, with a new critic.

Episodes of a longer horizon have other values, so the critic, the optimizer and the scale of the rewards begin anew. A
time-to-go input that the policy lacks gets weights of 0: at first, the new policy acts as the old one did.

To learn to walk with a short horizon and to lengthen it afterwards is old (Francois-Lavet et al., How to discount deep
reinforcement learning, 2015).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from perdure.envs import TaskSpec
from perdure.errors import PerdureError
from perdure.learn.config import PPOConfig
from perdure.learn.networks import CLIP, EPSILON, Params, RunningMoments
from perdure.policy import Policy

TRAINED_STEPS = 1_000_000
"""Stands for the steps that a policy was trained for, where it does not say."""


def start_file(start: Path, seed: int) -> Path:
    """Return the policy that a training seed continues.

    Args:
        start: A policy, which every seed continues, or a folder of policies by seed: ``seed-3.safetensors``, or
            ``seed-3/policy.safetensors`` as in the folder of a training run.
        seed: The training seed.

    Raises:
        PerdureError: A folder has no policy of this seed.
    """
    if not start.is_dir():
        return start
    files = [start / f"seed-{seed}.safetensors", start / f"seed-{seed}" / "policy.safetensors"]
    for file in files:
        if file.is_file():
            return file
    raise PerdureError(f"--from {start}: the folder has neither {files[0].name} nor seed-{seed}/{files[1].name}")


def trained_steps(policy: Policy) -> int:
    """Return the environment steps that a policy was trained for, those of the policies it continued included."""
    before = policy.provenance.get("from", {})
    return _steps(policy.provenance.get("config", {}), "total_steps", TRAINED_STEPS) + _steps(before, "steps", 0)


def _steps(values: Any, name: str, default: int) -> int:
    if isinstance(values, dict):
        found = values.get(name)
        if isinstance(found, int) and 0 < found < 10**15:
            return found
    return default


def continue_from(policy: Policy, params: Params, config: PPOConfig, spec: TaskSpec) -> tuple[Params, RunningMoments]:
    """Return new parameters with the policy's actor, and the moments of the observations it has seen.

    Args:
        policy: The policy to continue.
        params: New parameters; the critic and the log standard deviation are kept.
        config: The settings of the training that follows.
        spec: Its task.

    Raises:
        PerdureError: The policy has another task, input, network or normalizer than the settings.
    """
    _check(policy, config, spec)
    actor = {name: value for name, value in policy.weights.items() if name.startswith("policy.")}
    known = policy.protocol.embedding_size
    if config.protocol.embedding_size > known and config.conditioning == "concatenate":
        first = actor["policy.0.weight"]
        rows = np.zeros((config.protocol.embedding_size - known, first.shape[1]), np.float32)
        actor["policy.0.weight"] = np.concatenate([first, rows])
    for name, value in params.items():
        if name.startswith("policy.") and name not in actor:
            actor[name] = np.asarray(value)  # the modulation of hidden layers by phi, which starts at 0
        elif name.startswith("policy.") and actor[name].shape != value.shape:
            raise PerdureError(
                f"--from: {name} of the policy has shape {actor[name].shape}, the settings need {tuple(value.shape)}; "
                "leave hidden_sizes and conditioning as they are"
            )
    continued = {name: jnp.asarray(value, jnp.float32) for name, value in actor.items()}
    return {**params, **continued}, _moments(policy)


def _check(policy: Policy, config: PPOConfig, spec: TaskSpec) -> None:
    """Raise PerdureError if training cannot continue this policy."""
    box = (spec.observation_size, tuple(spec.action_low.tolist()), tuple(spec.action_high.tolist()))
    if (policy.task.observation_size, policy.task.action_low, policy.task.action_high) != box:
        raise PerdureError(
            f"--from: the policy is for {policy.task.name}, whose observations or actions are not those of {spec.name}"
        )
    if policy.activation != config.activation:
        raise PerdureError(f"--from: the policy's activation is {policy.activation!r}, not {config.activation!r}")
    if policy.squash is not None:
        raise PerdureError("--from: PPO here has no tanh at the output of the policy, which this policy has")
    if policy.protocol.embedding not in (None, config.protocol.embedding):
        raise PerdureError(
            f"--from: the policy's time-to-go input is {policy.protocol.embedding}, that of the method "
            f"{config.protocol.embedding}; name the method that it was trained with"
        )
    if config.protocol.normalize_embedding or policy.protocol.normalize_embedding:
        raise PerdureError("--from: the policy's normalizer is kept, so normalize_embedding must be off")
    if policy.normalizer.clip != CLIP and not policy.normalizer.is_identity:
        raise PerdureError(f"--from: the policy clips its inputs to {policy.normalizer.clip}, PPO here to {CLIP}")


def _moments(policy: Policy) -> RunningMoments:
    """Return the policy's observation statistics, with the weight of the steps that made them."""
    variance = policy.normalizer.var + policy.normalizer.epsilon - EPSILON
    count = float(trained_steps(policy))
    return RunningMoments(
        jnp.asarray(policy.normalizer.mean, jnp.float64),
        jnp.asarray(variance, jnp.float64),
        jnp.asarray(count, jnp.float64),
    )
