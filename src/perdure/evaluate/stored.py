"""Evaluate policy files and ONNX models over several cores; what is finished is kept in a folder and used again."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.disturbances import parse_disturbance
from perdure.envs import OpenEnv, TaskSpec, make_world, refuse_import, report_success, task_of_environment
from perdure.envs.disturbances import disturbed_task
from perdure.envs.suites import ENVPOOL_PREFIX, GYMNASIUM_PREFIX, is_contract, task_source_digest
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, Condition, EpisodeSpec, Extrapolation, evaluate_episodes, split
from perdure.evaluate.judge import Baseline, PolicyKey, judge_table, make_scales, write_baselines
from perdure.evaluate.reference import idle_unit, load_reference, read_idle, save_reference, task_env, with_reference
from perdure.evaluate.table import (
    TABLE,
    ExtrapolationResult,
    episode_table,
    file_note,
    made_with,
    method_label,
    train_seed,
    with_not_applied,
)
from perdure.horizon import Clock
from perdure.policy import FunctionPolicy, Policy, PolicyLike, TaskInfo, check_fit, find_policy, load_policy
from perdure.policy.onnx import OnnxModel, is_onnx, model_digest
from perdure.policy.reference import resolve_training_horizon
from perdure.report.schema import RAW_VERSION
from perdure.runs import (
    Observer,
    Store,
    Unit,
    Work,
    check_on,
    config_digest,
    core_count,
    run_missing,
    versions,
    write_atomic,
)
from perdure.schema import Parquet, checked, parquet_bytes, printable

if TYPE_CHECKING:
    import polars as pl

REFERENCES = "references"
"""Folder of the store that keeps reference episodes of policies whose files hold none."""
GROUPS = "groups"
"""Folder of the store that keeps finished groups of episodes. A group's config has its condition, and of each episode
the identity of its policy, a clock or null, and an evaluation seed."""
REPLACED = "{} holds another evaluation, which would be replaced: name another folder with --out (out=), or remove it"


def load(path: Path) -> Policy | OnnxModel:
    """Return what is in a policy file or an ONNX model."""
    return OnnxModel.load(path) if is_onnx(path) else load_policy(path)


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
        horizon, recurrent = horizon or function.training_horizon, bool(function.state)
    world = source.make([FIRST_EVAL_SEED] * (source.lanes or 1))
    spec, spaces = world.spec, world.spaces
    world.close()
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


def run_episodes(
    labels: Sequence[str],
    policies: Sequence[PolicyLike],
    episodes: Sequence[EpisodeSpec],
    report: Callable[[float, float], None],
    world: Any = None,
    success: str | None = None,
) -> pl.DataFrame:
    """Return the table of a group of episodes of one condition, without verdicts."""
    steps = episodes[0].steps

    def progress(step: int, running: int) -> None:
        ended = len(episodes) - running  # these need no more steps
        report(step * running + steps * ended, steps * len(episodes))

    records = evaluate_episodes(policies, episodes, progress, world, success)
    return episode_table(labels, policies, episodes, records)


def plan(
    evaluation: Extrapolation, policies: Sequence[PolicyLike], conditions: Sequence[Condition]
) -> list[EpisodeSpec]:
    """Return the episodes of an evaluation, one condition after the other; PerdureError if a policy has none."""

    def clocks(policy: PolicyLike, steps: int) -> tuple[Clock | None, ...]:
        own = getattr(policy, "clock", None)
        return evaluation.deployment_clocks(own, steps) if policy.has_clock else (None,)

    first = evaluation.first_eval_seed
    episodes = [
        EpisodeSpec(number, clock, seed, each.disturbances, each.steps, each.label)
        for each in conditions
        for number, policy in enumerate(policies)
        for clock in clocks(policy, each.steps)
        for seed in range(first, first + each.eval_seeds)
    ]
    if len({each.policy for each in episodes}) < len(policies):
        raise PerdureError("a function or an ONNX model stores no clock; name one, such as constant:500")
    return episodes


@dataclass(frozen=True)
class _PolicyFile:
    """A policy file or an ONNX model; `read_file` reads it again in another process."""

    path: Path
    digest: str
    """SHA-256 of the file; see `perdure.policy.onnx.model_digest`."""
    identity: str
    """What results depend on besides clock, evaluation seed, steps and versions: the digest of a policy file."""
    policy: PolicyLike
    task: str
    success: str | None
    """See `Extrapolation`. Reference episodes that the file holds were measured without it: they do not count then."""

    def arguments(self) -> dict[str, Any]:
        horizon = int(self.policy.training_horizon) if is_onnx(self.path) else None
        return {"path": str(self.path.absolute()), "digest": self.digest, "task": self.task, "horizon": horizon}

    def reference_unit(self, versions: Versions) -> Unit:
        """Return the unit that measures the reference episodes which the file does not hold."""
        named = {} if self.success is None else {"success": self.success}
        config = {"policy": self.identity, "versions": versions, "format": 2, **named}
        key, function = f"{REFERENCES}/{config_digest(config)[:16]}", f"{__name__}:measure_file"
        return Unit(key, config, function, {"file": self.arguments(), **named}, size=20_000.0)


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


def _files(evaluation: Extrapolation) -> list[_PolicyFile]:
    """Read every policy of an evaluation, and refuse what cannot be evaluated together."""
    models = list(map(is_onnx, evaluation.policies))
    if evaluation.env is None and any(models):
        raise PerdureError("an ONNX model needs its environment: --env Hopper-v5 (env=)")
    if not any(models) and (evaluation.env, evaluation.training_horizon) != (None, None):
        raise PerdureError("env and training_horizon are for ONNX models; a policy file names its own")
    files = list[_PolicyFile]()
    for given, model in zip(evaluation.policies, models, strict=True):
        path = given if model else find_policy(given)
        task = task_of_environment(evaluation.env) if model and evaluation.env is not None else ""
        if not path.is_file():
            load(path)  # raises what is wrong
        digest = model_digest(path)
        policy = read_file(path, digest, task, evaluation.training_horizon)
        identity = digest
        if model:
            parts = {"model": digest, "task": task, "horizon": policy.training_horizon}
            identity = config_digest({**parts, "onnxruntime": version("onnxruntime")})
        for other in files:
            if other.identity == identity:
                raise PerdureError(f"{other.path} and {path} hold the same policy: name only one of them")
        if evaluation.success is not None and isinstance(policy, Policy):
            policy = replace(policy, reference=None)
        files.append(_PolicyFile(path, digest, identity, policy, policy.task.name, evaluation.success))
    tasks = sorted({file.task for file in files})
    if len(tasks) > 1:
        robot, *others = {task.removeprefix(GYMNASIUM_PREFIX) for task in tasks}
        way_out = (
            f"; for EnvPool's, read models with --env {ENVPOOL_PREFIX}{robot}; for Gymnasium's, train in {tasks[-1]}"
        )
        raise PerdureError(
            f"all policies of one evaluation must be for one task, these are for {', '.join(tasks)}"
            f"{'' if others else way_out}"
        )
    return files


def _refuse_replacing(root: Path, files: Sequence[_PolicyFile], episodes: Sequence[EpisodeSpec], success: str) -> None:
    """Refuse to replace a table that has episodes of other files or settings than those asked for."""
    if not (root / TABLE).exists():
        return
    asked = set[tuple[Any, ...]]()
    for each in episodes:
        file, clock = files[each.policy], "none" if each.clock is None else each.clock.label
        settings = file.task, float(file.policy.training_horizon), each.steps, clock, each.eval_seed, each.disturbance
        asked.add((file.digest, success, *settings))
    columns = ("policy", "train_seed", "task", "train_horizon", "test_horizon", "clock", "eval_seed", "disturbance")
    try:
        table = Parquet((root / TABLE).read_bytes())
        rows, notes = table.read(columns).unique().iter_rows(), table.notes
        kept = {
            (notes.get(file_note(policy, seed)), notes.get("success", ""), *others) for policy, seed, *others in rows
        }
    except PerdureError:  # of another version, or damaged
        kept = {()}
    if not kept <= asked:
        raise PerdureError(REPLACED.format(root))


def _check_task(files: Sequence[_PolicyFile], modules: Sequence[str], success: str | None) -> TaskSpec:
    """Return the task; refuse one that a policy file alone would import, and policies that do not fit it."""
    for file in files:
        if isinstance(file.policy, Policy):
            refuse_import(file.task, modules, str(file.path))
    with closing(make_world(files[0].task, [FIRST_EVAL_SEED])) as world:
        report_success(world, success)
        for file in files:
            check_fit(file.policy, world)
        return world.spec


def evaluate_files(
    evaluation: Extrapolation,
    out: str | Path | None = None,
    *,
    cores: int | None = None,
    on: str = "local",
    command: str = "",
    observe: Observer = lambda status: None,
    waiting: Callable[[], None] = lambda: None,
) -> ExtrapolationResult:
    """Evaluate every episode and write ``episodes.parquet`` into ``out``.

    Finished episodes are kept in ``out``. An interrupted evaluation resumes, and one with more clocks, start states or
    policies runs only the new episodes. Results do not depend on the number of cores.

    Args:
        evaluation: What is evaluated.
        out: A folder; made if it is missing. None keeps nothing.
        cores: Cores to use; all of them by default.
        on: Where episodes run: "here", "local", "ray" or "ray:ADDRESS", see `perdure.runs.make_workers`.
        command: Command line, stored with the table.
        observe: Called with the progress of every group of episodes, in steps of single episodes.
        waiting: Called once before waiting, if another evaluation into ``out`` is running.

    Raises:
        PerdureError: If the policies do not belong to one task, ``out`` holds the table of a function, a group of
            episodes failed, ``cores`` or ``on`` is out of range, or a policy file cannot be read.
        OSError: If ``out`` cannot be written.
    """
    check_on(on)
    workers = core_count(cores)
    files = _files(evaluation)
    spec = _check_task(files, evaluation.modules, evaluation.success)
    conditions = evaluation.conditions(
        spec, lambda disturbances: make_world(disturbed_task(spec.name, disturbances), [FIRST_EVAL_SEED])
    )
    episodes = plan(evaluation, [file.policy for file in files], conditions)
    with ExitStack() as stack:
        store = Store(stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out)
        stack.enter_context(store.exclusive("extrapolate", waiting))
        _refuse_replacing(store.root, files, episodes, evaluation.success or "")
        versions = _versions(files[0].task)
        setups = _setups(files[0].task, episodes, evaluation.success)
        finished = _finished(store, setups)
        kept = {episode: finished[episode] for each in episodes if (episode := _identity(each, files)) in finished}
        units = [idle_unit(files[0].task, versions)]
        units += [file.reference_unit(versions) for file in files if file.policy.reference is None]
        units = [unit for unit in units if not store.done(unit.key, unit.config)]
        before = tuple(units)
        missing = [episode for episode in episodes if _identity(episode, files) not in kept]
        for setup, mine in groupby(missing, key=_setup):
            group = split(list(mine), evaluation.max_episodes, workers)
            units += _units(group, setups[setup], files, versions, store, before)
        store.warn_of_other_source(dict.fromkeys(kept.values()))
        run_missing(units, store.root, on, cores, observe)
        finished, wanted = _finished(store, setups), [_identity(episode, files) for episode in episodes]
        if lost := [episode for episode in wanted if episode not in finished]:
            raise PerdureError(f"{len(lost)} of {len(episodes)} episodes are not in {store.root}")
        groups, labels = list(dict.fromkeys(finished[episode] for episode in wanted)), _labels(files)
        frame = _collect(store, groups, wanted, [labels[episode.policy] for episode in episodes])
        baselines = _baselines(store, files, labels, versions)
        frame = judge_table(with_not_applied(frame, conditions), make_scales(baselines, files[0].task))
        notes = {
            file_note(label, train_seed(file.policy)): file.digest for label, file in zip(labels, files, strict=True)
        }
        if out is None:
            return ExtrapolationResult(frame, None, notes, baselines)
        from perdure.report import write_table

        told = {"command": command, "success": evaluation.success or "", **made_with(), **notes}
        path = write_table(Path(out) / TABLE, frame, told | write_baselines(Path(out), baselines))
        return ExtrapolationResult(frame, path, notes, baselines)


def _baselines(
    store: Store, files: Sequence[_PolicyFile], labels: Sequence[str], versions: Versions
) -> dict[PolicyKey, Baseline]:
    """Return what the rewards of each policy are compared with, from finished units."""
    found = dict[PolicyKey, Baseline]()
    idle = read_idle(store.get(idle_unit(files[0].task, versions).key))
    for file, label in zip(files, labels, strict=True):
        policy = file.policy
        if policy.reference is None:
            policy = load_reference(policy, store.get(file.reference_unit(versions).key))
        assert policy.reference is not None
        found[label, train_seed(policy)] = Baseline(policy.reference, idle)
    return found


def _labels(files: Sequence[_PolicyFile]) -> list[str]:
    """Return a short name for each policy: its method and preset, and what else distinguishes it."""
    plain = [method_label(file.policy, printable(file.path.stem)) for file in files]
    short = [f"{label} ({file.path.parent.name}/{file.path.stem})" for label, file in zip(plain, files, strict=True)]
    whole = [f"{label} ({file.path})" for label, file in zip(plain, files, strict=True)]
    seeds = [train_seed(file.policy) for file in files]
    distinct = (each for each in (plain, short) if len(set(zip(each, seeds, strict=True))) == len(files))
    return list(map(printable, next(distinct, whole)))


Setup = tuple[str, int, tuple[str, ...]]
"""What the episodes of a condition share: its label, their steps, the labels of the disturbances that are applied."""
Setups = dict[Setup, dict[str, Any]]
"""To each of them what a group of its episodes has in its config, beside its episodes."""
Identity = tuple[str, str, int, Setup]
"""What an episode's result depends on besides versions: policy file, clock, evaluation seed, condition."""


