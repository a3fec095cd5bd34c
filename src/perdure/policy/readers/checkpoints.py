"""Convert state dicts of PyTorch to a `Policy`: models of CleanRL's `ppo_continuous_action`, checkpoints of rsl_rl.

CleanRL saves the state dict of its Agent: actor and critic, each a chain of linear layers with tanh between them, and
the logarithm of the standard deviation. Gymnasium's wrappers normalize what the Agent sees (`NormalizeObservation`, cut
to +-10) and cut what it does (`ClipAction`); their statistics are not in the file.

`OnPolicyRunner.save` of rsl_rl writes `model_1500.pt`:

| version | actor | mean and deviation of its observations |
|---|---|---|
| 4, 5 | `actor_state_dict`: `mlp.N.weight` | in the same dict: `obs_normalizer._mean` and `_std` |
| 3 | `model_state_dict`: `actor.N.weight` | in the same dict: `actor_obs_normalizer._mean` and `_std` |
| 2 | as 3 | `obs_norm_state_dict`: `_mean` and `_std` |
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, task_of_environment, task_spec
from perdure.errors import PerdureError, warn
from perdure.horizon import Fixed, HorizonProtocol
from perdure.policy.policy import LARGEST_OBSERVATION, Normalizer, Policy, TaskInfo
from perdure.policy.readers.restricted_pickle import TorchState
from perdure.policy.readers.sb3_import import NO_NORMALIZER, checked_normalizer, library_versions
from perdure.policy.reference import measure_reference, resolve_training_horizon
from perdure.runs import file_digest, read_bounded

CLIP = 10.0
"""CleanRL clips normalized observations to +-CLIP."""
GAMMA = 0.99
"""Default of both; the files do not hold it, and acting does not depend on it."""
MAX_BYTES = 500_000_000

_NETWORKS = {"policy": "actor_mean", "value": "critic"}
"""Name of a network here, and in the file."""


def import_cleanrl(
    path: str | Path, env: str, *, normalizer: Any = None, training_horizon: int | None = None, measure: bool = True
) -> Policy:
    """Return the policy of a CleanRL model, acting with its mean.

    Args:
        path: The `.cleanrl_model` that `ppo_continuous_action` (or a variant with the same Agent) saved.
        env: The environment it was trained in, see `perdure.envs.task_of_environment`.
        normalizer: Statistics of `NormalizeObservation`: its ``envs.envs[0].get_wrapper_attr("obs_rms")`` after
            training, (mean, variance), or an .npz file that holds them as `mean` and `var`. "none": no such wrapper.
        training_horizon: Steps of a training episode; the environment's own step limit by default.
        measure: Also measure 20 reference episodes within the training horizon, which takes some seconds.

    Raises:
        PerdureError: If a file is damaged or is no such model, the statistics are missing, the environment cannot be
            made, or model, statistics and environment do not fit together.
        OSError: If a file cannot be read.
    """
    path = Path(path)
    spec = task_spec(task_of_environment(env))
    state = TorchState(read_bounded(path, MAX_BYTES), str(path))
    if "actor_logstd" not in state.names:
        raise PerdureError(f"{path} is not a model of CleanRL's ppo_continuous_action: it holds {state.names[:8]}")
    weights = {"log_std": state.array("actor_logstd").reshape(-1)}
    for ours, theirs in _NETWORKS.items():
        weights.update(_layers(state, ours, theirs, path))
    _check_sizes(weights, spec, str(path))
    horizon = Fixed(resolve_training_horizon(spec, training_horizon))
    policy = Policy(
        task=TaskInfo.of(spec),
        weights=weights,
        activation="tanh",
        normalizer=_normalizer(normalizer, spec, str(path)),
        protocol=HorizonProtocol(None, horizon, "terminated", GAMMA, GAMMA),
        provenance=_provenance(path, env, "CleanRL PPO"),
    )
    if measure:
        policy = replace(policy, reference=measure_reference(policy))
    return policy


_ACTORS = ("actor_state_dict.mlp", "model_state_dict.actor")
_STATISTICS = ("actor_state_dict.obs_normalizer", "model_state_dict.actor_obs_normalizer", "obs_norm_state_dict")
_KNOWN = re.compile(
    r"actor_state_dict\.((mlp|obs_normalizer|distribution)\.|(log_)?std$)|"
    r"model_state_dict\.((actor|critic)(_obs_normalizer)?\.|(log_)?std$)|(?!actor_state_dict|model_state_dict)"
)
"""Parts of a checkpoint of rsl_rl whose actor is a plain perceptron."""
RSL_RL_EPSILON = 0.01
"""rsl_rl divides an observation by its standard deviation plus this."""
_RSL_RL_NAMES = {"lrelu": "leaky_relu", "swish": "silu"}
"""Activation functions that rsl_rl names otherwise."""


def import_rsl_rl(
    path: str | Path,
    env: str,
    *,
    activation: str | None = None,
    training_horizon: int | None = None,
    measure: bool = True,
) -> Policy:
    """Return the policy in a checkpoint of rsl_rl, acting with its mean.

    Args:
        path: The `model_*.pt` that `OnPolicyRunner.save` wrote.
        env: The environment it was trained in, see `perdure.envs.task_of_environment`.
        activation: Of the actor, which the file does not name. None: as in `params/agent.yaml` beside the file, which
            Isaac Lab and mjlab write; without it "elu", rsl_rl's default, with a PerdureWarning.
        training_horizon: As in `import_cleanrl`.
        measure: As in `import_cleanrl`.

    Raises:
        PerdureError: If the file is damaged or is no such checkpoint, its actor is no perceptron, the environment
            cannot be made, or they do not fit together.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    spec = task_spec(task_of_environment(env))
    state = TorchState(read_bounded(path, MAX_BYTES), str(path))
    prefix = next((each for each in _ACTORS if f"{each}.0.weight" in state.names), None)
    unknown = [name for name in state.names if not _KNOWN.match(name)]
    if unknown:
        raise PerdureError(
            f"{path}: its actor is no plain perceptron, it has {unknown[0][:80]!r}: export it with "
            "runner.export_policy_to_onnx(folder), and evaluate policy.onnx"
        )
    if prefix is None:
        raise PerdureError(f"{path} is not a checkpoint of rsl_rl: it holds {state.names[:8]}")
    weights = dict(_layers(state, "policy", prefix, path))
    _check_sizes(weights, spec, str(path))
    normalizer = Normalizer.identity(spec.observation_size)
    statistics = next((each for each in _STATISTICS if f"{each}._mean" in state.names), None)
    if statistics is not None:
        mean = state.array(f"{statistics}._mean").astype(np.float64).ravel()
        std = state.array(f"{statistics}._std").astype(np.float64).ravel()
        normalizer = checked_normalizer(mean, (std + RSL_RL_EPSILON) ** 2, LARGEST_OBSERVATION, 0.0, str(path))
    name = activation or _activation(path)
    horizon = Fixed(resolve_training_horizon(spec, training_horizon))
    policy = Policy(
        task=TaskInfo.of(spec),
        weights=weights,
        activation=_RSL_RL_NAMES.get(name, name),
        normalizer=normalizer,
        protocol=HorizonProtocol(None, horizon, "truncated", GAMMA, GAMMA),
        provenance=_provenance(path, env, "rsl_rl"),
    )
    if measure:
        policy = replace(policy, reference=measure_reference(policy))
    return policy


