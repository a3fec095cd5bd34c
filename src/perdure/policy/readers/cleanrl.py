"""Convert a model of CleanRL's `ppo_continuous_action` to a `Policy`.

CleanRL saves the state dict of its Agent: actor and critic, each a chain of linear layers with tanh between them, and
the logarithm of the standard deviation. Gymnasium's wrappers normalize what the Agent sees (`NormalizeObservation`, cut
to +-10) and cut what it does (`ClipAction`); their statistics are not in the file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.envs import TaskSpec, task_of_environment, task_spec
from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonProtocol
from perdure.policy.policy import Normalizer, Policy, TaskInfo
from perdure.policy.readers.restricted_pickle import TorchState
from perdure.policy.readers.sb3_import import library_versions
from perdure.policy.reference import measure_reference, resolve_training_horizon
from perdure.runs import file_digest, read_bounded

NO_NORMALIZER = "none"
"""Says that the model saw raw observations."""
CLIP = 10.0
"""CleanRL clips normalized observations to +-CLIP."""
GAMMA = 0.99
"""CleanRL's default; the file does not hold it, and acting does not depend on it."""
MAX_BYTES = 500_000_000


class RunningStatistics(Protocol):
    """Statistics of observations, such as Gymnasium's `RunningMeanStd`."""

    @property
    def mean(self) -> ArrayLike:
        """Shape (d,)."""

    @property
    def var(self) -> ArrayLike:
        """Shape (d,)."""


ObservationStatistics = str | Path | Sequence[ArrayLike] | NDArray[np.float64] | RunningStatistics
"""How `import_cleanrl` is given them."""
_NETWORKS = {"policy": "actor_mean", "value": "critic"}
"""Name of a network here, and in the file."""


def import_cleanrl(
    path: str | Path,
    env: str,
    *,
    normalizer: ObservationStatistics | None = None,
    training_horizon: int | None = None,
    measure: bool = True,
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
    task, path = task_of_environment(env), Path(path)
    spec = task_spec(task)
    state = TorchState(read_bounded(path, MAX_BYTES), str(path))
    weights = {
        name: array for ours, theirs in _NETWORKS.items() for name, array in _layers(state, ours, theirs, str(path))
    }
    _check_sizes(weights, spec, str(path))
    protocol = HorizonProtocol(
        None, Fixed(resolve_training_horizon(spec, training_horizon)), "terminated", GAMMA, GAMMA
    )
    policy = Policy(
        task=TaskInfo.of(spec),
        weights={**weights, "log_std": state.array("actor_logstd").reshape(-1)},
        activation="tanh",
        normalizer=_normalizer(normalizer, spec, str(path)),
        protocol=protocol,
        provenance={
            "method": f"CleanRL PPO ({path.stem})",
            "source": {"file": path.name, "sha256": file_digest(path), "env": env},
            "versions": library_versions(),
        },
    )
    return replace(policy, reference=measure_reference(policy)) if measure else policy


def _layers(state: TorchState, ours: str, theirs: str, what: str) -> list[tuple[str, NDArray[np.float32]]]:
    """Return weights (in, out) and biases of one network under our names, in the order of its layers."""
    found = [re.fullmatch(rf"{theirs}\.(\d+)\.weight", name) for name in state.names]
    numbers = sorted(int(match[1]) for match in found if match)
    if not numbers or "actor_logstd" not in state.names:
        raise PerdureError(
            f"{what} is not a model of CleanRL's ppo_continuous_action: it holds {', '.join(state.names[:8])}"
        )
    if numbers != list(range(0, 2 * len(numbers), 2)):
        raise PerdureError(f"{what}: {theirs} must have its linear layers at 0, 2, 4, ..., it has them at {numbers}")
    layers = []
    for layer, number in enumerate(numbers):
        weight = np.ascontiguousarray(state.array(f"{theirs}.{number}.weight").T)
        layers += [(f"{ours}.{layer}.weight", weight), (f"{ours}.{layer}.bias", state.array(f"{theirs}.{number}.bias"))]
    return layers


def _check_sizes(weights: dict[str, NDArray[np.float32]], spec: TaskSpec, what: str) -> None:
    biases = [weights[name] for name in weights if name.startswith("policy.") and name.endswith(".bias")]
    sizes, needed = (len(weights["policy.0.weight"]), len(biases[-1])), (spec.observation_size, spec.action_size)
    if sizes != needed or spec.discrete_actions:
        kind = "discrete" if spec.discrete_actions else "continuous"
        raise PerdureError(
            f"{what}: its network takes {sizes[0]} numbers and gives {sizes[1]}, but {spec.name} gives {needed[0]} and "
            f"takes {needed[1]} ({kind})"
        )


def _normalizer(given: ObservationStatistics | None, spec: TaskSpec, what: str) -> Normalizer:
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
            both: Iterable[ArrayLike] = _read_statistics(Path(given))
        else:
            both = given if isinstance(given, Sequence | np.ndarray) else (given.mean, given.var)
        mean, var = (np.array(each, np.float64) for each in both)
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
