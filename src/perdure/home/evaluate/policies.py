"""The release strategy that `--place` names, and the policy of each skill: shipped, a file, or the oracle."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from perdure.envs.suites import parse_options
from perdure.errors import PerdureError, did_you_mean, lookup
from perdure.home.agents.learned import Learned, Scripted, SkillAgent
from perdure.home.agents.release import ReleaseStrategy, make_strategy, release_strategy
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.sim.scene import EARLIER
from perdure.home.skills import SKILLS, get_skill
from perdure.home.skills.place import VARIANTS, variant_options
from perdure.home.tasks.planners import OpenLoop, needed_skills
from perdure.home.tasks.tasks import SkillName, get_task
from perdure.horizon import Clock, Constant, parse_clock
from perdure.policy import Policy, files, load_policy
from perdure.report import wording
from perdure.runs import file_digest

SHIPPED = files.SHIPPED / "home"
"""Policies that come with the package: TASK/POLICY/seed-K.safetensors, POLICY: the skill or `ReleaseChoice.policy`."""
ORACLE = "oracle"
LEARNED_ON: Mapping[str, str] = dict.fromkeys(("navigate", "open_drawer", "open_fridge"), "set_table")
"""Skills trained on one task for all tasks: they do not depend on the task."""


TIMED = ("linear", "geometric")
"""Methods that train place policies with a time-to-go input."""
TRAINED = {
    "delta": "trained to stay {} steps",
    "gentle": "trained to release at rest",
    "hand": "trained with actions of the hand",
    "linear": "trained with a linear time-to-go",
    "geometric": "trained with a geometric time-to-go",
}
"""Place policies that were trained otherwise and open the hand at once, to what a reader sees; {}: their number."""


@dataclass(frozen=True)
class ReleaseChoice:
    """How objects are released; made by `read_release`."""

    name: str
    """The text it was read from, such as `ik` or `delta-200`."""
    strategy: str = "rl"
    """The release strategy, a name of `ReleaseStrategy`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `Place` and its environment that differ from the benchmark's."""
    trained: str = ""
    """The variant or method of its place policy, such as "delta-200" or "linear"; "" for the benchmark's."""
    steps: int | None = None
    """What its time-to-go input always is; None for a countdown from the step limit, or for no such input."""

    @property
    def policy(self) -> str:
        """Name of the place policy it needs, such as `place` or `place-delta-200`."""
        return f"place-{self.trained}" if self.trained else "place"

    @property
    def clock(self) -> Clock | None:
        """What sets its time-to-go input; None where that counts down, and where there is no such input."""
        return None if self.steps is None else Constant(float(self.steps))

    @property
    def flags(self) -> str:
        """What `perdure home train place` needs for that policy: "--variant gentle ", or ""."""
        if not self.trained:
            return ""
        return f"--{'method' if self.trained in TIMED else 'variant'} {self.trained} "

    @property
    def words(self) -> str:
        """What a reader sees: "stop first", "trained to stay 200 steps"."""
        if not self.trained:
            return release_strategy(self.strategy).words
        kind = "delta" if "delta" in self.options else self.trained
        words = TRAINED[kind].format(self.options.get("delta"))
        return words if self.steps is None else f"{words}, {wording.clock('constant', str(self.steps))}"

    @property
    def rank(self) -> tuple[int, int]:
        """Its place in tables: `rl`, then policies that were trained otherwise, then the other strategies."""
        names = list(ReleaseStrategy.kinds())
        if not self.trained:
            return (0 if self.strategy == "rl" else len(TRAINED) + 1 + names.index(self.strategy)), 0
        kind = "delta" if "delta" in self.options else self.trained
        return 1 + list(TRAINED).index(kind), self.options.get("delta") or self.steps or 0


def read_release(text: str) -> ReleaseChoice:
    """Read a release strategy, or the name of a place policy that was trained otherwise and acts alone.

    Such policies are the variants of `Place`, and `linear` and `geometric`; `geometric-50`: always 50 steps to go.

    Raises:
        PerdureError: If it is none of these.
    """
    strategies = ReleaseStrategy.kinds()
    if text in strategies:
        return ReleaseChoice(text, text)
    if timed := re.fullmatch(rf"({'|'.join(TIMED)})(?:-(\d+))?", text, re.ASCII):
        return ReleaseChoice(text, trained=timed[1], steps=int(timed[2]) if timed[2] else None)
    try:
        return ReleaseChoice(text, options=variant_options(text), trained=text)
    except PerdureError:
        names = [*strategies, *VARIANTS, *TIMED]
        more = "delta-N with N 2 or more, linear-N or geometric-N"
        hint = did_you_mean(text, names)
        raise PerdureError(f"place must be one of {', '.join(names)}, {more}, not {text!r}{hint}") from None


