"""The commands that convert and show policies, over the functions of the library."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from perdure.cli.extrapolate import NOT_HOLDING, find_table
from perdure.cli.parse import Normalizer, TimeFeature, TrainingHorizon, Trust, call
from perdure.cli.show import disturbances, methods, model_text, observations, policies, policy_text, tasks
from perdure.errors import PerdureError

if TYPE_CHECKING:
    from perdure.horizon import Clock
    from perdure.policy import PolicyLike

PolicyName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(help="A policy file, or the name of a shipped policy.")]


def main(name: str, args: list[str]) -> None:
    """Run a command of this module."""
    if name == "watch":
        watch(call(Watch, args, name))
    else:
        call(COMMANDS[name], args, name)


def import_model(
    model: tyro.conf.Positional[Path],
    env: str,
    out: Path = Path("policy.safetensors"),
    normalizer: Normalizer = None,
    time_feature: TimeFeature = None,
    training_horizon: TrainingHorizon = None,
    trust: Trust = False,
) -> None:
    """Convert a model of Stable-Baselines3 or sb3-contrib, or a checkpoint of rsl_rl, to a policy file.

    Args:
        model: The zip that model.save() wrote, or model_1500.pt of rsl_rl.
        env: The environment it was trained in. Hopper-v5 is Gymnasium's if Gymnasium can make it; envpool:Hopper-v5 is
            EnvPool's, which is faster.
        out: The file to write.
    """
    from perdure.policy import save_policy
    from perdure.policy.readers import import_file
    from perdure.runs import refuse_replacing

    refuse_replacing(out)
    found = import_file(
        *(model, env), normalizer=normalizer, time_feature=time_feature, training_horizon=training_horizon, trust=trust
    )
    print(save_policy(found, out))


def export(policy: PolicyName, out: tyro.conf.Positional[Path] = Path("policy.onnx"), clock: str | None = None) -> None:
    """Export a policy as an ONNX model, checked with onnxruntime. Needs the extra perdure[onnx].

    Args:
        out: The file to write.
        clock: Clock that is fixed in the model: {clocks}, or default (the policy's own clock). If left out, the model
            has the inputs elapsed and horizon.
    """
    from perdure.policy import load_policy
    from perdure.policy.onnx import export_onnx, is_onnx
    from perdure.runs import refuse_replacing

    if not is_onnx(out):
        raise PerdureError(f"out must be a file named .onnx, not {out}")
    refuse_replacing(out)
    loaded = load_policy(policy)
    print(export_onnx(loaded, out, read_clock("--clock", clock, loaded)))


def read_clock(flag: str, text: str | None, policy: PolicyLike, steps: int | None = None) -> Clock | None:
    """Return the clock that a flag names; None if the flag is left out.

    Args:
        flag: Name of the flag, for the message.
        text: "default" (the policy's own clock), "countdown" (to the end), or as `perdure.horizon.parse_clock` reads.
        policy: The policy that gets the clock.
        steps: Steps of the episode; None if the command knows no end, so that a countdown must name its steps.

    Raises:
        PerdureError: If the text is "default" and the policy has no time-to-go input, or the text names no clock.
    """
    from perdure.horizon import Countdown, parse_clock

    if text is None:
        return None
    if text == "default":
        own: Clock | None = getattr(policy, "clock", None)
        if own is None:
            raise PerdureError(
                f"{flag} default: this {policy.task.name} policy has no time-to-go input, so it takes no clock"
            )
        return own
    return Countdown(float(steps)) if text == "countdown" and steps is not None else parse_clock(text)


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Film a policy under small disturbances: its failure, else the first 6 s. Needs the extra perdure[film].

    One policy is shown beside itself when calm, several beside each other. An arrow marks each push.

    Any environment of Gymnasium that renders rgb_array can be filmed. EnvPool cannot render: the film of its tasks, and
    the search for a failure, use Gymnasium's environment of the same name, on another build of MuJoCo.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Policy files or names of shipped policies, of one task."""
    env: str | None = None
    """For model.onnx: its environment, or the contract of its robot."""
    model: str | None = None
    """The robot's MJCF, for an --env that names none (deploy.yaml)."""
    clock: str | None = None
    """Clock of the policy: {clocks}, countdown (to the end), or default (its own clock), which is used if left out."""
    until_failure: bool = False
    """Search for a start state from which a policy fails. Otherwise the first one is filmed."""
    beside: str | None = None
    """A second clock, such as constant:500, from the same start state: two films side by side."""
    disturb: tuple[str, ...] | None = None
    """standard-1 (as far as the environment can do it; used if left out), none, or what disturbs the episode:
    {disturbances}."""
    out: Path = Path("film.mp4")
    """The film: .mp4, .gif or .webp."""
    steps: int = 10_000
    """Steps of each episode, unless it ends earlier."""
    eval_seeds: int = 10
    """Start states among which a failure is searched for."""
    first_eval_seed: int = 0
    """First start state."""
    modules: tuple[str, ...] = ()
    """Python modules that the policy's task may import."""


def watch(flags: Watch) -> None:
    """Film a policy and say what the film shows."""
    from perdure.envs import task_of_environment, with_model
    from perdure.evaluate import watch as films
    from perdure.evaluate.run import load, read_file
    from perdure.policy import find_policy
    from perdure.policy.onnx import is_onnx, model_digest

    if not flags.policies:
        raise PerdureError("name a policy: a file, or one of perdure list policies")
    task = ""
    if flags.env is not None:
        task = task_of_environment(with_model(flags.env, flags.model))
    loaded: dict[str, PolicyLike] = {}
    for name in flags.policies:
        model = is_onnx(name)
        file = Path(name) if model else find_policy(name)
        if model == (flags.env is None):
            load(file)  # raises what it is, if it is of another library
            raise PerdureError(
                f"{name}: an ONNX model needs its environment, --env Hopper-v5; other policies take none"
            )
        loaded[_short_name(name, flags.policies)] = read_file(file, model_digest(file), task, None)
    # Only a policy with a time-to-go input has a clock of its own.
    timed = next((each for each in loaded.values() if each.has_clock), next(iter(loaded.values())))
    film = films.watch(
        loaded if len(loaded) > 1 else timed,
        flags.out,
        clock=read_clock("--clock", flags.clock, timed, flags.steps),
        beside=read_clock("--beside", flags.beside, timed, flags.steps),
        disturb=flags.disturb,
        until_failure=flags.until_failure,
        steps=flags.steps,
        eval_seeds=flags.eval_seeds,
        first_eval_seed=flags.first_eval_seed,
        modules=flags.modules,
    )
    known = flags.env or timed.task.name.startswith("gymnasium:")
    build = "" if known else "; a policy of EnvPool was trained on another build"
    print(*film.sentences, f"Filmed in {film.world}{build}.", sep="\n")
    print(f"\nFilm: {film.path.resolve()}")


def _short_name(name: str, names: Sequence[str]) -> str:
    """Return the last part of a policy's name, or the whole name where others have the same last part."""
    stems = [Path(each).stem for each in names]
    stem = Path(name).stem
    return name if stems.count(stem) > 1 else stem


def card(policy: tyro.conf.Positional[str], table: Path, out: Path | None = None) -> None:
    """Write a policy's model card in the format of Hugging Face: README.md beside its file.

    Args:
        policy: A policy file, a folder that holds one, or the name of a shipped policy.
        table: The table of `perdure extrapolate` that holds the policy's episodes: episodes.parquet, or its folder.
        out: The file to write; by default README.md in the policy's folder, or STEM.README.md if that holds several
            policies. Required for shipped and downloaded policies.
    """
    from perdure.evaluate.card import write_card

    print(write_card(policy, find_table(table), out))


def list_names(
    what: tyro.conf.Positional[Literal["tasks", "methods", "policies", "disturbances", "observations"]] = "tasks",
    suite: str | None = None,
) -> None:
    """List tasks, training methods, the policies that come with perdure, disturbances, or what robots observe.

    Args:
        what: What to list.
        suite: Only tasks of this suite.
    """
    if suite is not None and what != "tasks":
        raise PerdureError(f"--suite is for tasks, not for {what}")
    texts = {"methods": methods, "policies": policies, "disturbances": disturbances, "observations": observations}
    print(tasks(suite) if what == "tasks" else texts[what]())


def inspect(policy: PolicyName) -> None:
    """Show what a policy file or an ONNX model contains."""
    from perdure.policy import load_policy
    from perdure.policy.onnx import is_onnx

    print(model_text(policy) if is_onnx(policy) else policy_text(load_policy(policy)))


def robot(
    what: tyro.conf.Positional[Literal["check", "init"]],
    contract: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")],
    model: str | None = None,
    policy: Path | None = None,
    trace: Path | None = None,
    out: Path = Path("robot.yaml"),
) -> None:
    """Draft a robot's contract from its MJCF, or check a contract against its model and its policy.

    init writes a commented draft: joints, pose, gains and limits of the model, and what the exporter of the policy
    noted. check walks for some seconds with common mistakes undone; its exit code is 3 if the robot falls, walks no
    better than without actions, or walks clearly better under another contract: another joint order, gain, scale, order
    of terms, default pose or decimation; or if a trace differs from what the contract computes.

    Args:
        what: What to do with it.
        contract: For check the file that is also the --env of `perdure extrapolate`; for init the robot's MJCF, or a
            deployment file (deploy.yaml, env.yaml) with --model.
        model: The robot's MJCF, for files that name none.
        policy: The exported policy, model.onnx.
        trace: For check: observations and actions that were recorded in training or on the robot (.npz).
        out: For init: the file to write.
    """
    from perdure.envs import with_model

    if what == "init":
        _draft_contract(contract, model, policy, out)
        return
    from perdure.policy.onnx import OnnxModel
    from perdure.robots import read_contract
    from perdure.robots.check import check

    act = None
    if policy is not None:
        act = OnnxModel.load(policy)
    read = read_contract(with_model(str(contract), model))
    lines, passed = check(read, act)
    if trace is not None:
        from perdure.robots.trace import compare, read_trace

        found, same = compare(read, act, read_trace(trace, read))
        lines += found
        passed = passed and same
    print(*lines, sep="\n")
    if not passed:
        raise SystemExit(NOT_HOLDING)


def _draft_contract(file: Path, model: str | None, policy: Path | None, out: Path) -> None:
    """Write the draft of a contract, from the MJCF of a robot or from a deployment file."""
    from perdure.robots.draft import MARK, draft
    from perdure.robots.readers import DeploymentReader, find_reader
    from perdure.runs import refuse_replacing, write_atomic

    refuse_replacing(out)
    reader = find_reader(file)
    if isinstance(reader, DeploymentReader):
        text = draft(reader.model_of(file, model), policy, out.parent, file)
    else:
        text = draft(file, policy, out.parent)
    print(write_atomic(out, text.encode()))
    marked = text.count(f"# {MARK}")
    given = policy or "policy.onnx"
    print(f"{marked} places to complete (# {MARK}); then: perdure robot check {out} --policy {given}")


COMMANDS: dict[str, Callable[..., None]] = {
    "import": import_model,
    "export": export,
    "card": card,
    "list": list_names,
    "inspect": inspect,
    "robot": robot,
}
