"""The command ``train``: its flags depend on the task and the method that are trained."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from perdure.cli.parse import Cores, Normalizer, On, call
from perdure.cli.subjects import tell
from perdure.errors import PerdureError

if TYPE_CHECKING:
    from perdure.learn.algorithm import Configuration
    from perdure.learn.run import TrainRun


def main(name: str, args: list[str]) -> None:
    """Train: the task and the method, read first, set the defaults of the learner's settings."""
    args = _task_first(args)
    task = None if not args or args[0].startswith("-") else args[0]
    if task is None and {"-h", "--help"}.isdisjoint(args):
        raise PerdureError("train needs a task first, as in: perdure train Hopper-v3 --method geometric")
    method = _value(args, "--method", "geometric")
    preset = _value(args, "--preset", "") or None
    call(train_command(task, method, preset, _first_start(task, args)), args, name)


def _first_start(task: str | None, args: list[str]) -> Path | None:
    """Return the policy that the first of the training seeds continues; None where nothing is continued."""
    from perdure.learn.start import start_file

    name = _value(args, "--from", "")
    if task is None or not name:
        return None
    first = _value(args, "--seeds", "0")
    seed = 0
    if first.isdecimal():
        seed = int(first)
    out = Path(_value(args, "--out", "runs"))
    return start_file(start_policy(Path(name), task, (seed,), out, _value(args, "--normalizer", "")), seed)


def start_policy(name: Path, task: str, seeds: Sequence[int], out: Path, normalizer: str | None) -> Path:
    """Return the policy that training continues, or a folder with one for each seed; models are imported into `out`."""
    from perdure.envs.suites import ENVPOOL_PREFIX, GYMNASIUM_PREFIX
    from perdure.policy.readers.found import policies_by_seed
    from perdure.report.schema import IMPORTED

    env = task
    if not task.startswith(GYMNASIUM_PREFIX):  # a name without prefix may mean Gymnasium's environment
        env = f"{ENVPOOL_PREFIX}{task}"
    return policies_by_seed(name, seeds, out / IMPORTED, env, {"normalizer": normalizer or None}, tell)


