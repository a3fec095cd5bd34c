"""`extrapolate`: evaluate policies of any kind. Functions and policy objects are evaluated in this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from perdure.disturbances import Disturbance
from perdure.envs import OpenEnv, World, make_world, open_env, refuse_import, report_success, task_of_environment
from perdure.envs.disturbances import disturbed_task
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, Extrapolation
from perdure.evaluate.judge import Baseline, judge_table, make_scales
from perdure.evaluate.reference import idle_baseline, with_reference
from perdure.evaluate.stored import GROUPS, REPLACED, evaluate_files, function_policy, load, plan, run_episodes
from perdure.evaluate.table import TABLE, ExtrapolationResult, method_label, train_seed, with_not_applied
from perdure.policy import Policy, PolicyLike
from perdure.policy.onnx import OnnxModel, is_onnx
from perdure.runs import Observer, Store, UnitProgress
from perdure.runs.progress import Lines
from perdure.runs.workers import check_on, core_count


def extrapolate(
    policy: Callable[..., Any] | Policy | str | Path | Sequence[str | Path],
    env: Any = None,
    *,
    steps: int | None = None,
    hours: float | None = None,
    clocks: Sequence[str] | str | None = None,
    eval_seeds: int | None = None,
    first_eval_seed: int = 0,
    disturb: Sequence[str] | str | None = None,
    success: str | None = None,
    training_horizon: int | None = None,
    recurrent: bool = False,
    name: str | None = None,
    out: str | Path | None = None,
    cores: int | None = None,
    on: str = "local",
    max_episodes: int = 48,
    modules: Sequence[str] = (),
    command: str = "",
    observe: Observer | None = None,
    waiting: Callable[[], None] = lambda: None,
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
        steps: How long each episode is asked to last; None: as in `Extrapolation`.
        hours: In place of `steps`.
        clocks: As in `Extrapolation`. For a function: None calls it without time; otherwise it gets the keywords
            ``elapsed`` and ``horizon``.
        eval_seeds: Start states; None: as in `Extrapolation`.
        first_eval_seed: The first of them.
        disturb: As in `Extrapolation`. None: calm episodes, and those under standard-1; "none": calm ones.
        success: As in `Extrapolation`.
        training_horizon: Steps of a training episode, within which the reference is measured. None: the step limit of
            the environment, 1,000 where it has none. Not for a `Policy`, which knows its own, as does an ONNX model
            that perdure exported.
        recurrent: The function has a memory.
        name: Of the function, in the table; by default its own.
        out: Folder for the results; made if it is missing. None keeps nothing.
        cores: Cores for files; all of them by default.
        on: Where files are evaluated: see `evaluate_files`.
        max_episodes: As in `Extrapolation`.
        modules: Python modules that the tasks of policy files may import.
        command: Stored with the table.
        observe: Called with the progress; by default a line is printed on standard error every half minute.
        waiting: Called once before waiting, if another evaluation into ``out`` is running.

    Returns:
        The table of all episodes; as text, the verdicts.

    Raises:
        PerdureError: If there is nothing to evaluate, a number makes no sense, an argument does not fit this kind of
            policy, ``out`` holds a table that would be lost, a policy does not fit its environment or returns what is
            no action, or an environment cannot be built or breaks its contract.
    """
    check_on(on)
    core_count(cores)
    observe = observe or Lines("extrapolate", "steps")
    files = (policy,) if isinstance(policy, str | Path) else policy if isinstance(policy, list | tuple) else ()
    named: Any = (clocks,) if isinstance(clocks, str) else clocks
    if named is None or (isinstance(named, list | tuple) and not named):
        named = ("default",)
    evaluation = Extrapolation(
        tuple(files) if isinstance(policy, str | Path | list | tuple) else (Path(),),
        steps,
        named,
        eval_seeds,
        first_eval_seed=first_eval_seed,
        hours=hours,
        disturb=(disturb,) if isinstance(disturb, str) else None if disturb is None else tuple(disturb),
        success=success,
        modules=tuple(modules),
        max_episodes=max_episodes,
        env=env if isinstance(env, str) else None,
        training_horizon=training_horizon,
    )
    if (recurrent and files) or (name is not None and files):
        raise PerdureError("recurrent and name are for functions, not for files")
    if files and (env is None or (isinstance(env, str) and any(map(is_onnx, files)))):
        return evaluate_files(evaluation, out, cores=cores, on=on, command=command, observe=observe, waiting=waiting)
    if len(files) > 1:
        raise PerdureError("several policy files are evaluated in their own task: leave env out")
    subject: Any = load(evaluation.policies[0]) if files else policy
    if env is None:
        if not isinstance(subject, Policy):
            raise PerdureError("env (--env) is missing: name the task, or give a factory or a VectorEnv")
        refuse_import(subject.task.name, evaluation.modules, "the policy")
        env = subject.task.name
    with ExitStack() as stack:
        if out is not None:
            store = Store(out)
            stack.enter_context(store.exclusive("extrapolate", waiting))
            if (store.root / TABLE).exists() or store.keys(GROUPS):
                raise PerdureError(f"an evaluation in this process cannot be continued: {REPLACED.format(store.root)}")
        opened = stack.enter_context(open_env(env))
        source = replace(opened, make=lambda seeds: report_success(opened.make(seeds), success))
        if not isinstance(subject, Policy):
            timed = bool(subject.times) if isinstance(subject, OnnxModel) else clocks is not None
            subject = function_policy(subject, source, timed, training_horizon, recurrent, name)
        elif recurrent or training_horizon is not None:
            raise PerdureError("recurrent and training_horizon are for functions; a Policy knows its own")
        if success is not None and isinstance(subject, Policy):
            subject = replace(subject, reference=None)  # measured without this entry
        label = method_label(subject, "policy") if name is None else name
        task = task_of_environment(env) if isinstance(env, str) else None
        result = _evaluate_here(evaluation, subject, source, task, label, observe)
        if out is None:
            return result
        result.write(out, command)
        return replace(result, path=Path(out) / TABLE)


