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
from numpy.typing import NDArray

from perdure.envs import TaskSpec
from perdure.errors import PerdureError
from perdure.learn.config import PPOConfig
from perdure.learn.networks import EPSILON, Params, RunningMoments
from perdure.policy import Policy
from perdure.policy.policy import SEEN

TRAINED_STEPS = 1_000_000
"""Stands for the steps that a policy was trained for, where it does not say."""
STILL = 1e15
"""Weight of statistics that further observations do not move."""
OWN_LEARNER = (
    "continue it with its own learner in perdure.wrappers.Disturb and with a longer horizon (gamma=0.999), as "
    "docs/how-to/when-a-policy-fails.md shows"
)
"""What to do with policies that PPO here cannot continue."""


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
    known = _steps(policy.provenance, "steps", TRAINED_STEPS)  # of another library
    return _steps(policy.provenance.get("config", {}), "total_steps", known) + _steps(before, "steps", 0)


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
    check_start(policy, config, spec)
    actor = {name: value for name, value in policy.weights.items() if name.startswith("policy.")}
    if policy.normalizer.is_identity:
        actor = _first_layer_of_normalized(policy, actor)
    known = policy.protocol.embedding_size
    if config.protocol.embedding_size > known and config.conditioning != "film":
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


def check_policy(policy: Policy) -> None:
    """Raise PerdureError, with the reason and what to do instead, if PPO here can continue no policy of this kind."""
    name = policy.provenance.get("method", "the policy")
    if policy.task.discrete_actions:
        raise PerdureError(f"{name} has discrete actions, and PPO here learns continuous ones: {OWN_LEARNER}")
    if policy.squash is not None:
        raise PerdureError(
            f"{name} sends its actions through tanh, as SAC, TQC and TD3 do; PPO here learns a Gaussian whose "
            f"mean is the network's output: {OWN_LEARNER}"
        )
    if "policy.1.weight" not in policy.weights:
        raise PerdureError(f"{name} has no hidden layer, and PPO here needs one: {OWN_LEARNER}")


def check_start(policy: Policy, config: PPOConfig, spec: TaskSpec) -> None:
    """Raise PerdureError if training with these settings cannot continue this policy."""
    check_policy(policy)
    box = (spec.observation_size, tuple(spec.action_low.tolist()), tuple(spec.action_high.tolist()))
    if (policy.task.observation_size, policy.task.action_low, policy.task.action_high) != box:
        raise PerdureError(
            f"the policy is for {policy.task.name}, whose observations or actions are not those of {spec.name}"
        )
    if policy.activation != config.activation:
        raise PerdureError(f"the policy's activation is {policy.activation!r}, not {config.activation!r}")
    if policy.normalizer.clip != config.clip_obs:
        raise PerdureError(f"the policy clips its inputs to {policy.normalizer.clip:g}, not {config.clip_obs:g}")
    if policy.protocol.embedding not in (None, config.protocol.embedding):
        raise PerdureError(
            f"the policy's time-to-go input is {policy.protocol.embedding}, that of the method "
            f"{config.protocol.embedding}; name the method that it was trained with (perdure cure keeps any)"
        )
    if policy.protocol.normalize_embedding != config.protocol.normalize_embedding:
        raise PerdureError(
            "the policy's normalizer is kept, so normalize_embedding must be as in the policy's training"
        )


def _moments(policy: Policy) -> RunningMoments:
    """Return the policy's observation statistics, with the weight of the observations that made them.

    The statistics of a policy that saw raw observations stay what they are: nothing is known of their weight.
    """
    mean = policy.normalizer.mean
    variance = policy.normalizer.var + policy.normalizer.epsilon - EPSILON
    count = seen_observations(policy)
    if policy.normalizer.is_identity:
        mean = raw_mean(policy)
        variance = np.square(raw_std(policy)) - EPSILON
        count = STILL
    return RunningMoments(
        jnp.asarray(mean, jnp.float64), jnp.asarray(variance, jnp.float64), jnp.asarray(count, jnp.float64)
    )


def seen_observations(policy: Policy) -> float:
    """Return how many observations made a policy's statistics; its training steps where it does not say."""
    count = policy.provenance.get(SEEN)
    if isinstance(count, int | float) and 0.0 < count < STILL:
        return float(count)
    return float(trained_steps(policy))


# Policies that saw raw observations: PPO here normalizes them, so the first layer takes the factors back


def raw_mean(policy: Policy) -> NDArray[np.float64]:
    """Return the middle of the range that each raw observation covered in the policy's reference episodes."""
    if policy.reference is None:
        return np.zeros(policy.task.observation_size)
    return 0.5 * (policy.reference.observation_low + policy.reference.observation_high)


def raw_std(policy: Policy) -> NDArray[np.float64]:
    """Return the spread that stands for that of raw observations, see `Policy.observation_std`; 1 where it is 0."""
    std = policy.observation_std
    return np.where(std > 0.0, std, 1.0)


def _first_layer_of_normalized(policy: Policy, actor: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the actor with a first layer that does to normalized observations what it did to raw ones."""
    weight = np.array(actor["policy.0.weight"], np.float64)
    size = policy.task.observation_size
    bias = actor["policy.0.bias"] + raw_mean(policy) @ weight[:size]
    weight[:size] *= raw_std(policy)[:, None]
    return {**actor, "policy.0.weight": weight.astype(np.float32), "policy.0.bias": bias.astype(np.float32)}
