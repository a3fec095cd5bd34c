"""Groups of episodes as units of work, whose tables are kept in a store and used again.

Policies of files and of this process take the same way. What differs is where a group runs, and that only policy files
have an identity that a later process can check.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.disturbances import Disturbance
from perdure.envs import OpenEnv, World
from perdure.envs.disturbances import disturbed_task
from perdure.envs.suites import is_contract, task_source_digest
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, EpisodeSpec, evaluate_episodes, split
from perdure.evaluate.judge import Baseline, PolicyKey, other_engine
from perdure.evaluate.reference import idle_unit, load_reference, read_idle, save_reference, task_env, with_reference
from perdure.evaluate.table import TABLE_FILE, episode_table, train_seed
from perdure.policy import Policy, PolicyLike
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
from perdure.schema import Parquet, parquet_bytes

if TYPE_CHECKING:
    import polars as pl

REFERENCES = "references"
"""Folder of the store that keeps reference episodes of policies whose files hold none."""
GROUPS = "groups"
"""Folder of the store that keeps finished groups of episodes. A group's config has its condition, and of each episode
the identity of its policy, a clock or null, and an evaluation seed."""
Versions = dict[str, str]
"""Of what an episode was computed with."""


@dataclass(frozen=True)
class Execution:
    """Where an evaluation runs, where its results are kept, and who is told of its progress.

    Raises:
        PerdureError: If `cores` or `on` is out of range.
    """

    out: str | Path | None = None
    """Folder for the results; made if it is missing. None keeps nothing."""
    cores: int | None = None
    """Cores for policy files; all of them by default. What runs in this process runs on one."""
    on: str = "local"
    """Where policy files are evaluated: "here", "local", "ray" or "ray:ADDRESS", see `perdure.runs.make_workers`."""
    command: str = ""
    """Command line, stored with the table."""
    observe: Observer = lambda status: None
    """Called with the progress of every group of episodes, in steps of single episodes."""
    waiting: Callable[[], None] = lambda: None
    """Called once before waiting, if another evaluation into `out` is running."""
    stop_early: bool = False
    """End as soon as it is certain that a policy does not hold, see `perdure.evaluate.early`."""

    def __post_init__(self) -> None:
        check_on(self.on)
        core_count(self.cores)


@dataclass(frozen=True)
class Source:
    """A policy, as a process that runs its episodes gets it. That of a file can be pickled."""

    identity: str
    """What results depend on besides clock, evaluation seed, steps and versions: the digest of a policy file."""
    load: Callable[[], PolicyLike]
    """Returns the policy."""


@dataclass(frozen=True)
class Subject:
    """A policy that is evaluated."""

    policy: PolicyLike
    source: Source
    label: str
    """Its name in the table."""
    digest: str | None = None
    """SHA-256 of its file; None: it is none of a file."""


@dataclass(frozen=True)
class Worlds:
    """Builds the worlds of the environment in which policies are evaluated."""

    task: str
    """Name of the environment."""
    opened: OpenEnv | None = None
    """What builds an environment of the caller, which has no name that `make_world` takes; it cannot be pickled."""
    success: str | None = None
    """See `Extrapolation`."""

    def open(self, disturbances: Sequence[Disturbance] = ()) -> OpenEnv:
        """Return what builds worlds that take these disturbances, or raise PerdureError."""
        if self.opened is not None:
            return self.opened
        return task_env(disturbed_task(self.task, disturbances), self.success)

    def first(self, disturbances: Sequence[Disturbance] = ()) -> World:
        """Return the smallest world that takes these disturbances."""
        source = self.open(disturbances)
        return source.make([FIRST_EVAL_SEED] * (source.lanes or 1))

    def versions(self, disturbances: Sequence[Disturbance] = ()) -> Versions:
        """Return what episodes depend on: for Gymnasium's also MuJoCo, and the module or contract behind the task."""
        if self.opened is not None:
            return {}  # they are kept for no other process
        task = disturbed_task(self.task, disturbances)
        if not task.startswith("gymnasium:") and not is_contract(task):
            return versions("envpool", "gymnasium", "numpy")
        return {**versions("envpool", "gymnasium", "numpy", "mujoco"), **task_source_digest(task)}


def clock_label(episode: EpisodeSpec) -> str:
    """Return how tables name the clock of an episode."""
    return "none" if episode.clock is None else episode.clock.label


def _condition(episode: EpisodeSpec) -> tuple[str, int, tuple[Disturbance, ...]]:
    """Return what the episodes of a group share."""
    return episode.disturbance, episode.steps, episode.disturbances