def _activation(path: Path) -> str:
    written = path.parent / "params" / "agent.yaml"
    if written.is_file():
        text = read_bounded(written, 1_000_000).decode("utf-8", "replace")
        actor = re.split(r"^ *critic:", text, flags=re.MULTILINE)[0]
        found = set(re.findall(r"^ +activation: *['\"]?(\w+)", actor, re.MULTILINE))
        if len(found) == 1:
            return str(found.pop())
    text = f"{path} does not name its activation function, nor does {written}; elu is assumed, rsl_rl's default"
    warn(text)
    return "elu"


def _provenance(path: Path, env: str, method: str) -> dict[str, Any]:
    source = {"file": path.name, "sha256": file_digest(path), "env": env}
    return {"method": f"{method} ({path.stem})", "source": source, "versions": library_versions()}


def _layers(state: TorchState, ours: str, theirs: str, path: Path) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield weights (in, out) and biases of one network under our names, in the order of its layers."""
    found = [re.fullmatch(rf"{re.escape(theirs)}\.(\d{{1,4}})\.weight", name) for name in state.names]
    numbers = sorted(int(match[1]) for match in found if match)
    if not numbers or numbers != list(range(0, 2 * len(numbers), 2)):
        raise PerdureError(f"{path}: {theirs} must have its linear layers at 0, 2, 4, ..., it has them at {numbers}")
    for layer, number in enumerate(numbers):
        yield f"{ours}.{layer}.weight", np.ascontiguousarray(state.array(f"{theirs}.{number}.weight").T)
        yield f"{ours}.{layer}.bias", np.atleast_1d(state.array(f"{theirs}.{number}.bias"))


def _check_sizes(weights: dict[str, NDArray[np.float32]], spec: TaskSpec, what: str) -> None:
    biases = [weights[name] for name in weights if name.startswith("policy.") and name.endswith(".bias")]
    inputs = len(weights["policy.0.weight"])
    outputs = len(biases[-1])
    if (inputs, outputs) != (spec.observation_size, spec.action_size) or spec.discrete_actions:
        kind = "discrete" if spec.discrete_actions else "continuous"
        raise PerdureError(
            f"{what}: its network takes {inputs} numbers and gives {outputs}, but {spec.name} gives "
            f"{spec.observation_size} and takes {spec.action_size} ({kind})"
        )


def _normalizer(given: Any, spec: TaskSpec, what: str) -> Normalizer:
    if given is None:
        raise PerdureError(
            f"{what} does not hold the statistics by which CleanRL normalizes observations: give "
            'normalizer=(mean, variance) of the wrapper, envs.envs[0].get_wrapper_attr("obs_rms"), an .npz file with '
            f'mean and var, or "{NO_NORMALIZER}" if there was no such wrapper'
        )
    if isinstance(given, str) and given == NO_NORMALIZER:
        return Normalizer.identity(spec.observation_size)
    try:
        if isinstance(given, str | Path):
            given = _read_statistics(Path(given))
        if not isinstance(given, Sequence | np.ndarray):
            given = (given.mean, given.var)
        mean, var = (np.array(each, np.float64) for each in given)
    except PerdureError:
        raise
    except (AttributeError, TypeError, ValueError) as error:
        raise PerdureError(f"{what}: normalizer must be a mean and a variance, or a file of them: {error}") from None
    legal = all(each.shape == (spec.observation_size,) and np.isfinite(each).all() for each in (mean, var))
    if not legal or (var < 0).any():
        raise PerdureError(
            f"{what}: mean and variance must be {spec.observation_size} finite numbers each, variances not negative; "
            f"their shapes are {mean.shape} and {var.shape}"
        )
    return Normalizer(mean, var, clip=CLIP)


def _read_statistics(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        with np.load(io.BytesIO(read_bounded(path, MAX_BYTES)), allow_pickle=False) as arrays:
            return np.array(arrays["mean"], np.float64), np.array(arrays["var"], np.float64)
    except (OSError, PerdureError):
        raise
    except Exception as error:  # NumPy and zipfile raise many kinds for damaged files
        raise PerdureError(f"{path} must be an .npz file with the arrays mean and var: {error}") from None