def _setup(episode: EpisodeSpec) -> Setup:
    return episode.disturbance, episode.steps, tuple(each.label for each in episode.disturbances)


def _identity(episode: EpisodeSpec, files: Sequence[_PolicyFile]) -> Identity:
    clock = "none" if episode.clock is None else episode.clock.label
    return files[episode.policy].identity, clock, episode.eval_seed, _setup(episode)


def _setups(task: str, episodes: Sequence[EpisodeSpec], success: str | None = None) -> Setups:
    found = Setups()
    for setup, (each, *_) in groupby(episodes, key=_setup):
        label, steps, disturb = setup
        versions = _versions(disturbed_task(task, each.disturbances))
        shared = {"label": label, "steps": steps, "disturb": list(disturb), "success": success}
        found[setup] = {"table": RAW_VERSION, "versions": versions, **shared}
    return found


Versions = dict[str, str]
"""Of what an episode was computed with."""


def _versions(task: str) -> Versions:
    """Return what episodes of a task depend on: for Gymnasium's also MuJoCo, and the module or contract behind it."""
    if not task.startswith("gymnasium:") and not is_contract(task):
        return versions("envpool", "gymnasium", "numpy")
    return {**versions("envpool", "gymnasium", "numpy", "mujoco"), **task_source_digest(task)}