class Groups:
    """The episodes of an evaluation in a store, in groups that share a condition."""

    def __init__(
        self, subjects: Sequence[Subject], worlds: Worlds, store: Store, episodes: Sequence[EpisodeSpec]
    ) -> None:
        self._subjects = subjects
        self._worlds = worlds
        self._store = store
        self._episodes = episodes
        self._versions = worlds.versions()
        self._configs: dict[Any, dict[str, Any]] = {}
        for condition, (first, *_) in groupby(episodes, key=_condition):
            self._configs[condition] = _condition_config(first, worlds)

    def run(self, max_episodes: int, execution: Execution, keep_going: bool) -> None:
        """Run what is not finished.

        Args:
            max_episodes: See `Extrapolation`.
            execution: Where.
            keep_going: Whether a failure ends only what depends on it.
        """
        # Measurements come first: observation noise depends on the reference episodes.
        idle = self._idle_unit()
        units = [] if self._store.done(idle.key, idle.config) else [idle]
        references = [unit for unit in self._reference_units() if not self._store.done(unit.key, unit.config)]
        units += references
        after = tuple(unit.key for unit in references)
        # Then the episodes that no group in the store holds.
        finished = self._finished()
        keys = [self._key(episode) for episode in self._episodes]
        missing = [episode for episode, key in zip(self._episodes, keys, strict=True) if key not in finished]
        size = self._worlds.open().lanes or max_episodes
        for _, same in groupby(missing, key=_condition):
            for group in split(list(same), size, core_count(execution.cores)):
                units.append(self._group_unit(group, after))
        self._store.warn_of_other_source(dict.fromkeys(finished[key] for key in keys if key in finished))
        run_missing(units, self._store.root, execution.on, execution.cores, execution.observe, keep_going=keep_going)

    def baselines(self, engine: str) -> dict[PolicyKey, Baseline]:
        """Return what the rewards of each policy are compared with; `engine`: what it is judged in."""
        idle = read_idle(self._store.get(self._idle_unit().key))
        found = dict[PolicyKey, Baseline]()
        for subject in self._subjects:
            reference = subject.policy.reference
            if reference is None:
                folder = self._store.get(self._reference_unit(subject).key)
                reference = load_reference(subject.policy, folder).reference
            assert reference is not None
            trained = str(subject.policy.provenance.get("engine", ""))
            found[subject.label, train_seed(subject.policy)] = Baseline(reference, idle, other_engine(trained, engine))
        return found

    def table(self) -> pl.DataFrame:
        """Return the rows of all episodes in their order."""
        finished = self._finished()
        keys = [self._key(episode) for episode in self._episodes]
        lost = sum(key not in finished for key in keys)
        if lost:
            raise PerdureError(f"{lost} of {len(keys)} episodes are not in {self._store.root}")
        rows = []
        for episode in self._episodes:
            subject = self._subjects[episode.policy]
            settings = (clock_label(episode), episode.eval_seed, episode.disturbance, episode.steps)
            rows.append((subject.source.identity, *settings, subject.label))
        return _collect(self._store, list(dict.fromkeys(finished[key] for key in keys)), rows)

    def _row(self, episode: EpisodeSpec) -> list[Any]:
        """Return what the config of a group says of an episode."""
        clock = None if episode.clock is None else episode.clock.to_json()
        return [self._subjects[episode.policy].source.identity, clock, episode.eval_seed]

    def _key(self, episode: EpisodeSpec) -> str:
        return _episode_key(self._configs[_condition(episode)], self._row(episode))

    def _finished(self) -> dict[str, str]:
        """Return the key of each episode that the store holds under these conditions, and the key of its group."""
        found: dict[str, str] = {}
        wanted = list(self._configs.values())
        for group in self._store.keys(GROUPS):
            config = self._store.config(group)
            rows = config.pop("episodes", None)
            if config in wanted:
                if not isinstance(rows, list):
                    raise PerdureError(f"the group of episodes {group} in {self._store.root} cannot be read: {rows!r}")
                found |= {_episode_key(config, row): group for row in rows}
        return found

    def _idle_unit(self) -> Unit:
        return idle_unit(self._worlds.task, self._versions, self._worlds.opened)

    def _reference_units(self) -> Iterator[Unit]:
        return (self._reference_unit(each) for each in self._subjects if each.policy.reference is None)

    def _reference_unit(self, subject: Subject) -> Unit:
        """Return the unit that measures the reference episodes which a file does not hold, or a function has."""
        config: dict[str, Any] = {"policy": subject.source.identity, "versions": self._versions, "format": 2}
        if self._worlds.success is not None:
            config["success"] = self._worlds.success
        key = f"{REFERENCES}/{config_digest(config)[:16]}"
        arguments = {"source": subject.source, "worlds": self._worlds}
        return Unit(key, config, f"{__name__}:measure_policy", arguments, size=20_000.0)

    def _group_unit(self, group: Sequence[EpisodeSpec], after: tuple[str, ...]) -> Unit:
        """Return the unit that evaluates episodes of one condition."""
        used = list(dict.fromkeys(each.policy for each in group))
        references: list[Path | None] = []
        for number in used:
            subject = self._subjects[number]
            measured = subject.policy.reference is None
            references.append(self._store.root / self._reference_unit(subject).key if measured else None)
        config = {**self._configs[_condition(group[0])], "episodes": [self._row(each) for each in group]}
        arguments = {
            "sources": [self._subjects[number].source for number in used],
            "references": references,
            "episodes": [replace(each, policy=used.index(each.policy)) for each in group],
            "worlds": self._worlds,
        }
        key = f"{GROUPS}/{config_digest(config)[:16]}"
        size = float(len(group) * group[0].steps)
        return Unit(key, config, f"{__name__}:evaluate_group", arguments, after, size=size)