@dataclass(frozen=True)
class SkillPolicy:
    """What acts in one skill."""

    path: Path | None = None
    """The policy's file; None for the oracle."""
    sha256: str = ""
    """Of the file; empty for the oracle."""
    clock: Clock | None = None
    """The clock of its time-to-go input; None where none is named."""

    @property
    def learned(self) -> bool:
        """Whether it is a policy, not the oracle."""
        return self.path is not None

    @property
    def policy(self) -> Policy | None:
        """The policy, loaded once in a process; None for the oracle. PerdureError if its file has changed."""
        return None if self.path is None else _load(self.path, self.sha256)

    @property
    def physics(self) -> dict[str, Any]:
        """The options of `EARLIER` with which it was trained; empty where its file does not say."""
        policy = self.policy
        if policy is None:
            return {}
        named = parse_options(policy.task.name.partition(",")[2])
        found = {name: named[name] for name in EARLIER if name in named}
        if not found and self.path is not None and self.path.is_relative_to(SHIPPED):
            return dict(EARLIER)
        return found

    @property
    def source(self) -> str:
        """As the command line has it: "oracle", "place.safetensors" or "place.safetensors@constant:50"."""
        return ORACLE if self.path is None else f"{self.path}{self._clock_text}"

    @property
    def name(self) -> str:
        """For a reader: `oracle`, `shipped set_table/place/seed-0 (SHA-256 1e2d3fcb)`, or the file's path and hash."""
        if self.path is None:
            return ORACLE
        where = str(self.path)
        if self.path.is_relative_to(SHIPPED):
            where = f"shipped {self.path.relative_to(SHIPPED).with_suffix('')}"
        return f"{where}{self._clock_text} (SHA-256 {self.sha256[:8]})"

    @property
    def _clock_text(self) -> str:
        if self.clock is None:
            return ""
        steps = str(float(self.clock.steps)).removesuffix(".0")
        return f"@{self.clock.name}:{steps}"


def read_source(text: str) -> tuple[str, Clock | None]:
    """Return the path in "place.safetensors@constant:50" and the clock; PerdureError if there is no such clock."""
    clock = re.search(r"@(\w+:[^/]*)$", text)
    if clock is None:
        return text, None
    return text[: clock.start()], parse_clock(clock[1])


@lru_cache(maxsize=64)
def _load(path: Path, sha256: str) -> Policy:
    if file_digest(path) != sha256:
        raise PerdureError(f"{path} has changed since this run began")
    return load_policy(path)


def shipped_seeds(task: str, policy: str) -> dict[int, Path]:
    """Return the shipped file of each training seed, the task's own before one trained for all tasks."""
    folders = [SHIPPED / each / policy for each in (LEARNED_ON.get(policy, task), task)]
    paths = [path for folder in folders for path in folder.glob("seed-*.safetensors")]
    return dict(sorted({int(path.stem.removeprefix("seed-")): path for path in paths}.items()))


