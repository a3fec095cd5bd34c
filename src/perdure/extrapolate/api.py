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


def extrapolate(evaluation: Any, *arguments: Any, **options: Any) -> ExtrapolationResult:  # noqa: D417
    """Evaluate policies far beyond their training horizon.

    An `Extrapolation` names policy files. They run over the cores, leave their results in ``out`` and resume after an
    interruption: `perdure.extrapolate.run.extrapolate` explains the arguments.

    Any other policy runs in this process, on one core, with the arguments below. Nothing is kept for a resumption,
    because a function has no identity that a later process could check. Table, verdict and report are the same.

    Args:
        evaluation: A function of observations (its calls: `perdure.policy.FunctionPolicy`), a `Policy`, its file, or an
            ONNX model, which needs an env.
        env: A name, such as "Hopper-v5" (Gymnasium's) or "envpool:Hopper-v5"; a factory; or a VectorEnv. Step limits of
            its own are lifted: see `perdure.envs.open_env`. None: the task of a `Policy`.
        steps: How long each episode is asked to last.
        clocks: As in `Extrapolation`. For a function: None calls it without time; otherwise it gets the keywords
            ``elapsed`` and ``horizon``.
        eval_seeds: Start states.
        first_eval_seed: The first of them.
        training_horizon: Steps of a training episode, within which the reference is measured. None: the step limit of
            the environment, 1,000 where it has none. Not for a `Policy`, which knows its own, as does an ONNX model
            that perdure exported.
        recurrent: The function has a memory.
        name: Of the policy, in the table; by default the function's name.
        out: Folder for lanes.parquet and report.html; None writes nothing.
        command: Stored with the table.
        progress: Called with (steps made, running episodes), for each group of episodes.

    Returns:
        The table of all lanes; as text, the verdicts.

    Raises:
        ExtrapolationError: If there is nothing to evaluate, a number makes no sense, or an argument does not fit this
            kind of policy.
        PolicyError: If a policy does not fit its environment, or returns what is no action.
        WorldError: If an environment cannot be built or breaks its contract.
    """
    if isinstance(evaluation, Extrapolation):
        return run_extrapolation(evaluation, *arguments, **options)
    return extrapolate_policy(evaluation, *arguments, **options)
