"""Run a whole evaluation: groups of lanes on several cores, resumable, with one table at the end."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.envs import make_world, refuse_import
from perdure.envs.source import source_digest
from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.evaluate import evaluate_lanes
from perdure.extrapolate.idle import idle_unit, read_idle
from perdure.extrapolate.lanes import FIRST_EVAL_SEED, Extrapolation, LaneSpec, split
from perdure.extrapolate.result import TABLE, ExtrapolationResult, file_note
from perdure.extrapolate.score import ScoreScale, make_score_scale, task_rate
from perdure.extrapolate.table import judge_table, lane_table, method_label, train_seed
from perdure.horizon import HorizonError, clock_from_json
from perdure.policy import Policy, check_fit, find_policy, load_policy, measure_reference, save_policy
from perdure.report.schema import SCHEMA_VERSION
from perdure.runs import (
    Observer,
    Store,
    StoreError,
    Unit,
    Work,
    check_on,
    config_digest,
    core_count,
    file_digest,
    run_missing,
    write_result,
)
from perdure.schema import Anything, Items, Parquet, SchemaError, Table, Text, Whole, printable

if TYPE_CHECKING:
    import polars as pl

MEASURED = "policy.safetensors"
REFERENCES = "references"
"""Folder of the store that keeps reference episodes of policies whose files hold none."""
GROUP = Table({"lanes": Items(Items(Anything(3), 3, 3))}, others=Anything(3))
"""What the record of a group says; a lane is the SHA-256 of its policy file, a clock or null, an evaluation seed."""
GROUPS = "groups"
"""Folder of the store that keeps finished groups of lanes."""


def extrapolate(
    evaluation: Extrapolation,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "local",
    command: str = "",
    observe: Observer = lambda status: None,
    waiting: Callable[[], None] = lambda: None,
) -> ExtrapolationResult:
    """Evaluate every lane and write ``lanes.parquet`` into ``out``.

    Finished lanes are kept in ``out``. An interrupted evaluation resumes, and one with more clocks or start states runs
    only the new lanes. Results do not depend on the number of cores.

    Args:
        evaluation: What is evaluated.
        out: A folder; made if it is missing.
        cores: Cores to use; all of them by default.
        on: Where lanes run: "here", "local", "ray" or "ray:ADDRESS", see `perdure.runs.make_workers`.
        command: Command line, stored with the table.
        observe: Called with the progress of every group of lanes, in steps of single lanes.
        waiting: Called once before waiting, if another evaluation into ``out`` is running.

    Raises:
        ExtrapolationError: If the policies do not belong to one task.
        RunError: If a group of lanes failed, or ``cores`` or ``on`` is out of range.
        PolicyFileError: If a policy file cannot be read.
        OSError: If ``out`` cannot be written.
    """
    check_on(on)
    workers = core_count(cores)
    evaluation = _with_files(evaluation)
    policies = [load_policy(path) for path in evaluation.policies]
    for path, policy in zip(evaluation.policies, policies, strict=True):
        refuse_import(policy.task.name, evaluation.modules, str(path))
    _check(policies)
    Path(out).mkdir(parents=True, exist_ok=True)  # fails before the work begins
    lanes = _plan(evaluation, policies)
    digests = [file_digest(path) for path in evaluation.policies]
    for number, (path, digest) in enumerate(zip(evaluation.policies, digests, strict=True)):
        if digest in digests[:number]:
            first = evaluation.policies[digests.index(digest)]
            raise ExtrapolationError(f"{first} and {path} hold the same policy: name only one of them")
    store = Store(out)
    with store.exclusive("extrapolate", waiting):
        versions = _versions(policies[0].task.name)
        finished = _finished(store, evaluation.steps, versions)
        kept = {lane: finished[lane] for each in lanes if (lane := _identity(each, digests)) in finished}
        missing = [lane for lane in lanes if _identity(lane, digests) not in kept]
        measurements = _measurements(policies, evaluation.policies, digests, versions)
        unmeasured = [unit for unit in measurements if not store.done(unit.key, unit.config)]
        units = [*unmeasured, *_units(missing, evaluation, digests, workers, versions)]
        store.warn_of_other_source(dict.fromkeys(kept.values()))
        run_missing(units, out, on, cores, observe)
        frame = _table(store, evaluation, policies, lanes, digests, versions)
        from perdure.report import write_table

        labels, seeds = policy_labels(evaluation.policies, policies), map(train_seed, policies)
        files = dict(zip(map(file_note, labels, seeds), digests, strict=True))
        return ExtrapolationResult(frame, write_table(Path(out) / TABLE, frame, {"command": command, **files}), files)


def read_lanes(evaluation: Extrapolation, out: str | Path) -> pl.DataFrame:
    """Return the table of an evaluation whose lanes are all in ``out``; simulate and write nothing.

    Raises:
        StoreError: If a lane is missing.
        PolicyFileError: If a policy file cannot be read.
    """
    store, evaluation = Store(out), _with_files(evaluation)
    policies = [load_policy(path) for path in evaluation.policies]
    digests = [file_digest(path) for path in evaluation.policies]
    return _table(
        store,
        evaluation,
        policies,
        _plan(evaluation, policies),
        digests,
        _stored_versions(store, policies[0].task.name),
    )


def _with_files(evaluation: Extrapolation) -> Extrapolation:
    """Return the evaluation with the file of each policy in place of a folder or a name."""
    return replace(evaluation, policies=tuple(map(find_policy, evaluation.policies)))


def finished_lanes(out: str | Path, steps: int, task: str) -> set[Identity]:
    """Return the lanes of a task in ``out``, of so many steps, that `read_lanes` can read."""
    store = Store(out)
    return set(_finished(store, steps, _stored_versions(store, task)))


def _table(
    store: Store,
    evaluation: Extrapolation,
    policies: Sequence[Policy],
    lanes: Sequence[LaneSpec],
    digests: Sequence[str],
    versions: Versions,
) -> pl.DataFrame:
    finished = _finished(store, evaluation.steps, versions)
    wanted = [_identity(lane, digests) for lane in lanes]
    if missing := [lane for lane in wanted if lane not in finished]:
        raise StoreError(f"{len(missing)} of {len(lanes)} lanes are not in {store.root}")
    groups = list(dict.fromkeys(finished[lane] for lane in wanted))
    frame = _collect(store, groups, lanes, digests, policy_labels(evaluation.policies, policies))
    score_scales = _score_scales(store, policies, digests, versions)
    return judge_table(frame, [score_scales[lane.policy] for lane in lanes])


def policy_labels(paths: Sequence[Path], policies: Sequence[Policy]) -> list[str]:
    """Return a short name for each policy: its method and preset, and what else distinguishes it."""
    labels = [method_label(policy, printable(path.stem)) for path, policy in zip(paths, policies, strict=True)]
    seeds = [train_seed(policy) for policy in policies]
    if len(set(zip(labels, seeds, strict=True))) == len(labels):
        return labels
    short = [f"{label} ({path.parent.name}/{path.stem})" for label, path in zip(labels, paths, strict=True)]
    whole = [f"{label} ({path})" for label, path in zip(labels, paths, strict=True)]
    return [printable(name) for name in (short if len(set(short)) == len(short) else whole)]


def _check(policies: Sequence[Policy]) -> None:
    names = sorted({policy.task.name for policy in policies})
    if len(names) > 1:
        raise ExtrapolationError(
            f"all policies of one evaluation must be for one task, these are for {', '.join(names)}"
        )
    world = make_world(names[0], [FIRST_EVAL_SEED])
    try:
        for policy in policies:
            check_fit(policy, world)
    finally:
        world.close()


Identity = tuple[str, str, int]
"""What a lane's result depends on besides steps and versions: policy file, clock, evaluation seed."""


