"""``perdure train``."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from perdure.cli.parse import parse
from perdure.ppo import PPOConfig, method_config


@dataclass(frozen=True)
class Train:
    """Train seeds of one task with one method. Interrupt it any time; the same command goes on."""

    task: tyro.conf.Positional[str]
    """A task as `perdure list tasks` names it, such as Hopper-v3 or gymnasium:Hopper-v5. Comes first."""
    method: str = "geometric"
    """A method as `perdure list methods` names it."""
    preset: str = "zoo"
    """Whose hyperparameters: zoo (RL Baselines3 Zoo, tuned for each task; used by the thesis) or cleanrl (one set)."""
    name: str | None = None
    """A name of your own for settings of your own: OUT/TASK/NAME instead of OUT/TASK/METHOD."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds, trained side by side; each comes out as if it were trained alone."""
    out: Path = Path("runs")
    """Where runs are kept, as OUT/TASK/METHOD/seed-N/policy.safetensors."""
    threads: int | None = None
    """Cores to use; all by default. Results do not depend on it."""
    tensorboard: bool = False
    """Also write curves for TensorBoard to OUT/tensorboard."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """The learner's settings; the defaults are those of task and method."""


def main(args: list[str]) -> None:
    """``perdure train``: two looks at the flags, because task and method decide the defaults of the rest."""
    look = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    # A missing value is for the second look to complain about.
    look.add_argument("--method", nargs="?", default="geometric", const="geometric")
    args = _task_first(args)
    look.add_argument("--preset", nargs="?", default="zoo", const="zoo")
    if args and not args[0].startswith("-"):
        known = look.parse_known_args(args)[0]
        config = method_config(known.method, args[0], _observation_size(args[0]), known.preset)
        default = Train(args[0], known.method, known.preset, ppo=config)
        _train(parse(Train, args[1:], "train TASK", default))
    elif any(arg in ("-h", "--help") for arg in args):
        parse(Train, ["TASK", "--help"], "train TASK")
    else:
        print("perdure: train needs a task first, as in: perdure train Hopper-v3 --method geometric", file=sys.stderr)
        raise SystemExit(2)


def _task_first(args: list[str]) -> list[str]:
    """Return the arguments with the task in front, wherever it was written."""
    if not args or not args[0].startswith("-"):
        return args
    from perdure.envs import is_task

    at = next((k for k, arg in enumerate(args) if not arg.startswith("-") and is_task(arg)), None)
    return args if at is None else [args[at], *args[:at], *args[at + 1 :]]


def _train(flags: Train) -> None:
    from rich.console import Console

    from perdure.ppo.progress import progress_bar
    from perdure.ppo.runs import Report, TrainRun
    from perdure.ppo.runs import train as train_run
    from perdure.ppo.tensorboard import tensorboard

    run_ = TrainRun(flags.task, flags.name or flags.method, flags.ppo, flags.seeds, preset=flags.preset)
    console = Console(stderr=True)
    with ExitStack() as stack:
        watchers = [stack.enter_context(progress_bar(f"{run_.task} {run_.method}", console))]
        if flags.tensorboard:
            watchers.append(stack.enter_context(tensorboard(flags.out / "tensorboard" / run_.task / run_.method)))

        def watch(report: Report) -> None:
            for watcher in watchers:
                watcher(report)

        paths = train_run(run_, flags.out, flags.threads, watch, processes=len(flags.seeds))
    for path in paths:
        print(path)


def _observation_size(task: str) -> int:
    from perdure.envs import make_world

    world = make_world(task, [0])
    size = world.spec.observation_size
    world.close()
    return size