def _units(
    groups: Sequence[Sequence[EpisodeSpec]],
    shared: Mapping[str, Any],
    files: Sequence[_PolicyFile],
    versions: Versions,
    store: Store,
    before: Sequence[Unit],
) -> Iterator[Unit]:
    """Yield one unit for each group of episodes of one condition."""
    arguments = {file.identity: file.arguments() for file in files}
    after = list[str]()
    for file in files:
        if file.policy.reference is None:  # its observation noise depends on them
            unit = file.reference_unit(versions)
            arguments[file.identity]["reference"] = str(store.root / unit.key)
            after += [unit.key] if unit in before else []
    condition = {name: shared[name] for name in ("label", "steps", "disturb", "success")}
    for group in groups:
        written = [
            [files[each.policy].identity, None if each.clock is None else each.clock.to_json(), each.eval_seed]
            for each in group
        ]
        config = {**shared, "episodes": written}
        yield Unit(
            f"{GROUPS}/{config_digest(config)[:16]}",
            config,
            f"{__name__}:evaluate_group",
            {"files": arguments, "episodes": written, **condition},
            tuple(after),
            size=float(len(group) * shared["steps"]),
        )


def _finished(store: Store, setups: Setups) -> dict[Identity, str]:
    """Return every episode of these conditions that is in the store already, and the key of its group."""
    found: dict[Identity, str] = {}
    for key in store.keys(GROUPS):
        config = dict(store.config(key))
        episodes = config.pop("episodes", None)
        for setup in [setup for setup, shared in setups.items() if shared == config]:
            try:
                for identity, clock, seed in checked(episodes, list[tuple[str, Any, int]], "episodes"):
                    found[identity, "none" if clock is None else Clock.from_json(clock).label, seed, setup] = key
            except PerdureError as error:
                raise PerdureError(f"the group of episodes {key} in {store.root} cannot be read: {error}") from error
    return found