def _plan(evaluation: Extrapolation, policies: Sequence[Policy]) -> list[LaneSpec]:
    lanes = [
        LaneSpec(number, clock, seed)
        for number, policy in enumerate(policies)
        for clock in ((None,) if policy.protocol.embedding is None else evaluation.deployment_clocks(policy.clock))
        for seed in evaluation.seeds
    ]
    if not lanes:
        raise ExtrapolationError("no lane to evaluate: these clocks fit none of the policies")
    return lanes


def _identity(lane: LaneSpec, digests: Sequence[str]) -> Identity:
    return digests[lane.policy], "none" if lane.clock is None else lane.clock.label, lane.eval_seed


Versions = dict[str, str]
"""Of what a lane was computed with."""


def _versions(task: str) -> Versions:
    """Return what the lanes of a task depend on: for Gymnasium's also MuJoCo, and the module that defines the task."""
    names = ("perdure", "envpool", "gymnasium", "numpy")
    found = {name: version(name) for name in names}
    if not task.startswith("gymnasium:"):
        return found
    return {**found, "mujoco": version("mujoco"), **source_digest(task)}


def _stored_versions(store: Store, task: str) -> Versions:
    """Return the installed versions if a lane was computed with them, otherwise those of most groups."""
    found = [json.dumps(store.config(key).get("versions"), sort_keys=True) for key in store.keys(GROUPS)]
    installed = json.dumps(_versions(task), sort_keys=True)
    chosen: Versions = json.loads(installed if installed in found or not found else max(found, key=found.count))
    return chosen


