"""What the first words of `extrapolate` name: policy files, models and folders of Stable-Baselines3, or a function."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
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
    """Return one file for each policy; see `_sides`. A folder of several policy files is refused."""
    sides = _sides([_found(name) for name in names], names, env, sb3, horizon, out, modules)
    return tuple(file for side in sides for file in side)


def policy_sides(
    names: Sequence[str], env: str | None, sb3: dict[str, Any], horizon: int | None, out: Path, modules: Sequence[str]
) -> list[tuple[Path, ...]]:
    """Return the files that each word names: several for a folder of training runs; see `_sides`."""
    return _sides([_found_all(name) for name in names], names, env, sb3, horizon, out, modules)


def _sides(
    found: Sequence[Sequence[Path | FoundModel]],
    names: Sequence[str],
    env: str | None,
    sb3: dict[str, Any],
    horizon: int | None,
    out: Path,
    modules: Sequence[str],
) -> list[tuple[Path, ...]]:
    """Return the files of what was found; models of Stable-Baselines3 are imported once, into a folder of `out`.

    Args:
        found: What each word names.
        names: The words, as on the command line.
        env: Environment of models; None: what their own files say.
        sb3: Flags of models of Stable-Baselines3: normalizer, time_feature, trust.
        horizon: Training horizon of models.
        out: Folder of the results.
        modules: Python modules that environments may be imported from.
    """
    from perdure.policy.onnx import is_onnx
    from perdure.policy.readers.found import import_found
    from perdure.report.schema import IMPORTED

    models = [each for side in found for each in side if not isinstance(each, Path)]
    if len(models) > 1:
        _refuse_shared(sb3["normalizer"], len(models))
    options = dict(sb3)
    if not any(map(is_onnx, names)):  # which take these two flags themselves
        options |= {"env": env, "training_horizon": horizon}
    given = [name for name, value in options.items() if value not in (None, False)]
    if given and names and not models:
        _refuse_flags(given, names)
    sides = []
    for side in found:
        files = list[Path]()
        for each in side:
            if isinstance(each, Path):
                files.append(each)
            else:
                found_flags = {"training_horizon": horizon, **sb3}
                files.append(import_found(each, env, found_flags, out / IMPORTED, modules, tell))
        sides.append(tuple(files))
    return sides


def _found_all(name: str) -> Sequence[Path | FoundModel]:
    """Return what `_found` does, and every policy file of a folder."""
    from perdure.policy import find_policies

    if Path(name).is_dir() and (any(Path(name).glob("*.safetensors")) or any(Path(name).glob("*/*.safetensors"))):
        return find_policies(name)
    return _found(name)


def _found(name: str) -> Sequence[Path | FoundModel]:
    """Return the policy file, the ONNX model or the models of Stable-Baselines3 that a word names."""
    from perdure.policy import find_policy
    from perdure.policy.onnx import is_onnx

    path = Path(name)
    if is_onnx(name):
        return [path]
    if path.exists() and path.suffix != ".safetensors":  # the name of a shipped policy needs no reader
        from perdure.policy.readers import find_models

        models = find_models(path, tell)
        if models:
            return models
    return [find_policy(name)]


def _refuse_shared(normalizer: str | None, count: int) -> None:
    """Refuse the file of a normalizer for several models; "none" is true of all of them."""
    from perdure.policy.readers.sb3_import import NO_NORMALIZER

    if normalizer not in (None, NO_NORMALIZER):
        raise PerdureError(
            f"--normalizer {normalizer}: it belongs to one model, and {count} are given: evaluate one at a time, or "
            "import each first (perdure import)"
        )


def _refuse_flags(flags: Sequence[str], names: Sequence[str]) -> None:
    """Refuse flags of models where no word names one."""
    from perdure.policy import load_policy
    from perdure.policy.onnx import is_onnx

    for name in names:
        if not is_onnx(name):
            load_policy(name)  # raises what it is, if it is of another library
    shown = ", ".join(f"--{each.replace('_', '-')}" for each in flags)
    raise PerdureError(f"{shown}: only for Stable-Baselines3 models; {names[0]} is none")


def tell(sentence: str) -> None:
    """Print a sentence on standard error."""
    print(f"perdure: {sentence}", file=sys.stderr)


def named_files(command: str) -> dict[str, str]:
    """Return the policy files that are here and that a stored command names: their SHA-256 to the name."""
    from perdure.policy import find_policy
    from perdure.policy.onnx import model_digest

    try:
        words = shlex.split(command)
    except ValueError:  # a table's text may be anything
        return {}
    found: dict[str, str] = {}
    for word in words:
        with suppress(PerdureError, OSError):
            file = find_policy(word)
            if file.is_file() and file.suffix in (".safetensors", ".onnx"):
                found[model_digest(file)] = word
    return found


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
