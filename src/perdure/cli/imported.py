"""Find the policies of a command line: files, shipped policies, models of Stable-Baselines3."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from perdure.cli.errors import CommandError

IMPORTED = "imported"
"""Folder, beside the results, of policies made of other libraries' models."""


@dataclass(frozen=True)
class Sb3Options:
    """Options of a Stable-Baselines3 model that its file does not contain."""

    env: str | None = None
    normalizer: str | None = None
    time_feature: str | None = None
    training_horizon: int | None = None
    trust: bool = False

    @property
    def given(self) -> list[str]:
        """The flags that were given."""
        values = {
            "--env": self.env,
            "--normalizer": self.normalizer,
            "--time-feature": self.time_feature,
            "--training-horizon": self.training_horizon,
            "--trust": self.trust or None,
        }
        return [flag for flag, value in values.items() if value is not None]

    @property
    def modules(self) -> tuple[str, ...]:
        """Modules that the user allows to import by naming them in --env."""
        from perdure.envs import module_of, task_of_environment

        module = None if self.env is None else module_of(task_of_environment(self.env))
        return () if module is None else (module,)


def policy_files(names: Sequence[str], options: Sb3Options, folder: Path) -> tuple[Path, ...]:
    """Return one policy file for each name; models of Stable-Baselines3 are imported into `folder`, once.

    Raises:
        CommandError: If a model comes without --env, or the flags for models with none.
        PolicyError: If there is no such policy, or a model cannot be imported.
    """
    from perdure.policy.readers import is_sb3_zip
    from perdure.policy.shipped import find_policy

    paths = [find_policy(name) for name in names]
    if options.given and not any(is_sb3_zip(path) for path in paths):
        raise CommandError(
            f"{', '.join(options.given)}: only for Stable-Baselines3 models; {names[0]} names its own environment"
        )
    return tuple(_imported(path, options, folder) if is_sb3_zip(path) else path for path in paths)


def _imported(path: Path, options: Sb3Options, folder: Path) -> Path:
    from perdure.policy.readers import import_once

    print(f"perdure: reading {path}", file=sys.stderr)
    return import_once(
        path,
        folder,
        environment(path, options.env),
        normalizer=options.normalizer,
        time_feature=options.time_feature,
        training_horizon=options.training_horizon,
        trust=options.trust,
    )


def environment(path: Path, env: str | None) -> str:
    """Return the environment of a model.

    Raises:
        CommandError: If it is not given.
    """
    if env is None:
        raise CommandError(
            f"{path} does not say in which environment it acts: give it with --env, as in --env Hopper-v5"
        )
    return env
