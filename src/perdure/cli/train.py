"""``perdure train``."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from perdure.cli.flags import Cores, On
from perdure.cli.parse import parse
from perdure.ppo import PPOConfig, method_config
from perdure.runs import Status


@dataclass(frozen=True)
class TrainFlags:
    """Train seeds of one task with one method. An interrupted command resumes when you run it again."""

    task: tyro.conf.Positional[str]
    """A task as `perdure list tasks` names it, such as Hopper-v3 or gymnasium:Hopper-v5. Comes first."""
    method: str = "geometric"
    """A method as `perdure list methods` names it."""
    preset: str = "zoo"
    """Hyperparameters: zoo (RL Baselines3 Zoo's, tuned for each task, as in the thesis) or cleanrl (one set). For
    Hopper and Walker2d take cleanrl: with zoo most Hopper policies stand still."""
    name: str | None = None
    """Name for changed settings: the run is kept in OUT/TASK/NAME instead of OUT/TASK/METHOD."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds, such as 0 1 2, trained side by side; each gives the same result as if trained alone."""
    out: Path = Path("runs")
    """Folder of the runs; a policy is OUT/TASK/METHOD/seed-N/policy.safetensors."""
    cores: Cores = None
    on: On = "local"
    tensorboard: bool = False
    """Also write curves for TensorBoard to OUT/tensorboard."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    """The learner's settings; the defaults are those of task and method."""


def main(args: list[str]) -> None:
    """``perdure train``: parses flags twice, because task and method set the defaults of the others."""
    look = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    # The second parser reports a missing value.
    look.add_argument("--method", nargs="?", default="geometric", const="geometric")
    args = _task_first(args)
    look.add_argument("--preset", nargs="?", default="zoo", const="zoo")
    if args and not args[0].startswith("-"):
        known = look.parse_known_args(args)[0]
        config = method_config(known.method, args[0], _observation_size(args[0]), known.preset)
        default = TrainFlags(args[0], known.method, known.preset, ppo=config)
        _train(parse(TrainFlags, args[1:], "train TASK", default))
    elif any(arg in ("-h", "--help") for arg in args):
        parse(TrainFlags, ["TASK", "--help"], "train TASK")
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


def _train(flags: TrainFlags) -> None:
    from perdure.ppo.tensorboard import tensorboard
    from perdure.ppo.training import TrainRun, on_report
    from perdure.ppo.training import train as train_run
    from perdure.runs.progress import show_progress

    name = flags.name or flags.method
    run_ = TrainRun(flags.task, name, flags.ppo, flags.seeds, preset=flags.preset, base_method=flags.method)
    with ExitStack() as stack:
        observers = [stack.enter_context(show_progress(f"{run_.task} {run_.method}", "steps"))]
        if flags.tensorboard:
            folder = flags.out / "tensorboard" / Path(run_.key(0)).parent
            observers.append(on_report(run_, stack.enter_context(tensorboard(folder))))

        def observe(status: Status) -> None:
            for observer in observers:
                observer(status)

        paths = train_run(run_, flags.out, cores=flags.cores, on=flags.on, observe=observe)
    for path in paths:
        print(path)


def _observation_size(task: str) -> int:
    from perdure.envs import make_world

    world = make_world(task, [0])
    size = world.spec.observation_size
    world.close()
    return size
