"""Failed episodes of logs, and their replay with the same policies and settings."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from perdure.home.benchmark.episodes import Episode, episode_hash, load_episodes
from perdure.home.benchmark.tasks import SETTLE_STEPS, get_task
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.execute.executor import Running
from perdure.home.evaluate.log import EpisodeLog, History
from perdure.home.evaluate.outcomes import Counting, Label, label, noted_policies, read_logs, read_notes
from perdure.home.evaluate.outcomes.files import check_distinct
from perdure.home.evaluate.protocol import logged_policies, read_strategy
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import VectorSimulator
from perdure.home.skills import SKILLS
from perdure.home.video.side_by_side import Agent, make_agent


@dataclass(frozen=True)
class Failure:
    """A failed episode of some logs."""

    log: EpisodeLog
    counting: Counting
    label: Label
    policies: tuple[tuple[str, str], ...] = ()
    """The policy of each skill, as the notes of the logs name it."""

    @cached_property
    def episode(self) -> Episode:
        """The episode; HomeError when this package has another one, or none, under its number."""
        log = self.log
        episode = load_episodes(log.task, log.split)[log.index]
        if episode_hash(episode) != log.episode_hash:
            raise HomeError(f"{log.name} is not the episode that this package has under that number")
        return episode

    @property
    def assignment(self) -> tuple[str, str, int, tuple[tuple[str, str], ...]]:
        """Task, `place`, training seed and `policies`: failures with equal ones share an agent, see `logged_agent`."""
        return self.log.task, read_strategy(self.log.strategy)[0], self.log.train_seed, self.policies

    @property
    def options(self) -> ExecutorOptions:
        """The settings it was run with."""
        log, options = self.log, read_strategy(self.log.strategy)[1]
        settle = SETTLE_STEPS if log.diverged else log.length - log.steps
        return replace(options, eval_seed=log.eval_seed, settle_steps=settle, lanes=1, threads=1)

    def words(self, found: Label | None) -> str:
        """Return a label of this episode as text, such as `place_1, rolled, 013_apple`."""
        if found is None:
            return "no failure"
        return f"{found.stage}, {found.cause}, {self.log.targets[found.target].kind}"

    @property
    def line(self) -> str:
        """Identity and label on one line."""
        log, words = self.log, self.words(self.label)
        seeds = f"training seed {log.train_seed}, evaluation seed {log.eval_seed}"
        return f"{log.task}, {log.split}, {log.strategy}, {seeds}, {log.index:03d}, {words}"

    @property
    def file_name(self) -> str:
        """Such as `set_table-val-ik-drag-train-0-eval-0-003.png`."""
        log, strategy = self.log, self.log.strategy.replace("+", "-plus").replace(" ", "-")
        seeds = f"train-{log.train_seed}-eval-{log.eval_seed}"
        return f"{log.task}-{log.split}-{strategy}-{seeds}-{log.index:03d}.png"


def read_failures(paths: Sequence[str | os.PathLike[str]], counting: Counting) -> list[Failure]:
    """Return the failed episodes of log files, in the order of `EpisodeLog.key`.

    Raises:
        HomeError: A file holds no logs, an episode is there twice, or cannot be replayed by this package.
    """
    files = [(read_logs(path), tuple((noted_policies(read_notes(path)) or {}).items())) for path in paths]
    check_distinct([log for logs, _ in files for log in logs], "the logs")
    failures = [
        Failure(log, counting, found, policies)
        for logs, policies in files
        for log in logs
        if (found := label(log, counting)) is not None
    ]
    for failure in failures:
        _ = failure.options
    return sorted(failures, key=lambda failure: failure.log.key)


def sample_failures(failures: Sequence[Failure], count: int, seed: int) -> list[Failure]:
    """Return `count` failures drawn at random without replacement; all when there are fewer. `seed` fixes the draw."""
    for name, value, least in (("count", count, 1), ("seed", seed, 0)):
        if value < least:
            raise HomeError(f"{name} must be {least} or more, not {value}")
    return [failures[int(k)] for k in np.random.default_rng(seed).permutation(len(failures))[:count]]


@dataclass(frozen=True)
class Replay:
    """An episode that was run again."""

    log: EpisodeLog
    """With its history."""
    label: Label | None
    """Why it failed this time, None when it succeeded."""
    states: FloatArray
    """MuJoCo's `qpos` after every step. Shape (steps + settling time, nq)."""

    @property
    def history(self) -> History:
        """Every pose at every step."""
        assert self.log.history is not None
        return self.log.history


def logged_agent(failure: Failure, policies: Mapping[str, str]) -> Agent:
    """Return the agent that acted when a failure was logged.

    Args:
        failure: The failure.
        policies: Skill to file or "oracle", in place of what the logs name.

    Raises:
        HomeError: If the release strategy is another simulator's, or a policy file is missing or has changed.
    """
    task, place, train_seed, noted = failure.assignment
    # The logs may be of several tasks: a policy replaces that of the tasks whose plans use its skill.
    elsewhere = SKILLS.keys() - {step.skill for step in get_task(task).skills}
    named = {skill: path for skill, path in policies.items() if skill not in elsewhere}
    return make_agent(task, place, train_seed, {**logged_policies(dict(noted), named), **named})


def replay_failure(failure: Failure, agent: Agent) -> Replay:
    """Run an episode again with the settings of its log."""
    states: list[FloatArray] = []

    def observe(world: VectorSimulator, running: Mapping[int, Running]) -> None:
        states.append(world.simulator(0).qpos.copy())

    log = failure.log
    executor = Executor(
        agent.skills, agent.skill_agents, failure.options, strategy=log.strategy, train_seed=log.train_seed
    )
    (again,) = executor.run([failure.episode], observe)
    return Replay(again, label(again, failure.counting), np.array(states))
