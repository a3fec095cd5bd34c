"""The units of work of a protocol: blocks of episodes, each executed and stored as a whole."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from perdure.home.agents import SkillAgent
from perdure.home.agents.release import HandOver
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import SkillName
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.outcomes import read_logs, write_logs
from perdure.home.evaluate.protocol.policies import SkillPolicy, make_agents, read_policy
from perdure.home.evaluate.protocol.protocol import EvaluationProtocol
from perdure.runs import Unit, Work

BLOCK = 50
"""Episodes in a block: a killed run loses at most one block, about a minute; blocks run side by side."""
LOGS = "logs.parquet"

Policies = Mapping[SkillName, SkillPolicy]


@dataclass(frozen=True)
class EpisodeBlock:
    """Consecutive episodes with one training seed and one evaluation seed."""

    train_seed: int
    eval_seed: int
    first: int
    """Number of the first episode."""
    last: int
    """Number of the last episode."""

    def key(self, protocol: EvaluationProtocol) -> str:
        """Return its place in the store."""
        seeds = f"train-{self.train_seed}/eval-{self.eval_seed}"
        return f"{protocol.folder}/{seeds}/episodes-{self.first:03d}-{self.last:03d}"


def episode_blocks(protocol: EvaluationProtocol) -> Iterator[EpisodeBlock]:
    """Yield all blocks of a protocol, training seeds first, so that early results cover every policy."""
    for eval_seed in range(protocol.eval_seeds):
        for train_seed in range(protocol.train_seeds):
            for first in range(0, protocol.episodes, BLOCK):
                yield EpisodeBlock(train_seed, eval_seed, first, min(first + BLOCK, protocol.episodes) - 1)


def protocol_units(protocol: EvaluationProtocol, command: str) -> Iterator[Unit]:
    """Yield a unit for each block; the policies of a training seed are read once.

    Raises:
        HomeError: If a policy is missing.
    """
    policies = {seed: protocol.assignment(seed) for seed in range(protocol.train_seeds)}
    seen: dict[str, int] = {}
    for seed, acting in policies.items():
        same = seen.setdefault(json.dumps(_digests(acting), sort_keys=True), seed)
        if same != seed:
            raise HomeError(
                f"training seeds {same} and {seed} have the same policies: name files with {{seed}} in them, or use "
                "--train-seeds 1"
            )
    for block in episode_blocks(protocol):
        acting = policies[block.train_seed]
        arguments = {
            "protocol": protocol.to_json(),
            "block": asdict(block),
            "policies": {skill: each.source for skill, each in acting.items()},
            "digests": _digests(acting),
            "command": command,
        }
        yield Unit(
            block.key(protocol),
            _config(protocol, block, acting),
            "perdure.home.evaluate.protocol.units:run_block",
            arguments,
            size=float(block.last - block.first + 1),
            cores=len(os.sched_getaffinity(0)),
        )


def run_block(
    work: Work,
    *,
    protocol: Mapping[str, Any],
    block: Mapping[str, int],
    policies: Mapping[SkillName, str],
    digests: Mapping[SkillName, str],
    command: str,
) -> None:
    """Execute a block and write its logs into the work folder; the function of the units.

    Raises:
        HomeError: If a policy file has changed since the unit was made.
    """
    if _is_written(work.folder / LOGS):
        return
    acting = {skill: read_policy(source) for skill, source in policies.items()}
    for skill, digest in _digests(acting).items():
        if digests[skill] != digest:
            raise HomeError(f"{policies[skill]} has changed since this run began")
    wanted, part = EvaluationProtocol.from_json(protocol), EpisodeBlock(**block)
    options = replace(wanted.options, eval_seed=part.eval_seed, threads=work.threads)
    train_seed = part.train_seed if any(each.policy for each in acting.values()) else UNTRAINED
    agents = make_agents(acting, wanted.release.strategy)
    executor = Executor(wanted.skills(), agents, options, strategy=wanted.name, train_seed=train_seed)
    episodes = load_episodes(wanted.task, wanted.split).episodes[part.first : part.last + 1]
    logs = []
    for log in executor.run(episodes):
        logs.append(replace(log, history=None))
        work.report(len(logs), len(episodes))
    logs.sort(key=lambda log: log.index)
    notes = {
        "arm": wanted.name,  # files name the release strategy so
        "train_seed": str(train_seed),
        "policies": json.dumps({skill: each.name for skill, each in acting.items()}),
        "command": command,
        **_hand_overs(agents["place"]),
    }
    write_logs(work.folder / LOGS, logs, notes)


def _is_written(path: Path) -> bool:
    """Return whether an attempt that was interrupted between its last two steps has left its logs."""
    try:
        return path.is_file() and bool(read_logs(path))
    except HomeError:
        return False


def _config(protocol: EvaluationProtocol, block: EpisodeBlock, policies: Policies) -> dict[str, Any]:
    """Return everything that the logs of a block depend on."""
    options = protocol.options
    # Named only where they are unusual: stored configurations of the usual world do not have them.
    unusual = {name: False for name in ("clutter", "sleep") if not getattr(options.scene, name)}
    return {
        "task": protocol.task,
        "split": protocol.split,
        "place": protocol.place,
        "train_seed": block.train_seed,
        "eval_seed": block.eval_seed,
        "episodes": [block.first, block.last],
        "policies": _digests(policies),
        "jaws": options.jaws,
        "physics_hz": options.scene.physics_hz,
        "rolling": options.scene.rolling,
        "apple": options.scene.apple,
        "release_velocity": options.scene.release_velocity,
        "settle_steps": options.settle_steps,
        "mujoco": version("mujoco"),
        "perdure": version("perdure"),
        **unusual,
    }


def _digests(policies: Policies) -> dict[SkillName, str]:
    return {skill: each.sha256 or each.source for skill, each in policies.items()}


def _hand_overs(place: SkillAgent) -> dict[str, str]:
    """Return the note on how often each outcome of the release strategy came; nothing for the policy alone."""
    return {"hand_overs": json.dumps(Counter(place.outcomes))} if isinstance(place, HandOver) else {}
