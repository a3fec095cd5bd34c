"""The policy file of a finished training run: final weights, and what says where they come from."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.envs import TaskSpec
from perdure.horizon import Embedding
from perdure.learn.algorithm import all_methods, usual_config
from perdure.learn.checkpoint import RunState
from perdure.learn.presets import ZOO
from perdure.learn.start import trained_steps
from perdure.policy import Policy, load_policy, measure_reference
from perdure.policy.files import policy_name
from perdure.runs import file_digest, versions

if TYPE_CHECKING:
    from perdure.learn.run import Segments, TrainRun

UNNAMED_PRESETS = (ZOO, None)
"""Presets that folders and policy files do not name."""


def export_policy(
    run: TrainRun, segments: Segments, state: RunState, start: str | None = None, number: int = 0
) -> Policy:
    """Return the policy of the final weights, with its provenance, measured within its training horizon.

    Args:
        run: The training run.
        segments: Its task and algorithm.
        state: After its last segment.
        start: File of the policy that it continued.
        number: Of the stage whose policy this is, from 0.
    """
    stage = run.stages[number]
    method = run.method
    if number < len(run.stages) - 1:
        method += f", stage {number + 1}"
    provenance: dict[str, Any] = {
        "method": method,
        "seed": state.seed,
        "config": stage.config.to_json(),
        "engine": segments.engine,
        "versions": versions("jax", "numpy", "mujoco"),
        "command": command(run, segments.spec, state.seed),
    }
    if run.preset not in UNNAMED_PRESETS:
        provenance["preset"] = run.preset
    if stage.disturb:
        provenance["disturb"] = list(stage.disturb)
    if number:
        provenance["stages"] = [each.to_json() for each in run.stages[:number]]
    if start is not None:
        provenance["from"] = _continued(start)
    policy = dataclasses.replace(segments.algorithm.policy(state.learner), provenance=provenance)
    return dataclasses.replace(policy, reference=measure_reference(policy))


def _continued(start: str) -> dict[str, Any]:
    """Return what a policy file says of the policy that it continues: its digest, and the steps it was trained for."""
    return {"sha256": file_digest(Path(start)), "steps": trained_steps(load_policy(start))}


def command(run: TrainRun, spec: TaskSpec, seed: int) -> str:
    """Return the command that reproduces this policy; "" where no flags say its settings."""
    if run.command is not None:
        return run.command.replace("{seed}", str(seed))
    base = run.base_method or run.method
    if base not in all_methods():
        return ""
    words = ["perdure", "train", run.task, "--method", base]
    preset = None
    if run.method != base:
        words += ["--name", run.method]
    if run.config.presets:
        preset = run.preset
        words += ["--preset", str(preset)]
    words += ["--seeds", str(seed)]
    if run.disturb:
        words += ["--disturb", *run.disturb]
    if run.start is not None:
        words += ["--from", policy_name(run.start)]
    usual = usual_config(base, run.task, spec.observation_size, preset, spec.default_horizon)
    try:
        words += _overrides(run.config, usual, f"--{run.config.name}")
    except LookupError:
        return ""
    return shlex.join(words)


def _overrides(config: Any, default: Any, flag: str) -> list[str]:
    words: list[str] = []
    for each in dataclasses.fields(config):
        value = getattr(config, each.name)
        usual = getattr(default, each.name)
        name = f"{flag}.{each.name.replace('_', '-')}"
        if value == usual:
            continue
        if isinstance(usual, Embedding):  # its flag accepts the method's embedding only
            raise LookupError(name)
        if dataclasses.is_dataclass(value) and type(value) is type(usual):
            words += _overrides(value, usual, name)
        elif dataclasses.is_dataclass(value):
            raise LookupError(name)
        elif isinstance(value, bool):
            words.append(name if value else f"{flag}.no-{each.name.replace('_', '-')}")
        elif isinstance(value, tuple):
            words += [name, *(str(item) for item in value)]
        else:
            words += [name, str(value)]
    return words
