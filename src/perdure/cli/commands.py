"""The commands that evaluate, convert and show policies, over the functions of the library."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from perdure.cli.parse import Cores, On, call
from perdure.cli.show import methods, model_text, policies, policy_text, tasks
from perdure.cli.subjects import is_function, load_function, policy_files
from perdure.errors import PerdureError
from perdure.report.charts import Format

if TYPE_CHECKING:
    from perdure.horizon import Clock
    from perdure.policy import PolicyLike

PolicyName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(help="A policy file, or the name of a shipped policy.")]
Normalizer = Annotated[
    str | None,
    tyro.conf.arg(
        help='For models of Stable-Baselines3: the file that VecNormalize.save() wrote; "none" if only rewards were '
        "normalized."
    ),
]
TimeFeature = Annotated[
    str | None,
    tyro.conf.arg(
        help="For models of Stable-Baselines3: linear:1000 if trained in sb3-contrib's TimeFeatureWrapper with 1000 "
        "steps; linear takes the training horizon."
    ),
]
TrainingHorizon = Annotated[
    int | None,
    tyro.conf.arg(
        help="For models: steps of a training episode; if left out, what an exported ONNX model says, or the "
        "environment's own step limit."
    ),
]
Trust = Annotated[
    bool,
    tyro.conf.arg(
        help="For models of Stable-Baselines3: load with Stable-Baselines3 itself, which runs code in the files. Only "
        "for files you trust."
    ),
]

NOT_HOLDING = 3
"""Exit code of `--require holds` if something does not hold."""


def main(name: str, args: list[str]) -> None:
    """Run a command of this module."""
    call(COMMANDS[name], args, name)


def extrapolate(
    policies: tyro.conf.Positional[tuple[str, ...]],
    env: str | None = None,
    normalizer: Normalizer = None,
    time_feature: TimeFeature = None,
    training_horizon: TrainingHorizon = None,
    trust: Trust = False,
    steps: int | None = None,
    hours: float | None = None,
    clocks: tuple[str, ...] = ("default",),
    eval_seeds: int | None = None,
    first_eval_seed: int = 0,
    disturb: tuple[str, ...] = (),
    success: str | None = None,
    out: Path = Path("extrapolation"),
    cores: Cores = None,
    on: On = "local",
    max_episodes: int = 48,
    modules: tuple[str, ...] = (),
    require: Literal["holds"] | None = None,
    json: bool = False,
    command: str = "",
) -> None:
    """Run policies far beyond their training horizon, under several clocks, and judge them.

    An episode is one deployed run: a policy under a clock from a start state. By default there are 3 calm ones of
    100,000 steps and 36 of 10,000 steps under standard-1, small disturbances. Writes episodes.parquet,
    report.html and figures. An interrupted command resumes when you run it again.

    Args:
        policies: Policy files, names of shipped policies (`perdure list policies`), model.onnx, rsl_rl's model_1.pt,
            model.zip of Stable-Baselines3, a folder of its checkpoints, a run of RL Baselines3 Zoo
            (logs/ppo/Hopper-v4_1); all for one task. Or a Python function (my_policies:walk): imported from the
            working directory or PYTHONPATH, run in this process.
        env: For models and functions: the environment they were trained in. Hopper-v5 is Gymnasium's if Gymnasium can
            make it; envpool:Hopper-v5 is EnvPool's, which is faster; robot.yaml is the contract of a robot.
        steps: Steps of each calm episode (100,000 by default), or of each under --disturb (10,000). Without --disturb
            36 episodes under standard-1 follow, of 10,000 steps; --disturb none leaves them out.
        hours: In place of --steps: hours of each of those episodes, by the environment's control rate.
        clocks: Clocks of policies with a time-to-go input: constant:500, periodic:500, countdown:1000, countdown (to
            the end), default (each policy's own clock), sweep (constant 0 to 1000 and periodic 100 to 1000 in steps of
            100, and countdown).
        eval_seeds: Start states, calm (3) or under --disturb (36); the same ones for every policy and clock.
        first_eval_seed: First start state: choose a policy or a clock on some start states, and report on others.
        disturb: none (calm episodes only), standard-1, or what disturbs every episode, all together: action_noise:0.1
            (of half the action range), observation_noise:0.05 (of the spread in training), action_delay:2 (steps),
            push:0.5 (m/s, every 200 steps), mass:1.2, friction:0.8, strength:0.9, time_step:0.5 (factors), lag:0.3,
            payload:0.1, slope:3. push:0.2,0.4 tries each level. Without it: calm episodes and standard-1; discrete
            actions, or a desired_goal observed: calm only.
        success: Entry of the environment's infos that says after every step whether the goal is reached. If left out,
            is_success or success.
        out: Folder for the table and the report. Finished parts of an interrupted evaluation are kept there.
        max_episodes: Most episodes in one process at a time. Results do not depend on it; a crash costs at most these.
        modules: Python modules that the policies' tasks may import; a policy file alone never imports anything.
        require: End with exit code 3, and a line that names them, if policies, clocks or disturbances do not hold.
        json: Print the summary as one JSON document, and nothing else on standard output.
        command: The command line, stored with the table.
    """
    from perdure.envs import module_of, task_of_environment
    from perdure.evaluate import extrapolate as evaluate
    from perdure.evaluate.stored import takes_clock
    from perdure.evaluate.watch import add_stills
    from perdure.policy.onnx import is_onnx
    from perdure.report.outcomes import NeverWorked
    from perdure.runs.progress import show_progress

    aside = redirect_stdout(sys.stderr if json else sys.stdout)  # environments and functions may print
    function = any(map(is_function, policies))
    if function and (len(policies) > 1 or normalizer or time_feature or trust):
        raise PerdureError("a function is evaluated alone, without --normalizer, --time-feature and --trust")
    sb3 = {"normalizer": normalizer, "time_feature": time_feature, "trust": trust}
    with aside:
        files = () if function else policy_files(policies, env, sb3, training_horizon, out, modules)
        subject = load_function(policies[0]) if function else files
    elsewhere = function or any(map(is_onnx, files))  # its file does not name its task
    module = None if env is None else module_of(task_of_environment(env))
    if clocks != ("default",) and not function and not any(map(takes_clock, files)):
        print("perdure: no policy here has a time-to-go input, so --clocks has no effect", file=sys.stderr)
    with aside, show_progress("extrapolate", "steps") as observe:
        result = evaluate(
            subject,
            env if elsewhere else None,
            steps=steps,
            clocks=None if function and clocks == ("default",) else clocks,
            hours=hours,
            eval_seeds=eval_seeds,
            first_eval_seed=first_eval_seed,
            disturb=disturb or None,
            success=success,
            training_horizon=training_horizon if elsewhere else None,
            out=out,
            cores=cores,
            on=on,
            max_episodes=max_episodes,
            modules=modules if module is None else (*modules, module),
            command=command,
            observe=observe,
            waiting=lambda: print(f"perdure: waiting for another evaluation into {out}", file=sys.stderr),
        )
        if not function:
            add_stills(result.frame, result.files, files, out, on)
    table = result.path
    states = result.frame["policy_state"].unique().to_list()
    del result  # the report needs the memory
    assert table is not None
    if normalizer == "none" and NeverWorked.name in states:
        print(
            "perdure: with --normalizer none the policy sees raw observations; if it was trained behind VecNormalize, "
            "give the file that its save() wrote, often vecnormalize.pkl beside the model",
            file=sys.stderr,
        )
    write_and_show(table, out, () if function else ("png",), require, json)  # the figures of a function are there


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
        clock: Clock that is fixed in the model, such as constant:500, or default (the policy's own clock). If left out,
            the model has the inputs elapsed and horizon.
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


def report(table: tyro.conf.Positional[Path], out: Path | None = None, formats: tuple[Format, ...] = ("png",)) -> None:
    """Judge the episodes of a table that `perdure extrapolate` wrote, and make report.html and its figures.

    Nothing is simulated. Verdicts follow the rules of this version of perdure, from episodes.parquet and from
    baselines.parquet beside it. Without the second file, as in older results, the verdicts of the table are shown.

    Args:
        table: The table episodes.parquet, or the folder that holds it.
        out: Folder to write into; the table's own by default.
        formats: File formats of the figures beside the page.
    """
    table = find_table(table)
    if out is not None and (other := find_table(out)) != out and other.exists() and not other.samefile(table):
        raise PerdureError(f"{out} holds another evaluation, whose report would be replaced: name another folder")
    write_and_show(table, out or table.parent, formats)


def find_table(path: Path) -> Path:
    """Return the table that a path means: in a folder its episodes.parquet."""
    if not path.is_dir():
        return path
    from perdure.evaluate.table import TABLE

    return path / TABLE


def write_and_show(
    table: Path, out: Path, formats: Sequence[Format] = ("png",), require: str | None = None, as_json: bool = False
) -> None:
    """Write the report of a table into ``out``; print the summary and the path of the report.

    Raises:
        SystemExit: With `NOT_HOLDING` if "holds" is required and something in the table does not hold.
    """
    from perdure.evaluate.judge import read_judged
    from perdure.report import estimate_table, summary_text, write_report
    from perdure.report.page import STILLS, not_holding, summary_json

    episodes, notes = read_judged(table)
    estimates = estimate_table(episodes)
    del episodes  # of a large table
    if not as_json:
        print(summary_text(estimates))
    page = write_report(estimates, out, notes.get("command", ""), formats, notes, table.parent / STILLS).resolve()
    print(summary_json(estimates, table, page) if as_json else f"\nReport: {page}")
    if require is not None and (missed := not_holding(estimates)):
        print(f"perdure: --require {require} is not met: {'; '.join(missed)}", file=sys.stderr)
        raise SystemExit(NOT_HOLDING)


def watch(
    policy: PolicyName,
    env: str | None = None,
    clock: str | None = None,
    until_failure: bool = False,
    beside: str | None = None,
    disturb: tuple[str, ...] = (),
    out: Path = Path("film.mp4"),
    steps: int = 10_000,
    eval_seeds: int = 10,
    first_eval_seed: int = 0,
    modules: tuple[str, ...] = (),
) -> None:
    """Film a policy as it fails. Needs the extra perdure[film].

    Any environment of Gymnasium that renders rgb_array can be filmed. EnvPool cannot render: the film of its tasks, and
    the search for a failure, use Gymnasium's environment of the same name, on another build of MuJoCo.

    Args:
        env: For model.onnx: its environment, or the contract of its robot.
        clock: Clock of the policy: constant:0, periodic:500, countdown:1000, countdown (to the end), or default (its
            own clock), which is used if left out.
        until_failure: Film the first failure: 5 s before it and 1 s after it. Otherwise film the first 6 s.
        beside: A second clock, such as constant:500, from the same start state: two films side by side.
        disturb: What disturbs the episode, such as push:0.5. Without --beside, a calm episode is shown beside it.
        out: The film: .mp4, .gif or .webp.
        steps: Steps of each episode, unless it ends earlier.
        eval_seeds: Start states among which a failure is searched for.
        first_eval_seed: First start state.
        modules: Python modules that the policy's task may import.
    """
    from perdure.envs import task_of_environment
    from perdure.evaluate import watch as films
    from perdure.evaluate.stored import load, read_file
    from perdure.policy import find_policy
    from perdure.policy.onnx import is_onnx, model_digest

    model = is_onnx(policy)
    file = Path(policy) if model else find_policy(policy)
    if model == (env is None):
        load(file)  # raises what it is, if it is of another library
        raise PerdureError(f"{policy}: an ONNX model needs its environment, --env Hopper-v5; other policies take none")
    loaded = read_file(file, model_digest(file), task_of_environment(env) if env else "", None)
    film = films.watch(
        loaded,
        out,
        clock=read_clock("--clock", clock, loaded, steps),
        beside=read_clock("--beside", beside, loaded, steps),
        disturb=disturb,
        until_failure=until_failure,
        steps=steps,
        eval_seeds=eval_seeds,
        first_eval_seed=first_eval_seed,
        modules=modules,
    )
    known = env or loaded.task.name.startswith("gymnasium:")
    build = "" if known else "; a policy of EnvPool was trained on another build"
    print(*film.sentences, f"Filmed in {film.world}{build}.", sep="\n")
    print(f"\nFilm: {film.path.resolve()}")


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
    what: tyro.conf.Positional[Literal["tasks", "methods", "policies"]] = "tasks", suite: str | None = None
) -> None:
    """List tasks, training methods, or the policies that come with perdure.

    Args:
        what: What to list.
        suite: Only tasks of this suite.
    """
    if suite is not None and what != "tasks":
        raise PerdureError(f"--suite is for tasks, not for {what}")
    print({"tasks": lambda: tasks(suite), "methods": methods, "policies": policies}[what]())


def inspect(policy: PolicyName) -> None:
    """Show what a policy file or an ONNX model contains."""
    from perdure.policy import load_policy
    from perdure.policy.onnx import is_onnx

    print(model_text(policy) if is_onnx(policy) else policy_text(load_policy(policy)))


def robot(
    what: tyro.conf.Positional[Literal["check"]], contract: tyro.conf.Positional[Path], policy: Path | None = None
) -> None:
    """Check a robot's contract against its model and its policy, by short walks with common mistakes undone.

    The exit code is 3 if the robot falls, walks no better than without actions, or walks clearly better under another
    contract: another joint order, gain, scale, order of terms, default pose or decimation.

    Args:
        what: What to do with it.
        contract: The YAML file, which is also the --env of `perdure extrapolate`.
        policy: The exported policy, model.onnx.
    """
    from perdure.policy.onnx import OnnxModel
    from perdure.robots import read_contract
    from perdure.robots.check import check

    lines, passed = check(read_contract(contract), None if policy is None else OnnxModel.load(policy))
    print(*lines, sep="\n")
    if not passed:
        raise SystemExit(NOT_HOLDING)


COMMANDS: dict[str, Callable[..., None]] = {
    "extrapolate": extrapolate,
    "import": import_model,
    "export": export,
    "report": report,
    "watch": watch,
    "card": card,
    "list": list_names,
    "inspect": inspect,
    "robot": robot,
}