def _units(
    lanes: Sequence[LaneSpec],
    evaluation: Extrapolation,
    digests: Sequence[str],
    workers: int,
    versions: Versions,
) -> Iterator[Unit]:
    """Split lanes into groups, one unit each."""
    for group in split(lanes, evaluation.max_lanes, workers) if lanes else ():
        written = [
            [digests[lane.policy], None if lane.clock is None else lane.clock.to_json(), lane.eval_seed]
            for lane in group
        ]
        config = {"table": SCHEMA_VERSION, "steps": evaluation.steps, "versions": versions, "lanes": written}
        paths = {digests[number]: str(path.resolve()) for number, path in enumerate(evaluation.policies)}
        yield Unit(
            f"{GROUPS}/{config_digest(config)[:16]}",
            config,
            "perdure.extrapolate.run:evaluate_group",
            {"policies": paths, "lanes": written, "steps": evaluation.steps},
            size=float(len(group) * evaluation.steps),
        )


def _finished(store: Store, steps: int, versions: Versions) -> dict[Identity, str]:
    """Return every lane that is in the store already, and the key of its group."""
    found: dict[Identity, str] = {}
    for key in store.keys(GROUPS):
        config = store.config(key)
        if (config.get("table"), config.get("steps"), config.get("versions")) != (SCHEMA_VERSION, steps, versions):
            continue
        try:
            GROUP.check(config)
            for digest, clock, seed in config["lanes"]:
                Text(64).check(digest, "lanes")
                Whole().check(seed, "lanes")
                found[digest, "none" if clock is None else clock_from_json(clock).label, seed] = key
        except (SchemaError, HorizonError) as error:
            raise StoreError(f"the group of lanes {key} in {store.root} cannot be read: {error}") from error
    return found


def _reference_unit(digest: str, versions: Versions, path: Path = Path()) -> Unit:
    config = {"policy": digest, "versions": versions}
    arguments = {"path": str(path.resolve())}
    function = "perdure.extrapolate.run:measure_policy"
    return Unit(f"{REFERENCES}/{config_digest(config)[:16]}", config, function, arguments, size=20_000.0)