def measure_file(work: Work, *, file: Mapping[str, Any], success: str | None = None) -> None:
    """Write the reference episodes of a policy to the work folder; the function of a unit."""
    source, policy = task_env(file["task"], success), read_file(**file)
    policy = replace(policy, reference=None) if isinstance(policy, Policy) else policy
    save_reference(with_reference(policy, source), work.folder)


def evaluate_group(
    work: Work,
    *,
    files: Mapping[str, Mapping[str, Any]],
    episodes: Sequence[Sequence[Any]],
    steps: int,
    disturb: Sequence[str],
    label: str,
    success: str | None = None,
) -> None:
    """Evaluate a group of episodes and write its table to the work folder; the function of an evaluation's units."""
    if (work.folder / TABLE).is_file():  # an attempt that was interrupted between its last two steps
        return
    used, policies = list(dict.fromkeys(identity for identity, _, _ in episodes)), list[PolicyLike]()
    for identity in used:
        file = dict(files[identity])
        reference = file.pop("reference", None)
        policy = read_file(**file)
        policies.append(policy if reference is None else load_reference(policy, Path(reference)))
    disturbances = tuple(map(parse_disturbance, disturb))
    specs = [
        EpisodeSpec(
            used.index(identity), None if clock is None else Clock.from_json(clock), seed, disturbances, steps, label
        )
        for identity, clock, seed in episodes
    ]
    rows = run_episodes(used, policies, specs, work.report, success=success)
    write_atomic(work.folder / TABLE, parquet_bytes(rows))


