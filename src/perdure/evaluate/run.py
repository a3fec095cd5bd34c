"""`extrapolate` and `evaluate_files`: what a caller names becomes policies, worlds and options for the evaluator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from perdure.envs import OpenEnv, open_env, refuse_import, report_success, task_of_environment
from perdure.envs.suites import ENVPOOL_PREFIX, GYMNASIUM_PREFIX
from perdure.errors import PerdureError, did_you_mean
from perdure.evaluate.episodes import FIRST_EVAL_SEED
from perdure.evaluate.options import OWN_CLOCK, Extrapolation
from perdure.evaluate.reference import task_env
from perdure.evaluate.stored import evaluate
from perdure.evaluate.table import ExtrapolationResult, method_label, train_seed
from perdure.evaluate.units import Execution, Source, Subject, Worlds
from perdure.policy import FunctionPolicy, Policy, PolicyLike, TaskInfo, find_policy, load_policy
from perdure.policy.onnx import OnnxModel, is_onnx, model_digest
from perdure.policy.reference import resolve_training_horizon
from perdure.runs import config_digest
from perdure.runs.progress import Lines
from perdure.schema import printable

Asked = TypeVar("Asked", bound=Extrapolation)


def extrapolate(
    policy: Callable[..., Any] | Policy | str | Path | Sequence[str | Path],
    env: Any = None,
    evaluation: Extrapolation | None = None,
    *,
    recurrent: bool = False,
    name: str | None = None,
    **options: Any,
) -> ExtrapolationResult:
    """Evaluate policies far beyond their training horizon.

    Files run over the cores, leave their results in ``out`` and resume after an interruption. A function or a `Policy`
    runs in this process, on one core; nothing is kept for a resumption, because a function has no identity that a later
    process could check. Table, verdict and report are the same.

    Args:
        policy: A function of observations (its calls: `perdure.policy.FunctionPolicy`); a `Policy`; or one or several
            files, as `perdure.policy.find_policy` takes them, or ONNX models, which need an env.
        env: A name, such as "Hopper-v5" (Gymnasium's) or "envpool:Hopper-v5"; for what runs in this process also a
            factory or a VectorEnv. Step limits of its own are lifted: see `perdure.envs.open_env`. None: the task of
            the policy.
        evaluation: The options as an object.
        recurrent: The function has a memory.
        name: Of the function, in the table; by default its own.
        options: The fields of `Extrapolation`, such as ``steps``, ``clocks``, ``eval_seeds`` and ``disturb``, also in
            place of those of ``evaluation``; one clock, disturbance or module may be a text. The fields of `Execution`:
            ``out``, ``cores``, ``on``, ``command``, ``observe``, ``waiting``. A function gets time, as the keywords
            ``elapsed`` and ``horizon``, if ``clocks`` are named. ``training_horizon`` is not for a `Policy`, which
            knows its own. Without ``observe`` a line is printed on standard error every half minute.

    Returns:
        The table of all episodes; as text, the verdicts.

    Raises:
        PerdureError: If there is nothing to evaluate, an option is unknown or makes no sense, an argument does not fit
            this kind of policy, ``out`` holds a table that would be lost, a policy does not fit its environment or
            returns what is no action, or an environment cannot be built or breaks its contract.
    """
    asked, execution = read_options(evaluation or Extrapolation(), options)
    env = asked.env if env is None else env
    subject: Any = policy
    if isinstance(policy, str | Path | list | tuple):
        if recurrent or name is not None:
            raise PerdureError("recurrent and name are for functions, not for files")
        files = tuple(map(Path, [policy] if isinstance(policy, str | Path) else policy))
        if env is None or (isinstance(env, str) and any(map(is_onnx, files))):
            return evaluate(*file_subjects(files, env, asked), asked, execution)
        if len(files) > 1:
            raise PerdureError("several policy files are evaluated in their own task: leave env out")
        subject = load(files[0])
    if env is None:
        if not isinstance(subject, Policy):
            raise PerdureError("env (--env) is missing: name the task, or give a factory or a VectorEnv")
        refuse_import(subject.task.name, asked.modules, "the policy")
        env = subject.task.name
    with open_env(env) as opened:
        source = replace(opened, make=lambda seeds: report_success(opened.make(seeds), asked.success))
        acting = subject_here(subject, source, asked, recurrent, name)
        worlds = Worlds(acting.policy.task.name, None if isinstance(env, str) else source, asked.success)
        return evaluate([acting], worlds, asked, execution)


def evaluate_files(evaluation: Extrapolation, execution: Execution | None = None) -> ExtrapolationResult:
    """Evaluate every episode of policy files and write ``episodes.parquet`` into the folder of the results.

    Finished episodes are kept there. An interrupted evaluation resumes, and one with more clocks, start states or
    policies runs only the new episodes. Results do not depend on the number of cores.

    Args:
        evaluation: What is evaluated.
        execution: Where; by default on all cores, with nothing kept.

    Raises:
        PerdureError: If `execution` is of another kind, the policies do not belong to one task, the folder holds the
            table of a function, a group of episodes failed, or a policy file cannot be read.
        OSError: If the folder cannot be written.
    """
    if execution is None:
        execution = Execution()
    if not isinstance(execution, Execution):
        raise PerdureError(f"execution must be an Execution, such as Execution(out={str(execution)!r})")
    subjects, worlds = file_subjects(evaluation.policies, evaluation.env, evaluation)
    return evaluate(subjects, worlds, evaluation, execution)


def read_options(
    evaluation: Asked, options: Mapping[str, Any], function: str = "extrapolate"
) -> tuple[Asked, Execution]:
    """Return the options that keywords name, over those of an evaluation; `function` is whose keywords they are."""
    if evaluation.policies:
        raise PerdureError(f"{function} takes policies as its first argument, not in its options")
    how = {each.name for each in fields(Execution)}
    what = {each.name for each in fields(evaluation) if each.init} - {"policies", "env"} - how
    for name in options:
        if name not in what | how:
            hint = did_you_mean(name, what | how)
            raise PerdureError(f"{function} has no option {name!r}; it has {', '.join(sorted(what | how))}{hint}")
    changes = {name: value for name, value in options.items() if name in what}
    for name in ("clocks", "disturb", "modules"):
        if isinstance(changes.get(name), str):
            changes[name] = (changes[name],)
    if changes.get("clocks") in (None, (), []):
        changes.pop("clocks", None)
    places = {name: value for name, value in options.items() if name in how}
    if places.get("observe") is None:
        places["observe"] = Lines(function, "steps")
    if changes:  # a new object reads its clocks and disturbances again
        evaluation = replace(evaluation, **changes)
    return evaluation, Execution(**places)


# Policies of this process


def subject_here(policy: Any, source: OpenEnv, asked: Extrapolation, recurrent: bool, name: str | None) -> Subject:
    """Return a function, an ONNX model or a policy of this process as it acts in an environment."""
    if not isinstance(policy, Policy):
        timed = bool(policy.times) if isinstance(policy, OnnxModel) else asked.clocks != OWN_CLOCK
        function = function_policy(policy, source, timed, asked.training_horizon, recurrent, name)
        label = name or method_label(function, "policy")
        return Subject(function, Source("function", lambda: function), label)
    if recurrent or asked.training_horizon is not None:
        raise PerdureError("recurrent and training_horizon are for functions; a Policy knows its own")
    with closing(source.make([FIRST_EVAL_SEED] * (source.lanes or 1))) as world:
        task = world.spec.name
    # Tables name the environment that is run. Reference episodes in the file were measured without `success`.
    acting = replace(policy, task=replace(policy.task, name=task))
    if asked.success is not None:
        acting = replace(acting, reference=None)
    return Subject(acting, Source("policy", lambda: acting), name or method_label(policy, "policy"))


def function_policy(
    function: Any, source: OpenEnv, timed: bool, horizon: int | None, recurrent: bool = False, name: str | None = None
) -> FunctionPolicy:
    """Return a function or an ONNX model as a policy for the environment."""
    if not callable(function):
        raise PerdureError(
            f"policy must be a function of observations, a Policy or its file, not {type(function).__name__}"
        )
    if name is None:
        name = str(getattr(function, "__name__", type(function).__name__)).replace("<lambda>", "function")
    elif not (0 < len(name) <= 500 and name.isprintable()):
        raise PerdureError(f"name must be text of 1 to 500 characters in one line, got {name!r}")
    if isinstance(function, OnnxModel):
        if function.times == ("elapsed",):
            raise PerdureError(f"{name} counts time itself; export it with a constant clock, or with none")
        horizon = horizon or function.training_horizon
        recurrent = bool(function.state)
    with closing(source.make([FIRST_EVAL_SEED] * (source.lanes or 1))) as world:
        spec = world.spec
        spaces = world.spaces
    if isinstance(function, OnnxModel):
        function.check_sizes(spec)
    return FunctionPolicy(
        function,
        TaskInfo.of(spec),
        spaces,
        recurrent,
        timed,
        float(resolve_training_horizon(spec, horizon)),
        {"method": name, "seed": 0},
    )


# Policies of files


def load(path: Path) -> Policy | OnnxModel:
    """Return what is in a policy file or an ONNX model."""
    return OnnxModel.load(path) if is_onnx(path) else load_policy(path)


def read_file(path: str | Path, digest: str, task: str, horizon: int | None) -> PolicyLike:
    """Return the policy of a policy file or an ONNX model.

    Args:
        path: The file.
        digest: Its SHA-256, see `perdure.policy.onnx.model_digest`.
        task: For an ONNX model.
        horizon: Training horizon of an ONNX model in steps; None: its own, or that of the task.

    Raises:
        PerdureError: If the file has changed or cannot be read.
    """
    if model_digest(Path(path)) != digest:
        raise PerdureError(f"{path} has changed since this evaluation began")
    loaded = load(Path(path))
    if isinstance(loaded, Policy):
        return loaded
    return function_policy(loaded, task_env(task), bool(loaded.times), horizon)


def takes_clock(path: Path) -> bool:
    """Return whether the policy in a file has a time-to-go input."""
    loaded = load(path)
    return loaded.has_clock if isinstance(loaded, Policy) else bool(loaded.times)


def file_subjects(files: Sequence[Path], env: str | None, evaluation: Extrapolation) -> tuple[list[Subject], Worlds]:
    """Read every policy file of an evaluation, and refuse what cannot be evaluated together.

    Args:
        files: Policy files, or names as `find_policy` takes them, and ONNX models.
        env: The environment of ONNX models.
        evaluation: The other options.
    """
    models = list(map(is_onnx, files))
    if not models:
        raise PerdureError("no policy to evaluate: name at least one policy file")
    if env is None and any(models):
        raise PerdureError("an ONNX model needs its environment: --env Hopper-v5 (env=)")
    if not any(models) and (env, evaluation.training_horizon) != (None, None):
        raise PerdureError("env and training_horizon are for ONNX models; a policy file names its own")
    subjects = list[Subject]()
    paths = [path if is_onnx(path) else find_policy(path) for path in files]
    for path in paths:
        subject = _file_subject(path, env, evaluation)
        for other, before in zip(subjects, paths, strict=False):
            if other.source.identity == subject.source.identity:
                raise PerdureError(f"{before} and {path} hold the same policy: name only one of them")
        subjects.append(subject)
    _check_one_task([each.policy.task.name for each in subjects])
    for path, subject in zip(paths, subjects, strict=True):
        if isinstance(subject.policy, Policy):
            refuse_import(subject.policy.task.name, evaluation.modules, str(path))
    labels = _labels(paths, [each.policy for each in subjects])
    subjects = [replace(each, label=label) for each, label in zip(subjects, labels, strict=True)]
    return subjects, Worlds(subjects[0].policy.task.name, None, evaluation.success)


def _file_subject(path: Path, env: str | None, evaluation: Extrapolation) -> Subject:
    """Return the policy of a file, without a label."""
    model = is_onnx(path)
    task = task_of_environment(env) if model and env is not None else ""
    if not path.is_file():
        load(path)  # raises what is wrong
    digest = model_digest(path)
    policy = read_file(path, digest, task, evaluation.training_horizon)
    identity = digest
    horizon = None
    if model:
        horizon = int(policy.training_horizon)
        parts = {"model": digest, "task": task, "horizon": policy.training_horizon}
        identity = config_digest({**parts, "onnxruntime": version("onnxruntime")})
    if evaluation.success is not None and isinstance(policy, Policy):
        policy = replace(policy, reference=None)  # its reference episodes were measured without this entry
    source = Source(identity, partial(read_file, path.absolute(), digest, task, horizon))
    return Subject(policy, source, "", digest)


def _check_one_task(names: Sequence[str]) -> None:
    """Refuse policies for several tasks; one robot in two engines gets a way out."""
    tasks = sorted(set(names))
    if len(tasks) == 1:
        return
    robot, *others = {task.removeprefix(GYMNASIUM_PREFIX) for task in tasks}
    way_out = ""
    if not others:
        way_out = (
            f"; for EnvPool's, read models with --env {ENVPOOL_PREFIX}{robot}; for Gymnasium's, train in {tasks[-1]}"
        )
    raise PerdureError(
        f"all policies of one evaluation must be for one task, these are for {', '.join(tasks)}{way_out}"
    )


def _labels(paths: Sequence[Path], policies: Sequence[PolicyLike]) -> list[str]:
    """Return a short name for each policy: its method and preset, and what else distinguishes it."""
    plain = [method_label(policy, printable(path.stem)) for path, policy in zip(paths, policies, strict=True)]
    short = [f"{label} ({path.parent.name}/{path.stem})" for label, path in zip(plain, paths, strict=True)]
    whole = [f"{label} ({path})" for label, path in zip(plain, paths, strict=True)]
    seeds = [train_seed(policy) for policy in policies]
    for labels in (plain, short):
        if len(set(zip(labels, seeds, strict=True))) == len(paths):
            return list(map(printable, labels))
    return list(map(printable, whole))
