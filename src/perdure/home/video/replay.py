"""Failed episodes of logs, run again as they were run when they were logged."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode, load_episodes
from perdure.home.benchmark.tasks import SETTLE_STEPS
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import EpisodeLog, Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import (
    Counting,
    EpisodeRecord,
    Label,
    episode_hash,
    label,
    noted_policies,
    read_logs,
    read_notes,
    record_of,
)
from perdure.home.evaluate.outcomes.files import check_distinct
from perdure.home.evaluate.protocol import logged_policies, read_arm
from perdure.home.sim.world import World
from perdure.home.video.beside import Take, make_take

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Failure:
    """A failed episode of some logs."""

    record: EpisodeRecord
    counting: Counting
    label: Label
    policies: tuple[tuple[str, str], ...] = ()
    """Who acted in each skill, as the logs note it."""

    @cached_property
    def episode(self) -> Episode:
        """What was run; HomeError when this package has another episode, or none, under its number."""
        record = self.record
        episode = load_episodes(record.task, record.split)[record.index]
        if episode_hash(episode) != record.episode_hash:
            raise HomeError(f"{record.name} is not the episode that this package has under that number")
        return episode

    @property
    def assignment(self) -> tuple[str, str, int, tuple[tuple[str, str], ...]]:
        """Task, `place`, training seed and `policies`: failures of one cast share a `Take`, see `take_again`."""
        return self.record.task, read_arm(self.record.arm)[0], self.record.train_seed, self.policies

    @property
    def options(self) -> ExecutorOptions:
        """How it was run."""
        record, options = self.record, read_arm(self.record.arm)[1]
        settle = SETTLE_STEPS if record.diverged else record.length - record.steps
        return replace(options, eval_seed=record.eval_seed, settle_steps=settle, lanes=1, threads=1)

    def words(self, found: Label | None) -> str:
        """A label of this episode, such as `place_1, rolled, 013_apple`."""
        if found is None:
            return "no failure"
        return f"{found.stage}, {found.mechanism}, {self.record.targets[found.target].kind}"

    @property
    def line(self) -> str:
        """Which episode, and its label."""
        record, words = self.record, self.words(self.label)
        seeds = f"training seed {record.train_seed}, evaluation seed {record.eval_seed}"
        return f"{record.task}, {record.split}, {record.arm}, {seeds}, {record.index:03d}, {words}"

    @property
    def file_name(self) -> str:
        """Such as `set_table-val-ik-drag-train-0-eval-0-003.png`."""
        record, arm = self.record, self.record.arm.replace("+", "-plus").replace(" ", "-")
        seeds = f"train-{record.train_seed}-eval-{record.eval_seed}"
        return f"{record.task}-{record.split}-{arm}-{seeds}-{record.index:03d}.png"


def read_failures(paths: Sequence[str | os.PathLike[str]], counting: Counting) -> list[Failure]:
    """The failed episodes of files of logs, in the order of `EpisodeRecord.key`.

    Raises:
        HomeError: A file is none of logs, an episode is there twice, or is not one that can be run again here.
    """
    files = [(read_logs(path), tuple((noted_policies(read_notes(path)) or {}).items())) for path in paths]
    check_distinct([record for records, _ in files for record in records], "the logs")
    failures = [
        Failure(record, counting, found, policies)
        for records, policies in files
        for record in records
        if (found := label(record, counting)) is not None
    ]
    for failure in failures:
        _ = failure.options
    return sorted(failures, key=lambda failure: failure.record.key)


def draw(failures: Sequence[Failure], count: int, seed: int) -> list[Failure]:
    """So many of them at random, each once; all of them when there are fewer. The same seed draws the same ones."""
    for name, value, least in (("count", count, 1), ("seed", seed, 0)):
        if value < least:
            raise HomeError(f"{name} must be {least} or more, not {value}")
    return [failures[int(k)] for k in np.random.default_rng(seed).permutation(len(failures))[:count]]


@dataclass(frozen=True)
class Replay:
    """An episode that was run again."""

    log: EpisodeLog
    record: EpisodeRecord
    label: Label | None
    """Why it failed this time, None when it succeeded."""
    states: FloatArray
    """MuJoCo's `qpos` after every step. Shape (steps + settling time, nq)."""


def take_again(failure: Failure, policies: Mapping[str, str]) -> Take:
    """Who acted when a failure was logged.

    Args:
        failure: The failure.
        policies: Skill to file or "oracle", in place of what the logs name.

    Raises:
        HomeError: If it is another simulator's arm, or a policy that is named is missing or another one now.
    """
    task, place, train_seed, noted = failure.assignment
    return make_take(task, place, train_seed, {**logged_policies(dict(noted), policies), **policies})


def run_again(failure: Failure, take: Take) -> Replay:
    """Runs an episode as it was run when it was logged, `take` acting in it."""
    states: list[FloatArray] = []

    def watch(world: World, episodes: Mapping[int, Episode]) -> None:
        states.append(world.lane(0).qpos.copy())

    (log,) = Executor(take.skills, take.actors, failure.options).run([failure.episode], watch)
    record = record_of(log, {"arm": failure.record.arm, "train_seed": str(failure.record.train_seed)})
    return Replay(log, record, label(record, failure.counting), np.array(states))