def _collect(store: Store, keys: Sequence[str], episodes: Sequence[Identity], labels: Sequence[str]) -> pl.DataFrame:
    """Return the rows of these episodes in their order, policies by the label of each episode."""
    import polars as pl

    identity = ("policy", "clock", "eval_seed", "disturbance", "test_horizon")
    wanted = pl.DataFrame([(*each[:-1], *each[-1][:2]) for each in episodes], list(identity), orient="row")
    wanted = wanted.with_columns(label=pl.Series(labels))
    wanted = wanted.with_row_index("episode")
    try:
        files = [Parquet((store.get(key) / TABLE).read_bytes()) for key in keys]
        names = [name for name in files[0].columns if name != "policy"]
        found = pl.concat([file.read([*identity, "step"]) for file in files])
    except (PerdureError, pl.exceptions.PolarsError) as error:
        raise PerdureError(f"groups of episodes in {store.root} are damaged: remove its folder {GROUPS}") from error
    found = found.join(wanted, identity, "left", maintain_order="left")
    order = found.select(pl.arg_sort_by("episode", "step", nulls_last=True)).to_series()
    order = order[: len(found) - found["episode"].null_count()]
    if found["episode"].n_unique() - (len(order) < len(found)) < len(episodes):
        raise PerdureError(f"groups of episodes in {store.root} are damaged: remove its folder {GROUPS}")
    policies = found["label"].gather(order).alias("policy")
    del found
    # Column by column: a table of a million rows is never held twice.
    columns = (pl.concat([file.read([name]) for file in files])[name].gather(order) for name in names)
    return pl.DataFrame([policies, *columns])
