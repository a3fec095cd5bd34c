"""What the first words of `extrapolate` name: policy files, models and folders of Stable-Baselines3, or a function."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.errors import PerdureError

if TYPE_CHECKING:
    from perdure.policy.readers import FoundModel


def policy_files(
    names: Sequence[str], env: str | None, sb3: dict[str, Any], horizon: int | None, out: Path, modules: Sequence[str]
) -> tuple[Path, ...]:
    """Return one file for each policy; models of Stable-Baselines3 are imported once, into a folder of `out`."""
    from perdure.policy import find_policy, load_policy
    from perdure.policy.onnx import is_onnx
    from perdure.policy.readers import FoundModel, find_models, import_once
    from perdure.report.schema import IMPORTED

    found = list[Path | FoundModel]()
    for name in names:
        found += [Path(name)] if is_onnx(name) else find_models(Path(name), _tell) or [find_policy(name)]
    options = sb3 if any(map(is_onnx, names)) else {"env": env, "training_horizon": horizon, **sb3}
    given = {name: value for name, value in options.items() if value not in (None, False)}
    models = [each for each in found if isinstance(each, FoundModel)]
    if sb3["normalizer"] and len(models) > 1:
        raise PerdureError(
            f"--normalizer {sb3['normalizer']}: it belongs to one model, and {len(models)} are given: evaluate one at "
            "a time, or import each first (perdure import)"
        )
    if given and names and not models:
        for name in (each for each in names if not is_onnx(each)):
            load_policy(name)  # raises what it is, if it is of another library
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise PerdureError(f"{flags}: only for Stable-Baselines3 models; {names[0]} is none")
    files = list[Path]()
    for each in found:
        if isinstance(each, FoundModel):
            own = {"env": _env(each, modules) if env is None else env}
            own |= {name: getattr(each, name) for name in ("normalizer", "time_feature") if sb3[name] is None}
            words = [f"{name.replace('_', ' ')} {own[name]}" for name in own if own[name] not in (None, env)]
            _tell(f"reading {each.path}" + (f" with {', '.join(words)}" if words else ""))
            each = import_once(each.path, out / IMPORTED, **{"training_horizon": horizon, **sb3, **own})
        files.append(each)
    return tuple(files)


def _tell(sentence: str) -> None:
    print(f"perdure: {sentence}", file=sys.stderr)


def _env(model: FoundModel, modules: Sequence[str]) -> str:
    """Return the environment that the files of a model name, if it can be made as in training."""
    from perdure.envs import refuse_import, task_of_environment

    if model.env is None:
        raise PerdureError(f"{model.path} does not say in which environment it acts: give it with --env Hopper-v5")
    if model.unread:
        raise PerdureError(f"{model.path} was trained with {model.unread}: name an environment that has it with --env")
    try:
        refuse_import(task_of_environment(model.env), modules, str(model.path))
    except PerdureError as error:
        raise PerdureError(f"{model.path} was trained in {model.env}; --env names another one: {error}") from None
    return model.env


def is_function(name: str) -> bool:
    """Return whether a word names a Python function, such as "my_policies:walk", and no file."""
    return re.fullmatch(r"[^\W\d][\w.]*:[^\W\d][\w.]*", name) is not None and not Path(name).exists()


def load_function(name: str) -> Any:
    """Return the function that "module:function" names, imported from the working directory or sys.path."""
    module, _, function = name.partition(":")
    sys.path.insert(0, str(Path.cwd()))
    try:
        return attrgetter(function)(import_module(module))
    except Exception as error:  # whatever the module raises
        raise PerdureError(f"{name} cannot be imported: {type(error).__name__}: {error}") from error
