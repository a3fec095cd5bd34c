"""``perdure export``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.clocks import read_clock
from perdure.cli.parse import parse


@dataclass(frozen=True)
class ExportFlags:
    """Export a policy as an ONNX model, checked with onnxruntime. Needs the extra perdure[onnx]."""

    policy: tyro.conf.Positional[str]
    """A policy file, or the name of a shipped policy."""
    out: tyro.conf.Positional[Path] = Path("policy.onnx")
    """The file to write."""
    clock: str | None = None
    """Clock that is fixed in the model, such as constant:500, or default (the policy's own clock). If left out, the
    model has the inputs elapsed and horizon."""


def main(args: list[str]) -> None:
    """``perdure export``."""
    flags = parse(ExportFlags, args, "export")
    from perdure.cli.errors import CommandError
    from perdure.policy import load_policy
    from perdure.policy.onnx import export_onnx, is_onnx

    if not is_onnx(flags.out):
        raise CommandError(f"out must be a file named .onnx, not {flags.out}")
    policy = load_policy(flags.policy)
    print(export_onnx(policy, flags.out, read_clock("--clock", flags.clock, policy)))
