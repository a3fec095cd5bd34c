"""The command ``cure``: further training that makes a policy hold, with the verdicts before and after."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import tyro

from perdure.cli.extrapolate import NOT_HOLDING
from perdure.cli.parse import Cores, Normalizer, On, TrainingHorizon, Trust, call, whole_command
from perdure.cli.subjects import tell
from perdure.evaluate.cure import Cure, CureResult
from perdure.evaluate.cure import cure as cure_policy
from perdure.evaluate.table import TABLE_FILE
from perdure.report import wording
from perdure.report.comparison_page import document_text
from perdure.report.cure_page import document, export_command
from perdure.runs.progress import show_progress


def main(name: str, args: list[str]) -> None:
    """Run the command."""
    cure(call(Flags, args, name), whole_command(args, name))


@dataclass(frozen=True, kw_only=True)
class Flags(Cure):
    """Train a policy further so that it holds: its verdict, the training, the verdict again, and whether that helped.

    The training is a few minutes of PPO with a longer horizon (gamma 0.999) under noise. Both policies are judged, calm
    and under standard-1, from the same start states. Writes cured.safetensors, cure.html and episodes.parquet. An
    interrupted command continues when you run it again.
    """

    policy: Annotated[Path, tyro.conf.Positional]
    """A policy file, the name of a shipped policy (`perdure list policies`), model.zip of Stable-Baselines3 (PPO, A2C,
    TRPO), a run of RL Baselines3 Zoo (logs/ppo/Hopper-v4_1), or an ONNX model that is a plain network."""
    training_horizon: TrainingHorizon = None
    normalizer: Normalizer = None
    trust: Trust = False
    out: Path = Path("cure")
    """Folder for the results. Finished parts of an interrupted cure are kept there."""
    cores: Cores = None
    on: On = "local"
    json: bool = False
    """Print the answer as one JSON document, and nothing else on standard output."""


def cure(flags: Flags, command: str) -> None:
    """Cure a policy, and show the answer.

    Args:
        flags: Of the command.
        command: The command line, stored with the results.

    Raises:
        SystemExit: With `NOT_HOLDING` if something is required and not shown.
    """
    asked = Cure(**{each.name: getattr(flags, each.name) for each in fields(Cure)})
    with redirect_stdout(sys.stderr if flags.json else sys.stdout):  # environments may print
        result = cure_policy(
            flags.policy,
            options=asked,
            out=flags.out,
            cores=flags.cores,
            on=flags.on,
            progress=show_progress,
            command=command,
            tell=tell,
            normalizer=flags.normalizer,
            trust=flags.trust,
            training_horizon=flags.training_horizon,
        )
    if flags.json:
        paths = {"table": flags.out / TABLE_FILE, "page": result.page, "policy": result.policy}
        named = {name: path for name, path in paths.items() if path is not None}
        print(document_text(document(result.cured), **named))
    else:
        print(f"{result}\n{_last_lines(result)}")
    if not result.met:
        print(f"perdure: --require {flags.require} is not met", file=sys.stderr)
        raise SystemExit(NOT_HOLDING)


def _last_lines(result: CureResult) -> str:
    """Return the time, where the cured policy is, how to export it, and the page."""
    took = wording.duration(result.seconds / 3600.0)
    training = wording.duration(result.training_seconds / 3600.0)
    lines = [f"  time     {took}, of which {training} of training"]
    if result.policy is not None:
        export = export_command(result.cured, str(result.policy))
        lines += [f"  policy   {result.policy}", f"  export   {export}"]
    if result.page is not None:
        lines.append(f"\nReport: {result.page.resolve()}")
    return "\n".join(lines)
