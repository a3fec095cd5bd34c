"""`extrapolate`: evaluate policy files, a policy object or a function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, overload

from perdure.extrapolate.evaluate import ProgressCallback
from perdure.extrapolate.in_process import extrapolate_policy
from perdure.extrapolate.lanes import Extrapolation
from perdure.extrapolate.result import ExtrapolationResult
from perdure.extrapolate.run import extrapolate as run_extrapolation
from perdure.policy import Policy
from perdure.runs import Observer


@overload
def extrapolate(
    evaluation: Extrapolation,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "local",
    command: str = "",
    observe: Observer = ...,
    waiting: Callable[[], None] = ...,
) -> ExtrapolationResult: ...


@overload
def extrapolate(
    evaluation: Callable[..., Any] | Policy | str | Path,
    env: Any = None,
    *,
    steps: int = 100_000,
    clocks: Sequence[str] | str | None = None,
    eval_seeds: int = 20,
    first_eval_seed: int = 0,
    training_horizon: int | None = None,
    recurrent: bool = False,
    name: str | None = None,
    out: str | Path | None = None,
    command: str = "",
    progress: ProgressCallback = ...,
) -> ExtrapolationResult: ...


def extrapolate(evaluation: Any, *arguments: Any, **options: Any) -> ExtrapolationResult:
    """Evaluate policies far beyond their training horizon.

    An `Extrapolation` names policy files. They run over the cores, leave their results in ``out`` and resume after an
    interruption: `perdure.extrapolate.run.extrapolate` explains the arguments.

    A function, a `Policy` or one policy file runs in this process, in any environment:
    `perdure.extrapolate.in_process.extrapolate_policy` explains the arguments.

    Returns:
        The table of all lanes; as text, the verdicts.

    Raises:
        ExtrapolationError: If there is nothing to evaluate, or a number makes no sense.
        PolicyError: If a policy does not fit its environment.
        WorldError: If an environment cannot be built or breaks its contract.
    """
    if isinstance(evaluation, Extrapolation):
        return run_extrapolation(evaluation, *arguments, **options)
    return extrapolate_policy(evaluation, *arguments, **options)
