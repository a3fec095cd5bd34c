"""Policies of any library as policy files: models are imported once, into a folder of the results."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from perdure.envs import refuse_import, task_of_environment
from perdure.errors import PerdureError
from perdure.policy.files import find_policy, load_policy
from perdure.policy.onnx import is_onnx
from perdure.policy.readers.sb3_import import FoundModel, find_models, import_once
from perdure.runs import write_atomic

Tell = Callable[[str], None]
"""Gets a sentence on what is read."""
MODELS = (".zip", ".onnx", ".pt")
"""Endings of the files of other libraries' models."""


def policy_file(
    name: str | Path, folder: Path, env: str | None, options: dict[str, Any], modules: Sequence[str], tell: Tell
) -> Path:
    """Return the file of one policy: what `find_policy` finds, or a model of another library, imported into a folder.

    Args:
        name: A policy as `find_policy` takes it, a model of Stable-Baselines3, a run of RL Baselines3 Zoo, a checkpoint
            of rsl_rl, or an ONNX model that is a plain network.
        folder: For imported models; made if it is missing.
        env: The environment of a model; None: what its own files say.
        options: Those of `import_once` that are given, without `env`.
        modules: Python modules that environments may be imported from.
        tell: Gets a sentence on what is read.

    Raises:
        PerdureError: There is no such policy, the name means several, it cannot be read, or its environment is unknown.
    """
    path = Path(name)
    if not path.exists() or path.suffix == ".safetensors":
        return find_policy(name)
    if is_onnx(path):
        found = [FoundModel(path)]
    else:
        found = find_models(path, tell)
    if len(found) > 1:
        names = ", ".join(each.path.name for each in found)
        raise PerdureError(f"{name} holds {len(found)} models, {names}: name one of them")
    if not found:
        return find_policy(name)
    return import_found(found[0], env, options, folder, modules, tell)


def policies_by_seed(
    name: str | Path, seeds: Sequence[int], folder: Path, env: str, options: dict[str, Any], tell: Tell
) -> Path:
    """Return what training may continue: a policy file, or a folder with one for each training seed.

    Args:
        name: As in `policy_file`; or a folder with a policy or a model for each seed: seed-3.zip, seed-3.onnx,
            seed-3.safetensors, or a folder seed-3 with one of them.
        seeds: Training seeds.
        folder: For imported models: a folder of models gets a folder there.
        env: The environment of models.
        options: As in `policy_file`.
        tell: As in `policy_file`.

    Raises:
        PerdureError: As `policy_file`; a seed has no policy or model.
    """
    path = Path(name)
    if not path.is_dir() or not any(re.fullmatch(r"seed-\d+", each.stem) for each in path.iterdir()):
        return policy_file(name, folder, env, options, (), tell)
    models = {}
    for seed in seeds:
        of_seed = _models_of_seed(path, seed)
        if of_seed:
            models[seed] = of_seed[0]
    if not models:  # policy files
        return path
    by_seed = folder / path.resolve().name
    for seed, model in models.items():
        imported = policy_file(model, folder, env, options, (), tell)
        by_seed.mkdir(parents=True, exist_ok=True)
        write_atomic(by_seed / f"seed-{seed}.safetensors", imported.read_bytes())
    return by_seed


def _models_of_seed(folder: Path, seed: int) -> list[Path]:
    """Return the models of another library that a folder has for a training seed."""
    beside = [folder / f"seed-{seed}{ending}" for ending in MODELS]
    inside = sorted(each for each in folder.glob(f"seed-{seed}/*") if each.suffix in MODELS)
    return [each for each in (*beside, *inside) if each.is_file()]


def import_found(
    model: FoundModel, env: str | None, options: dict[str, Any], folder: Path, modules: Sequence[str], tell: Tell
) -> Path:
    """Return the file of an imported model; what the options leave out is read from the files beside it.

    Arguments are those of `policy_file`.
    """
    own: dict[str, Any] = {"env": _env(model, modules) if env is None else env}
    for name in ("normalizer", "time_feature"):
        if options.get(name) is None:
            own[name] = getattr(model, name)
    words = [f"{name.replace('_', ' ')} {value}" for name, value in own.items() if value not in (None, env)]
    sentence = f"reading {model.path}"
    if words:
        sentence += f" with {', '.join(words)}"
    tell(sentence)
    file = import_once(model.path, folder, **{**options, **own})
    engine = load_policy(file).provenance.get("engine")
    if engine:
        tell(f"{model.path} was trained on {engine}; the report says on which one it is judged")
    return file


def _env(model: FoundModel, modules: Sequence[str]) -> str:
    """Return the environment that the files of a model name, if it can be made as in training."""
    if model.env is None:
        raise PerdureError(f"{model.path} does not say in which environment it acts: give it with --env Hopper-v5")
    if model.unread:
        raise PerdureError(f"{model.path} was trained with {model.unread}: name an environment that has it with --env")
    try:
        refuse_import(task_of_environment(model.env), modules, str(model.path))
    except PerdureError as error:
        raise PerdureError(f"{model.path} was trained in {model.env}; --env names another one: {error}") from None
    return model.env