def _measurements(
    policies: Sequence[Policy], paths: Sequence[Path], digests: Sequence[str], versions: Versions
) -> Iterator[Unit]:
    """Yield the units that verdicts need: the idle robot, and reference episodes that are missing in policy files."""
    yield idle_unit(policies[0].task.name, versions)
    for policy, path, digest in zip(policies, paths, digests, strict=True):
        if policy.reference is None:
            yield _reference_unit(digest, versions, path)


def measure_policy(work: Work, *, path: str) -> None:
    """Write the policy with its reference episodes in the work folder."""
    policy = load_policy(path)
    save_policy(replace(policy, reference=measure_reference(policy)), work.folder / MEASURED)


def _score_scales(
    store: Store, policies: Sequence[Policy], digests: Sequence[str], versions: Versions
) -> list[ScoreScale]:
    task = policies[0].task.name
    idle = read_idle(store.get(idle_unit(task, versions).key))
    found = []
    for policy, digest in zip(policies, digests, strict=True):
        reference = policy.reference
        if reference is None:
            reference = load_policy(store.get(_reference_unit(digest, versions).key) / MEASURED).reference
            assert reference is not None
        found.append(make_score_scale(reference, idle, task_rate(task)))
    return found


def evaluate_group(work: Work, *, policies: Mapping[str, str], lanes: Sequence[Sequence[Any]], steps: int) -> None:
    """Evaluate a group of lanes and write its table to the work folder; the function of an evaluation's units."""
    if (work.folder / TABLE).is_file():  # an attempt that was interrupted between its last two steps
        return
    used = list(dict.fromkeys(digest for digest, _, _ in lanes))
    for digest in used:
        if file_digest(Path(policies[digest])) != digest:
            raise ExtrapolationError(f"{policies[digest]} has changed since this evaluation began")
    loaded = [load_policy(policies[digest]) for digest in used]
    specs = [
        LaneSpec(used.index(digest), None if clock is None else clock_from_json(clock), seed)
        for digest, clock, seed in lanes
    ]

    def progress(step: int, running: int) -> None:
        ended = len(specs) - running  # these need no more steps
        work.report(step * running + steps * ended, steps * len(specs))

    records = evaluate_lanes(loaded, specs, steps, progress)
    buffer = io.BytesIO()
    lane_table(used, loaded, specs, records, steps).write_parquet(buffer)
    write_result(work.folder / TABLE, buffer.getvalue())


def _collect(
    store: Store, keys: Sequence[str], lanes: Sequence[LaneSpec], digests: Sequence[str], labels: Sequence[str]
) -> pl.DataFrame:
    """Return the rows of these lanes in their order, policies by their labels."""
    import polars as pl

    label_column, identity = pl.Series("label", labels), ("policy", "clock", "eval_seed")
    wanted = pl.DataFrame([_identity(lane, digests) for lane in lanes], list(identity), orient="row")
    wanted = wanted.with_columns(label_column[[lane.policy for lane in lanes]]).with_row_index("lane")
    try:
        files = [Parquet((store.get(key) / TABLE).read_bytes()) for key in keys]
        names = [name for name in files[0].columns if name != "policy"]
        found = pl.concat([file.read([*identity, "step"]) for file in files])
    except (SchemaError, pl.exceptions.PolarsError) as error:
        raise StoreError(f"groups of lanes in {store.root} are damaged: remove its folder {GROUPS}") from error
    found = found.join(wanted, identity, "left", maintain_order="left")
    order = found.select(pl.arg_sort_by("lane", "step", nulls_last=True)).to_series()
    order = order[: len(found) - found["lane"].null_count()]
    if found["lane"].n_unique() - (len(order) < len(found)) < len(lanes):
        raise StoreError(f"groups of lanes in {store.root} are damaged: remove its folder {GROUPS}")
    policies = found["label"].gather(order).alias("policy")
    del found
    # Column by column: a table of a million rows is never held twice.
    columns = (pl.concat([file.read([name]) for file in files])[name].gather(order) for name in names)
    return pl.DataFrame([policies, *columns])