def choose_policies(
    task: str,
    train_seed: int,
    chosen: Mapping[str, str] | None = None,
    release: ReleaseChoice | None = None,
    planner: str = OpenLoop.name,
) -> dict[SkillName, SkillPolicy]:
    """Return the policy of each skill that a planner may choose in a task.

    Args:
        task: Name of the task.
        train_seed: The training seed, from 0, which `{seed}` in a path stands for; UNTRAINED where no skill is learned.
        chosen: Skill to `SkillPolicy.source`; skills that are not named get the shipped policy, or the oracle without
            one.
        release: The release choice, which decides the place policy; the benchmark's when None.
        planner: Name of the planner.

    Raises:
        PerdureError: If a skill is unknown or scripted, a file is given for a skill that the task never uses, a file is
            missing or gets a clock that it cannot take, there is no policy of this training seed though there is one of
            another, or none was trained for what `release` asks: the oracle does not stand in for one that should be
            there, for it would pass for a result of that training.
    """
    chosen = dict(chosen or {})
    release = release or read_release("rl")
    learned = [each for each in needed_skills(get_task(task), planner) if each != "reset_arm"]
    _check_chosen(task, chosen, learned)
    result: dict[SkillName, SkillPolicy] = {}
    for skill in learned:
        # Only place knows of the release: every other skill has the benchmark's policy.
        asked = release if skill == "place" else ReleaseChoice("rl")
        if chosen.get(skill) == ORACLE:
            result[skill] = SkillPolicy()
        elif skill in chosen:
            result[skill] = _given_policy(skill, chosen[skill], train_seed, asked)
        else:
            result[skill] = _shipped_policy(task, skill, train_seed, asked)
    return result


def _check_chosen(task: str, chosen: Mapping[str, str], learned: Sequence[str]) -> None:
    """Refuse names of skills that are unknown, or that a task does not need a policy for."""
    for skill in chosen:
        lookup(SKILLS, skill, "skill")
    unused = [skill for skill, named in chosen.items() if named != ORACLE and skill not in learned]
    if unused:
        why = "reset_arm is scripted" if unused[0] == "reset_arm" else f"{task} never uses {unused[0]}"
        raise PerdureError(f"{why}; the skills of {task} that need a policy are {', '.join(learned)}")


def _shipped_policy(task: str, skill: SkillName, train_seed: int, release: ReleaseChoice) -> SkillPolicy:
    """Return the shipped policy of a skill, or the oracle where none is shipped for it at all."""
    name = release.policy if skill == "place" else skill
    seeds = shipped_seeds(task, name)
    path = seeds.get(train_seed)
    if path is None:
        if (not seeds or train_seed == UNTRAINED) and name in ("place", skill):
            return SkillPolicy()
        flags = f"--task {LEARNED_ON.get(skill, task)} {release.flags}--seeds {train_seed}"
        raise PerdureError(
            f"no policy of training seed {train_seed} is shipped for {name} on {task} (there are {len(seeds)}): train "
            f"one (perdure home train {skill} {flags}) and name it: --policies {skill}=FILE, where {{seed}} stands for "
            "the seed"
        )
    found = SkillPolicy(path, file_digest(path), release.clock)
    if release.trained in TIMED:
        _check_fits(skill, path, found, release)
    return found


def _given_policy(skill: SkillName, source: str, train_seed: int, release: ReleaseChoice) -> SkillPolicy:
    """Return the policy of a file that was named for a skill, read and checked."""
    text, clock = read_source(source)
    path = Path(text.replace("{seed}", str(train_seed)))
    if not path.exists():
        raise PerdureError(f"there is no policy {path} for {skill}")
    found = SkillPolicy(path, file_digest(path), release.clock or clock)
    _check_fits(skill, path, found, release)
    return found


def _check_fits(skill: SkillName, path: Path, chosen: SkillPolicy, release: ReleaseChoice) -> None:
    """Refuse a policy that cannot act in a skill, before anything runs."""
    acting = chosen.policy
    assert acting is not None
    timed = release.trained in TIMED
    if (timed or chosen.clock) and not acting.has_clock:
        raise PerdureError(f"{skill}={chosen.source}: the policy has no time-to-go input, so it takes no clock")
    method = str(acting.provenance.get("method", "")).partition("-")[2]
    if timed and method in TIMED and method != release.trained:
        raise PerdureError(f"{skill}={path}: trained with --method {method}, not {release.trained}")
    Learned(acting).check_fits(get_skill(skill, **release.options))


def make_agents(policies: Mapping[SkillName, SkillPolicy], strategy: str) -> dict[str, SkillAgent]:
    """Return an agent for each skill, that of place under the release strategy."""
    oracle = Oracle()
    agents: dict[str, SkillAgent] = {"reset_arm": Scripted()}
    for skill, chosen in policies.items():
        policy = chosen.policy
        agent: SkillAgent = oracle if policy is None else Learned(policy, chosen.clock)
        if skill == "place":
            agent = make_strategy(strategy, Oracle() if agent is oracle else agent)
        agents[skill] = agent
    return agents