def _evaluate_here(
    evaluation: Extrapolation, policy: PolicyLike, source: OpenEnv, task: str | None, label: str, observe: Observer
) -> ExtrapolationResult:
    """Evaluate one policy in this process; `task`: the name of the environment, if it has one."""
    import polars as pl

    def make(disturbances: Sequence[Disturbance], seeds: Sequence[int]) -> World:
        return source.make(seeds) if task is None else make_world(disturbed_task(task, disturbances), seeds)

    first_seeds = [FIRST_EVAL_SEED] * (source.lanes or 1)
    with closing(source.make(first_seeds)) as world:
        spec = world.spec
    conditions = evaluation.conditions(spec, lambda disturbances: make(disturbances, first_seeds))
    episodes = plan(evaluation, [policy], conditions)
    policy, idle = with_reference(policy, source), idle_baseline(source)
    assert policy.reference is not None
    frames, finished = list[pl.DataFrame](), 0.0
    total = sum(each.steps for each in episodes)
    for _, same in groupby(episodes, key=lambda each: (each.disturbance, each.steps)):
        mine = list(same)
        for group in source.groups(len(mine)):
            specs = [mine[k] for k in group]

            def report(done: float, _: float, before: float = finished) -> None:
                observe({"episodes": UnitProgress("running", before + done, total)})

            seeds = [FIRST_EVAL_SEED + episode.eval_seed for episode in specs]
            with closing(make(specs[0].disturbances, seeds)) as world:
                rows = run_episodes([label], [policy], specs, report, world, evaluation.success)
            # The last episode is repeated where a VectorEnv fixes their number.
            frames.append(rows.head(len(rows) // len(group) * len(set(group))))
            finished += specs[0].steps * len(set(group))
    frame = with_not_applied(pl.concat(frames).with_columns(task=pl.lit(spec.name)), conditions)
    baselines = {(label, train_seed(policy)): Baseline(policy.reference, idle)}
    return ExtrapolationResult(judge_table(frame, make_scales(baselines, spec.name)), None, baselines=baselines)