def train_command(
    task: str | None, method: str = "geometric", preset: str | None = None, start: Path | None = None
) -> Callable[..., None]:
    """Return the command ``train``; the arguments set the defaults of the learner's settings.

    Args:
        task: The task; None if only help is wanted.
        method: The training method.
        preset: The preset of hyperparameters.
        start: File of the policy that training continues, which says what the network looks like; None: new weights.
    """
    from perdure.envs import task_spec
    from perdure.learn import PPOConfig
    from perdure.learn.algorithm import algorithm_of, usual_config
    from perdure.policy import load_policy

    kind = algorithm_of(method)
    config: Configuration = PPOConfig()
    if kind is not PPOConfig:
        config = kind.of_method(method, "", 1, None, 1000)
    if task is not None:
        spec = task_spec(task)
        config = usual_config(method, task, spec.observation_size, preset, spec.default_horizon)
        if start is not None:
            config = config.continued(load_policy(start))

    def train(
        task: tyro.conf.Positional[str],
        method: str = "geometric",
        preset: str | None = None,
        name: str | None = None,
        disturb: tuple[str, ...] = (),
        start: Annotated[Path | None, tyro.conf.arg(name="from")] = None,
        normalizer: Normalizer = None,
        seeds: tuple[int, ...] = (0,),
        out: Path = Path("runs"),
        cores: Cores = None,
        on: On = "local",
        tensorboard: bool = False,
        settings: Configuration = config,
    ) -> None:
        """Train seeds of one task with one method. An interrupted command resumes when you run it again.

        Args:
            task: A task as `perdure list tasks` names it, such as Hopper-v3 or gymnasium:Hopper-v5. Comes first.
            method: A method as `perdure list methods` names it.
            preset: Hyperparameters: zoo (RL Baselines3 Zoo's, tuned for each task, as in the thesis) or cleanrl (one
                set). By default cleanrl for Hopper and Walker2d, zoo otherwise: with zoo most Hoppers stand still.
            name: Name for changed settings: the run is kept in OUT/TASK/NAME instead of OUT/TASK/METHOD.
            disturb: What disturbs every training episode, all together, such as standard-1, or action_noise:0.05
                push:0.5 (see `perdure list disturbances`); the run is kept in OUT/TASK/METHOD+standard-1.
            start: Policy that training continues: network and observation statistics are kept, the critic is new, and
                a time-to-go input that it lacks begins with weights of 0. A policy file, a shipped policy, model.zip of
                Stable-Baselines3 (PPO, A2C, TRPO), a run of RL Baselines3 Zoo, or an ONNX model that is a plain
                network. A folder with seed-0.zip, seed-1.zip and so on: each seed continues its own. The run is kept in
                OUT/TASK/METHOD+continued.
            seeds: Training seeds, such as 0 1 2, trained side by side; each gives the same result as if trained alone.
            out: Folder of the runs; a policy is OUT/TASK/METHOD/seed-N/policy.safetensors.
            tensorboard: Also write curves for TensorBoard to OUT/tensorboard.
            settings: The learner's settings; the defaults are those of task and method.
        """
        from perdure.disturbances import STANDARDS, parse_disturbance, parse_disturbances
        from perdure.learn.progress import on_report
        from perdure.learn.progress import tensorboard as curves
        from perdure.learn.run import TrainRun
        from perdure.learn.run import train as train_run
        from perdure.runs.progress import show_progress

        parts = [method]
        if start is not None:
            parts.append("continued")
            start = start_policy(start, task, seeds, out, normalizer)
        if parse_disturbances(disturb):
            parts += sorted(each if each in STANDARDS else parse_disturbance(each).label for each in disturb)
        variant = "+".join(parts).replace(":", "-")
        run = TrainRun(
            task, name or variant, settings, seeds, preset=preset, base_method=method, disturb=disturb, start=start
        )
        with ExitStack() as stack:
            observers = [stack.enter_context(show_progress(f"{run.task} {run.method}", "steps"))]
            if tensorboard:
                folder = out / "tensorboard" / Path(run.key(0)).parent
                observers.append(on_report(run, stack.enter_context(curves(folder))))

            def observe(status: Any) -> None:
                for observer in observers:
                    observer(status)

            with _say_what_is_kept(run, out):
                paths = train_run(run, out, cores=cores, on=on, observe=observe)
        print(*paths, sep="\n")

    # The flags are those of the method's algorithm, such as --ppo.gamma.
    train.__annotations__["settings"] = Annotated[type(config), tyro.conf.arg(name=config.name)]
    return train


@contextmanager
def _say_what_is_kept(run: TrainRun, out: Path) -> Iterator[None]:
    """Print where each seed resumes, and give an interruption of the block the words of what checkpoints keep."""
    from perdure.learn.run import kept_steps

    for seed, count in kept_steps(run, out).items():
        if count:
            print(f"perdure: seed {seed} resumes at step {count:,}", file=sys.stderr)
    try:
        yield
    except KeyboardInterrupt as interrupt:
        words = []
        for seed, count in kept_steps(run, out).items():
            if count:
                words.append(f"seed {seed} up to step {count:,}")
            else:
                words.append(f"nothing of seed {seed}, which has no checkpoint yet")
        interrupt.add_note(f"kept: {', '.join(words) or 'everything'}; run the same command to continue")
        raise


def _task_first(args: list[str]) -> list[str]:
    """Return the arguments with the task in front, wherever it was written."""
    if not args or not args[0].startswith("-"):
        return args
    from perdure.envs import is_task

    at = next((k for k, arg in enumerate(args) if not arg.startswith("-") and is_task(arg)), None)
    return args if at is None else [args[at], *args[:at], *args[at + 1 :]]


def _value(args: list[str], flag: str, default: str) -> str:
    """Return the last value of a flag, before the whole line is parsed; a missing one is reported then."""
    found = default
    for arg, after in zip(args, [*args[1:], default], strict=True):
        name, equals, value = arg.partition("=")
        if name == flag:
            found = value if equals else after
    return found