def _condition_config(episode: EpisodeSpec, worlds: Worlds) -> dict[str, Any]:
    """Return the config of groups whose episodes share the condition of this one, without their episodes."""
    return {
        "table": RAW_VERSION,
        "versions": worlds.versions(episode.disturbances),
        "label": episode.disturbance,
        "steps": episode.steps,
        "disturb": [each.label for each in episode.disturbances],
        "success": worlds.success,
    }


def _episode_key(config: Mapping[str, Any], row: Any) -> str:
    """Return what an episode's result depends on, as text: its condition, and its row in the config of a group."""
    text = json.dumps([config, row])
    return json.dumps(json.loads(text, parse_int=float), sort_keys=True)  # constant:500 is constant:500.0


def measure_policy(work: Work, *, source: Source, worlds: Worlds) -> None:
    """Write the reference episodes of a policy to the work folder; the function of a unit."""
    policy = source.load()
    if isinstance(policy, Policy):
        policy = replace(policy, reference=None)
    save_reference(with_reference(policy, worlds.open()), work.folder)


def evaluate_group(
    work: Work,
    *,
    sources: Sequence[Source],
    references: Sequence[Path | None],
    episodes: Sequence[EpisodeSpec],
    worlds: Worlds,
) -> None:
    """Evaluate a group of episodes and write its table to the work folder; the function of an evaluation's units.

    Args:
        work: Of the unit.
        sources: The policies; `EpisodeSpec.policy` is an index into them.
        references: Folder with the reference episodes of each, None where the policy holds them.
        episodes: Of one condition.
        worlds: Where they act.
    """
    if (work.folder / TABLE_FILE).is_file():  # an attempt that was interrupted between its last two steps
        return
    policies = []
    for source, reference in zip(sources, references, strict=True):
        policy = source.load()
        policies.append(policy if reference is None else load_reference(policy, reference))
    # Where the caller's environment fixes the number of lanes, the last episode is repeated.
    steps = episodes[0].steps
    opened = worlds.open(episodes[0].disturbances)
    repeated = [episodes[-1]] * ((opened.lanes or 0) - len(episodes))
    lanes = [*episodes, *repeated]

    def progress(step: int, running: int) -> None:
        ended = len(lanes) - running  # these need no more steps
        work.report(step * running + steps * ended, steps * len(lanes))

    with closing(opened.make([FIRST_EVAL_SEED + each.eval_seed for each in lanes])) as world:
        records = evaluate_episodes(policies, lanes, progress, world, worlds.success)
    rows = episode_table([each.identity for each in sources], policies, lanes, records)
    rows = rows.head(len(rows) // len(lanes) * len(episodes))
    write_atomic(work.folder / TABLE_FILE, parquet_bytes(rows))


def _collect(store: Store, groups: Iterable[str], episodes: Sequence[tuple[Any, ...]]) -> pl.DataFrame:
    """Return the rows of episodes in their order, with the label of each policy instead of its identity.

    Args:
        store: Holds the groups.
        groups: Their keys.
        episodes: (identity, clock, evaluation seed, disturbance, steps, label) of each.
    """
    import polars as pl

    damaged = f"groups of episodes in {store.root} are damaged: remove its folder {GROUPS}"
    identity = ["policy", "clock", "eval_seed", "disturbance", "test_horizon"]
    wanted = pl.DataFrame(episodes, [*identity, "label"], orient="row").with_row_index("episode")
    try:
        files = [Parquet((store.get(key) / TABLE_FILE).read_bytes()) for key in groups]
        found = pl.concat([file.read([*identity, "step"]) for file in files])
    except (PerdureError, pl.exceptions.PolarsError) as error:
        raise PerdureError(damaged) from error
    # Rows of other episodes, which share a group with these, come last and are cut off.
    found = found.join(wanted, identity, "left", maintain_order="left")
    others = found["episode"].null_count()
    order = found.select(pl.arg_sort_by("episode", "step", nulls_last=True)).to_series()
    order = order[: len(found) - others]
    if found["episode"].drop_nulls().n_unique() < len(episodes):
        raise PerdureError(damaged)
    policies = found["label"].gather(order).alias("policy")
    del found
    # Column by column: a table of a million rows is never held twice.
    names = [name for name in files[0].columns if name != "policy"]
    columns = (pl.concat([file.read([name]) for file in files])[name].gather(order) for name in names)
    return pl.DataFrame([policies, *columns])
