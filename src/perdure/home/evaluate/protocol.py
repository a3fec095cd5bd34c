"""The benchmark's protocol: episodes x training seeds x evaluation seeds of one task and strategy, resumable."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal, Self

from perdure.errors import PerdureError
from perdure.home.agents.release import HandOver
from perdure.home.evaluate.disturbances import home_labels
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.files import write_logs
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.policies import (
    ORACLE,
    ReleaseChoice,
    SkillPolicy,
    choose_policies,
    make_agents,
    read_release,
)
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.scene import WorldOptions, with_earlier_scene
from perdure.home.skills import Skill, get_skill
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planners import OpenLoop, needed_skills
from perdure.home.tasks.tasks import SkillName, get_task
from perdure.runs import Observer, Store, Unit, Work, run_missing, versions
from perdure.schema import read_json

BLOCK = 50
"""Episodes in a block: a killed run loses at most one block, about a minute; blocks run side by side."""
LOGS = "logs.parquet"

Policies = Mapping[SkillName, SkillPolicy]


@dataclass(frozen=True)
class EvaluationProtocol:
    """What to run.

    Raises:
        PerdureError: If there is no such task, split or strategy, or a number is out of range.
    """

    task: str
    place: str = "rl"
    """See `read_release`."""
    split: str = "val"
    episodes: int = 100
    train_seeds: int = 1
    eval_seeds: int = 1
    policies: Mapping[str, str] = field(default_factory=dict)
    """See `choose_policies`."""
    options: ExecutorOptions = field(default_factory=ExecutorOptions)

    def __post_init__(self) -> None:
        count = len(load_episodes(self.task, self.split))
        if not 1 <= self.episodes <= count:
            raise PerdureError(f"episodes must be 1 to {count}, not {self.episodes}")
        for name in ("train_seeds", "eval_seeds"):
            if (value := getattr(self, name)) < 1:
                raise PerdureError(f"{name} must be 1 or more, not {value}")
        _ = self.release

    @cached_property
    def release(self) -> ReleaseChoice:
        """The meaning of `place`."""
        return read_release(self.place)

    @property
    def strategy(self) -> Strategy:
        """What is run, as logs have it."""
        return self.options.strategy(self.place)

    @property
    def folder(self) -> str:
        """Where the store keeps all of it, such as `set_table/val/ik` or `set_table/val/rl-drag-closed-no-fallback`."""
        words = [self.place, *self.options.scene.words]
        if self.options.planner != OpenLoop.name:
            words.append(self.options.planner)
        if self.options.fallback == "none":
            words.append("no-fallback")
        words += [each.label.replace(":", "-") for each in self.options.disturb]
        return f"{self.task}/{self.split}/{'-'.join(words)}"

    def policies_of(self, train_seed: int) -> dict[SkillName, SkillPolicy]:
        """Return the policy of each skill for a training seed; PerdureError as for `choose_policies`."""
        return choose_policies(self.task, train_seed, self.policies, self.release, self.options.planner)

    def as_trained(self, chosen: Collection[str] = ()) -> Self:
        """Return the protocol with the physics that all of its policies were trained with, if these are the same.

        Args:
            chosen: Names of physics that stay as they are.
        """
        known = [policy.physics for policy in self.policies_of(0).values() if policy.physics]
        if not known or any(each != known[0] for each in known):
            return self
        theirs = {name: value for name, value in known[0].items() if name not in chosen}
        return replace(self, options=replace(self.options, scene=replace(self.options.scene, **theirs)))

    def trained_otherwise(self) -> dict[str, list[SkillName]]:
        """Return the skills whose policies were trained with other physics, by the flags that name it."""
        found: dict[str, list[SkillName]] = {}
        for skill, policy in self.policies_of(0).items():
            trained = policy.physics
            if any(getattr(self.options.scene, name) != value for name, value in trained.items()):
                flags = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in trained.items())
                found.setdefault(flags, []).append(skill)
        return found

    def skills(self) -> dict[str, Skill]:
        """Return the skills that the planner may choose."""
        names = needed_skills(get_task(self.task), self.options.planner)
        return {name: get_skill(name, **(self.release.options if name == "place" else {})) for name in names}


@dataclass(frozen=True)
class Block:
    """Consecutive episodes, or homes, with one training seed and one evaluation seed: what one unit runs."""

    folder: str
    """Of its protocol in the store."""
    kind: Literal["episodes", "homes"]
    train_seed: int
    eval_seed: int
    first: int
    """Number of the first one."""
    last: int
    """Number of the last one."""

    @property
    def key(self) -> str:
        """Return its place in the store."""
        seeds = f"train-{self.train_seed}/eval-{self.eval_seed}"
        return f"{self.folder}/{seeds}/{self.kind}-{self.first:03d}-{self.last:03d}"


def episode_blocks(protocol: EvaluationProtocol, store: Store) -> Iterator[Block]:
    """Yield all blocks of a protocol, see `make_blocks`."""
    yield from make_blocks(protocol, protocol.folder, "episodes", BLOCK, store)


def make_blocks(
    protocol: EvaluationProtocol, folder: str, kind: Literal["episodes", "homes"], size: int, store: Store
) -> Iterator[Block]:
    """Yield blocks of `size` of a protocol's episodes, training seeds first, so that early results cover every policy.

    Args:
        protocol: Has the numbers of episodes and seeds.
        folder: Where the store keeps the blocks.
        kind: What an episode is here.
        size: Episodes in a block.
        store: Has the blocks that are finished.
    """
    for eval_seed, train_seed in product(range(protocol.eval_seeds), range(protocol.train_seeds)):
        block = Block(folder, kind, train_seed, eval_seed, 0, 0)

        def finished(first: int, last: int, block: Block = block) -> bool:
            return store.done(replace(block, first=first, last=last).key)

        for first, last in block_spans(protocol.episodes, size, finished):
            yield replace(block, first=first, last=last)


def block_spans(count: int, size: int, done: Callable[[int, int], bool]) -> Iterator[tuple[int, int]]:
    """Yield the first and last number of each block of `size` among `count` numbers.

    A finished block stays as it is: with a smaller or larger count than before nothing is run twice.

    Args:
        count: How many numbers there are, from 0.
        size: Numbers in a block.
        done: Whether a block of this first and last number is finished.
    """
    first = 0
    while first < count:
        end = first - first % size + size
        usual = min(end, count) - 1
        last = next((each for each in range(first, end) if done(first, each)), usual)
        yield first, last
        first = last + 1


def protocol_units(protocol: EvaluationProtocol, command: str, store: Store) -> Iterator[Unit]:
    """Yield a unit for each block; the policies of a training seed are read once.

    Raises:
        PerdureError: If a policy is missing.
    """
    policies = {seed: protocol.policies_of(seed) for seed in range(protocol.train_seeds)}
    check_distinct_seeds({seed: policy_digests(acting) for seed, acting in policies.items()})
    for block in episode_blocks(protocol, store):
        acting = policies[block.train_seed]
        arguments = {"protocol": protocol, "block": block, "policies": acting, "command": command}
        config = _config(protocol, block, acting)
        size = float(block.last - block.first + 1)
        cores = len(os.sched_getaffinity(0))
        yield Unit(block.key, config, f"{__name__}:run_block", arguments, size=size, cores=cores)


def check_distinct_seeds(digests: Mapping[int, Any]) -> None:
    """PerdureError if two training seeds have the same digests of policies (JSON)."""
    seen: dict[str, int] = {}
    for seed, acting in digests.items():
        same = seen.setdefault(json.dumps(acting, sort_keys=True), seed)
        if same != seed:
            raise PerdureError(
                f"training seeds {same} and {seed} have the same policies: name files with {{seed}} in them, or use "
                "--train-seeds 1"
            )


def noted_protocol(notes: Mapping[str, str], name: object) -> EvaluationProtocol:
    """Return the protocol that made a log file, from its notes; PerdureError with `name` where none is noted."""
    if "protocol" not in notes:
        raise PerdureError(f"{name} does not say with which options it was made, as logs of perdure home run do")
    try:
        noted = with_earlier_scene(read_json(notes["protocol"]))
        protocol: EvaluationProtocol = read_json(json.dumps(noted), EvaluationProtocol)
    except PerdureError as error:
        raise PerdureError(f"{name}: its protocol cannot be read: {error}") from None
    return protocol


def run_block(work: Work, *, protocol: EvaluationProtocol, block: Block, policies: Policies, command: str) -> None:
    """Execute a block and write its logs into the work folder; the function of the units.

    Raises:
        PerdureError: If a policy file has changed since the unit was made.
    """
    options = replace(protocol.options, eval_seed=block.eval_seed, threads=work.threads)
    train_seed = block.train_seed if any(each.learned for each in policies.values()) else UNTRAINED
    agents = make_agents(policies, protocol.release.strategy)
    executor = Executor(protocol.skills(), agents, options, place=protocol.place, train_seed=train_seed)
    episodes = load_episodes(protocol.task, protocol.split).episodes[block.first : block.last + 1]
    logs = []
    for log in executor.run(episodes):
        logs.append(replace(log, history=None))
        work.report(len(logs), len(episodes))
    logs.sort(key=lambda log: log.index)
    notes = {
        "protocol": json.dumps(asdict(protocol)),
        "policies": json.dumps({skill: each.name for skill, each in policies.items()}),
        "command": command,
    }
    if isinstance(place := agents["place"], HandOver):
        notes["hand_overs"] = json.dumps(Counter(place.outcomes))
    write_logs(work.folder / LOGS, logs, notes)


def _config(protocol: EvaluationProtocol, block: Block, policies: Policies) -> dict[str, Any]:
    """Return everything that the logs of a block depend on."""
    return {
        "task": protocol.task,
        **{name: getattr(block, name) for name in ("train_seed", "eval_seed")},
        "episodes": [block.first, block.last],
        "policies": policy_digests(policies),
        **run_config(protocol),
    }


def run_config(protocol: EvaluationProtocol) -> dict[str, Any]:
    """Return what the logs of a protocol depend on beside task, episodes, seeds and policies."""
    scene = protocol.options.scene
    return {
        **{name: getattr(protocol, name) for name in ("split", "place")},
        **{each.name: getattr(scene, each.name) for each in fields(WorldOptions)},
        **scene.unusual,
        "settle_steps": protocol.options.settle_steps,
        **({} if protocol.options.planner == OpenLoop.name else {"planner": protocol.options.planner}),
        **({} if protocol.options.fallback == "oracle" else {"fallback": protocol.options.fallback}),
        **({"disturb": home_labels(protocol.options.disturb)} if protocol.options.disturb else {}),
        **versions("mujoco"),
    }


def policy_digests(policies: Policies) -> dict[SkillName, str]:
    """Return what identifies the policy of each skill: SHA-256 and clock, or `ORACLE`."""
    return {
        skill: f"{each.sha256}@{each.clock.label}" if each.clock else each.sha256 or ORACLE
        for skill, each in policies.items()
    }


def run_protocol(
    protocol: EvaluationProtocol,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    command: str = "",
    observe: Observer = lambda status: None,
) -> list[Path]:
    """Run what is missing of a protocol and return the paths of all its logs.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call resumes an interrupted one.
        cores: Cores to use; all by default. Results do not depend on it.
        on: Where to run, see `perdure.runs.make_workers`.
        command: The command that asked for it, noted in new logs.
        observe: Called with the progress of every unit, measured in episodes.

    Raises:
        PerdureError: If a policy is missing, before anything is run, or a unit failed.
    """
    store = Store(out)
    units = list(protocol_units(protocol, command, store))
    store.warn_of_other_source(unit.key for unit in units)
    run_missing(units, out, on, cores, observe)
    return [store.get(unit.key, unit.config) / LOGS for unit in units]
