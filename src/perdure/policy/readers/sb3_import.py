"""Convert a Stable-Baselines3 model to a `Policy`, and check it against its environment."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, make_world, task_of_environment
from perdure.horizon import Countdown, Fixed, HorizonProtocol, TimeFeature
from perdure.policy.errors import PolicyError, PolicyWarning
from perdure.policy.measure import measure_reference, resolve_training_horizon
from perdure.policy.policy import Normalizer, Policy
from perdure.policy.readers.identity import library_versions
from perdure.policy.readers.sb3 import Sb3Model, read_sb3
from perdure.policy.readers.sb3_data import USE_A_FUNCTION
from perdure.policy.readers.vecnormalize import Statistics, read_vecnormalize
from perdure.policy.squash import TanhSquash
from perdure.policy.task import TaskInfo
from perdure.runs import file_digest

NO_NORMALIZER = "none"
"""Says that observations were not normalized, where the model suggests otherwise."""


def import_sb3(
    path: str | Path,
    env: str,
    *,
    normalizer: str | Path | None = None,
    time_feature: str | None = None,
    training_horizon: int | None = None,
    trust: bool = False,
    measure: bool = True,
) -> Policy:
    """Return the deterministic policy of a Stable-Baselines3 or sb3-contrib model.

    Its actions are those of `model.predict(observation, deterministic=True)` up to rounding in 32 bits. Read are PPO,
    A2C, TRPO, SAC, TQC, TD3 and DDPG with MlpPolicy and continuous actions.

    Args:
        path: The zip that `model.save` wrote.
        env: The environment it was trained in, see `perdure.envs.task_of_environment`.
        normalizer: The file that `VecNormalize.save` wrote; "none" where only rewards were normalized.
        time_feature: "linear:1000" if the environment was wrapped in sb3-contrib's TimeFeatureWrapper with these steps;
            "linear" takes the training horizon.
        training_horizon: Steps of a training episode; by default those of the time feature, or the environment's own
            step limit.
        trust: Load the files with Stable-Baselines3 itself, which runs the code pickled in them.
        measure: Also measure 20 reference episodes within the training horizon, which takes some seconds.

    Raises:
        PolicyFileError: If a file is damaged or holds something that is not read.
        PolicyError: If model, normalizer, time feature and environment do not fit together.
        WorldError: If the environment cannot be made.
        OSError: If a file cannot be read.
    """
    task = task_of_environment(env)
    world = make_world(task, [0])
    spec = world.spec
    world.close()
    path, written = Path(path), None if normalizer in (None, NO_NORMALIZER) else Path(str(normalizer))
    if trust:
        from perdure.policy.readers.trusted import load_sb3, load_vecnormalize

        model, statistics = load_sb3(path), None if written is None else load_vecnormalize(written)
    else:
        model, statistics = read_sb3(path), None if written is None else read_vecnormalize(written)
    if normalizer is None and model.settings.behind_vecnormalize:
        raise PolicyError(
            f"{path} was trained behind VecNormalize: give the file that its save() wrote with --normalizer "
            f"(normalizer=), or {NO_NORMALIZER!r} if only rewards were normalized"
        )
    _warn_of_normalizer(model, normalizer, written, str(path))
    steps = _time_feature_steps(time_feature)
    horizon = resolve_training_horizon(spec, training_horizon if training_horizon is not None else steps)
    if time_feature is not None:
        steps = steps or horizon
        if training_horizon is not None or spec.has_step_limit:
            _check_time_feature(steps, training_horizon or spec.default_horizon, spec.name)
    policy = _policy(model, spec, statistics, (steps, horizon), str(path))
    policy = replace(policy, provenance=_provenance(model, path, written, env, time_feature))
    return replace(policy, reference=measure_reference(policy)) if measure else policy


def _policy(
    model: Sb3Model, spec: TaskSpec, statistics: Statistics | None, times: tuple[int | None, int], what: str
) -> Policy:
    """Return the policy; `times` are the steps of the time feature, and of a training episode."""
    settings, (steps, horizon) = model.settings, times
    _check_sizes(model, spec, steps, what)
    weights: dict[str, NDArray[np.float32]] = {}
    for i, (weight, bias) in enumerate(model.layers):
        weights |= {f"policy.{i}.weight": weight, f"policy.{i}.bias": bias}
    size = spec.observation_size + (steps is not None)
    normalizer = None if statistics is None else statistics.normalizer
    if normalizer is not None and len(normalizer.mean) != size:
        raise PolicyError(
            f"{what}: the normalizer has statistics of {len(normalizer.mean)} numbers, but the policy is given {size}"
        )
    protocol = HorizonProtocol(
        embedding=None if steps is None else TimeFeature(steps),
        horizon=Fixed(horizon),
        end="truncated",
        gamma=min(settings.gamma, 1.0),
        normalizer_gamma=min(settings.gamma if statistics is None else statistics.gamma, 1.0),
        normalize_embedding=steps is not None and normalizer is not None,
    )
    squash = None
    if settings.squashed:
        squash = TanhSquash(settings.clip_mean) if settings.limits_mean else TanhSquash()
    return Policy(
        task=TaskInfo(
            spec.name, spec.observation_size, tuple(spec.action_low.tolist()), tuple(spec.action_high.tolist())
        ),
        weights=weights,
        activation=settings.activation,
        normalizer=normalizer or Normalizer.identity(spec.observation_size),
        protocol=protocol,
        clock=None if steps is None else Countdown(float(steps)),
        squash=squash,
    )


def _check_sizes(model: Sb3Model, spec: TaskSpec, steps: int | None, what: str) -> None:
    inputs, outputs = len(model.layers[0][0]), len(model.layers[-1][1])
    expected = spec.observation_size + (steps is not None)
    if inputs != expected:
        wrapped = inputs == expected + 1 and steps is None
        hint = " (was it trained with TimeFeatureWrapper? add --time-feature linear)" if wrapped else ""
        raise PolicyError(
            f"{what}: its network takes {inputs} numbers, but {spec.name} gives {expected}"
            f"{' with the time feature' if steps is not None else ''}{hint}; with other wrappers: {USE_A_FUNCTION}"
        )
    if outputs != spec.action_size:
        raise PolicyError(f"{what}: its network gives {outputs} numbers, but {spec.name} takes {spec.action_size}")
    if model.settings.action_bounds is None:
        return
    for name, written, needed in zip(
        ("lower", "upper"), model.settings.action_bounds, (spec.action_low, spec.action_high), strict=True
    ):
        if not np.allclose(written, needed, rtol=1e-5, atol=1e-6):
            raise PolicyError(
                f"{what}: its actions have the {name} bounds {written.tolist()}, those of {spec.name} "
                f"{np.asarray(needed).tolist()}; with a wrapper that rescales actions: {USE_A_FUNCTION}"
            )


def _warn_of_normalizer(model: Sb3Model, given: str | Path | None, file: Path | None, what: str) -> None:
    """Warn where a normalizer may be missing, or does not belong to the model."""
    settings, text = model.settings, ""
    if given is None and not settings.shows_vecnormalize:
        text = (
            f"{what} does not say whether it was trained behind VecNormalize. If so, its actions are wrong without "
            f"the file that save() wrote (--normalizer); if not, give --normalizer {NO_NORMALIZER}"
        )
    elif file is not None and settings.shows_vecnormalize and not settings.behind_vecnormalize:
        text = f"{what} was not trained behind VecNormalize, as far as it shows, but is given the statistics in {file}"
    if text:
        warnings.warn(PolicyWarning(text), stacklevel=3)


def _time_feature_steps(written: str | None) -> int | None:
    """Return the steps of "linear:1000"; None where none are named."""
    if written is None:
        return None
    name, colon, number = written.partition(":")
    steps = int(number) if number.isascii() and number.isdigit() and len(number) < 10 else 0
    if name != "linear" or (colon and steps < 1):
        raise PolicyError(f"time_feature must be linear or linear:STEPS, for example linear:1000, got {written!r}")
    return steps or None


def _check_time_feature(steps: int, limit: int, task: str) -> None:
    """Warn where a time feature counts down from another number of steps than an episode has."""
    if steps != limit:
        warnings.warn(
            PolicyWarning(
                f"the time feature counts down from {steps} steps, but episodes of {task} end after {limit}; "
                "TimeFeatureWrapper takes the environment's own limit if there is one"
            ),
            stacklevel=3,
        )


def _provenance(
    model: Sb3Model, path: Path, normalizer: Path | None, env: str, time_feature: str | None
) -> dict[str, Any]:
    settings = model.settings
    name = "".join(letter for letter in path.stem if letter.isprintable())
    provenance: dict[str, Any] = {
        # Models of one name are taken for training runs of one method, distinguished by their seeds.
        "method": f"SB3 {settings.algorithm} ({name})",
        **({} if settings.seed is None else {"seed": settings.seed}),
        "steps": settings.steps,
        "source": {"file": path.name, "sha256": file_digest(path), "stable-baselines3": model.version, "env": env},
        "versions": library_versions(),
    }
    if normalizer is not None:
        provenance["source"] |= {"normalizer": normalizer.name, "normalizer sha256": file_digest(normalizer)}
    if time_feature is not None:
        provenance["source"]["time feature"] = time_feature
    return provenance
