"""``perdure extrapolate``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from perdure.cli.flags import Cores, On
from perdure.cli.imported import IMPORTED, Sb3Options, policy_files
from perdure.cli.parse import flag_name, parse
from perdure.cli.report import write_and_show
from perdure.cli.terminal import command_line

if TYPE_CHECKING:
    from perdure.runs import Observer


@dataclass(frozen=True)
class ExtrapolateFlags:
    """Run policies far beyond their training horizon, under several clocks, and judge them.

    A lane is one deployed episode: a policy under a clock from a start state. Writes lanes.parquet, report.html and
    figures. An interrupted command resumes when you run it again.
    """

    policies: tyro.conf.Positional[tuple[str, ...]]
    """Policy files, names of shipped policies (`perdure list policies`), or models of Stable-Baselines3
    (model.zip, with --env); all for one task. Or one ONNX model (model.onnx, with --env)."""
    env: str | None = None
    """For models of Stable-Baselines3: the environment they were trained in. Hopper-v5 is Gymnasium's if Gymnasium can
    make it; envpool:Hopper-v5 is EnvPool's, which is faster."""
    normalizer: str | None = None
    """For these models: the file that VecNormalize.save() wrote; "none" if only rewards were normalized."""
    time_feature: str | None = None
    """For these models: linear:1000 if trained in sb3-contrib's TimeFeatureWrapper with 1000 steps; linear takes the
    training horizon."""
    training_horizon: int | None = None
    """For these models and ONNX models: steps of a training episode; if left out, what an exported ONNX model says, or
    the environment's own step limit."""
    trust: bool = False
    """For these models: load with Stable-Baselines3 itself, which runs code in the files. Only for files you trust."""
    steps: int = 100_000
    """Steps of each lane, unless it ends earlier."""
    clocks: tuple[str, ...] = ("default",)
    """Clocks of policies with a time-to-go input: constant:500, periodic:500, countdown:1000, countdown (to the end),
    default (each policy's own clock), sweep (constant 0 to 1000 and periodic 100 to 1000 in steps of 100, and
    countdown)."""
    eval_seeds: int = 20
    """Start states; the same ones for every policy and clock."""
    first_eval_seed: int = 0
    """First start state: choose a policy or a clock on some start states, and report on others."""
    out: Path = Path("extrapolation")
    """Folder for the table and the report. Finished parts of an interrupted evaluation are kept there."""
    cores: Cores = None
    on: On = "local"
    max_lanes: int = 48
    """Most lanes in one process at a time. Results do not depend on it; a crash costs at most these lanes."""
    modules: tuple[str, ...] = ()
    """Python modules that the policies' tasks may import; a policy file alone never imports anything."""


def main(args: list[str]) -> None:
    """``perdure extrapolate``."""
    flags = parse(ExtrapolateFlags, args, "extrapolate")
    command = command_line("perdure", "extrapolate", *args)
    from perdure.policy.onnx import is_onnx

    if any(map(is_onnx, flags.policies)):
        _check_one_model(flags, {flag_name(arg) for arg in args})
        _one_model(flags, command)
        return
    from perdure.extrapolate import Extrapolation
    from perdure.extrapolate import extrapolate as evaluate
    from perdure.runs.progress import show_progress

    options = Sb3Options(flags.env, flags.normalizer, flags.time_feature, flags.training_horizon, flags.trust)
    evaluation = Extrapolation(
        policy_files(flags.policies, options, flags.out / IMPORTED),
        flags.steps,
        flags.clocks,
        flags.eval_seeds,
        first_eval_seed=flags.first_eval_seed,
        max_lanes=flags.max_lanes,
        modules=(*flags.modules, *options.modules),
    )
    if "--clocks" in {flag_name(arg) for arg in args} and not any(map(_takes_clock, evaluation.policies)):
        print("perdure: no policy here has a time-to-go input, so --clocks has no effect", file=sys.stderr)
    with show_progress("extrapolate", "steps") as observe:
        table = evaluate(
            evaluation,
            flags.out,
            cores=flags.cores,
            on=flags.on,
            command=command,
            observe=observe,
            waiting=lambda: print(f"perdure: waiting for another evaluation into {flags.out}", file=sys.stderr),
        ).path  # the table itself is not kept: the report needs the memory
    assert table is not None
    write_and_show(table, flags.out)


def _takes_clock(path: Path) -> bool:
    from perdure.policy import load_policy

    return load_policy(path).protocol.embedding is not None


_SB3_ONLY = "for models of Stable-Baselines3 (.zip) only"
_IN_PROCESS = "an ONNX model is evaluated in this process, on one core"
_NOT_FOR_ONNX = {
    "normalizer": _SB3_ONLY,
    "time_feature": _SB3_ONLY,
    "trust": _SB3_ONLY,
    "cores": _IN_PROCESS,
    "on": _IN_PROCESS,
    "max_lanes": _IN_PROCESS,
    "modules": "an ONNX model imports nothing but the module that --env names",
}
"""Field to the reason why it has no meaning for an ONNX model."""


def _check_one_model(flags: ExtrapolateFlags, given: set[str]) -> None:
    """Refuse flags that an ONNX model does not take."""
    from perdure.cli.errors import CommandError

    if len(flags.policies) > 1 or flags.env is None:
        raise CommandError("an ONNX model is evaluated alone, and needs its environment: --env Hopper-v5")
    for name, reason in _NOT_FOR_ONNX.items():
        flag, value = f"--{name.replace('_', '-')}", getattr(flags, name)
        if flag in given and (name, value) not in (("on", "here"), ("cores", 1)):
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            raise CommandError(f"{' '.join(map(str, (flag, *values)))}: {reason}")
    if "default" in flags.clocks and "--clocks" in given:
        raise CommandError("--clocks default: an ONNX model stores no clock")


def _one_model(flags: ExtrapolateFlags, command: str) -> None:
    """Evaluate an ONNX model, in this process."""
    from perdure.extrapolate import Extrapolation, extrapolate
    from perdure.runs.progress import show_progress

    clocks = None if flags.clocks == ("default",) else flags.clocks
    planned = Extrapolation((Path(flags.policies[0]),), flags.steps, flags.clocks, flags.eval_seeds)
    lanes = flags.eval_seeds * (1 if clocks is None else len(planned.deployment_clocks(None)))
    with show_progress("extrapolate", "steps") as observe:
        result = extrapolate(
            flags.policies[0],
            flags.env,
            steps=flags.steps,
            clocks=clocks,
            eval_seeds=flags.eval_seeds,
            first_eval_seed=flags.first_eval_seed,
            training_horizon=flags.training_horizon,
            out=flags.out,
            command=command,
            progress=_on_steps(observe, lanes * flags.steps),
        )
    print(result)
    print(f"\nReport: {(flags.out / 'report.html').resolve()}")


def _on_steps(observe: Observer, total: int) -> Callable[[int, int], None]:
    """Return a progress callback that adds up the steps of all lanes, whose groups run one after the other."""
    from perdure.runs import UnitProgress

    made = last = 0

    def progress(step: int, running: int) -> None:
        nonlocal made, last
        made += (step - last if step > last else step) * running
        last = step
        observe({"lanes": UnitProgress("running", made, total)})

    return progress
