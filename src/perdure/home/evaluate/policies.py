"""The release strategy that `--place` names, and the policy of each skill: shipped, a file, or the oracle."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError, lookup
from perdure.home.agents.learned import Learned, Scripted, SkillAgent
from perdure.home.agents.release import STRATEGIES, make_strategy
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.skills import SKILLS, get_skill
from perdure.home.skills.place import VARIANTS, variant_options
from perdure.home.tasks.planners import PlannerName, needed_skills
from perdure.home.tasks.tasks import SkillName, get_task
from perdure.horizon import Clock, parse_clock
from perdure.policy import Policy, files, load_policy
from perdure.runs import file_digest

SHIPPED = files.SHIPPED / "home"
"""Policies that come with the package: TASK/POLICY/seed-K.safetensors, POLICY: the skill or `ReleaseChoice.policy`."""
ORACLE = "oracle"
LEARNED_ON: Mapping[str, str] = dict.fromkeys(("navigate", "open_drawer", "open_fridge"), "set_table")
"""Skills trained on one task for all tasks: they do not depend on the task."""


@dataclass(frozen=True)
class ReleaseChoice:
    """How objects are released; made by `read_release`."""

    name: str
    """The text it was read from, such as `ik` or `delta-200`."""
    strategy: str = "rl"
    """The release strategy, a key of `STRATEGIES`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `Place` and its environment that differ from the benchmark's."""
    trained: str = ""
    """The variant or method of its place policy, such as "delta-200" or "linear"; "" for the benchmark's."""
    clock: str = ""
    """What sets its time-to-go input, such as "@constant:50"; "" counts down from the step limit."""

    @property
    def policy(self) -> str:
        """Name of the place policy it needs, such as `place` or `place-delta-200`."""
        return f"place-{self.trained}" if self.trained else "place"

    @property
    def flags(self) -> str:
        """What `perdure home train place` needs for that policy: "--variant gentle ", or ""."""
        return f"--{'method' if self.trained in TIMED else 'variant'} {self.trained} " if self.trained else ""


TIMED = ("linear", "geometric")
"""Methods that train place policies with a time-to-go input."""


def read_release(text: str) -> ReleaseChoice:
    """Read a release strategy, or the name of a place policy that was trained otherwise and acts alone.

    Such policies are the variants of `Place`, and `linear` and `geometric`; `geometric-50`: always 50 steps to go.

    Raises:
        PerdureError: If it is none of these.
    """
    if text in STRATEGIES:
        return ReleaseChoice(text, text)
    if timed := re.fullmatch(rf"({'|'.join(TIMED)})(?:-(\d+))?", text, re.ASCII):
        return ReleaseChoice(text, trained=timed[1], clock=f"@constant:{timed[2]}" if timed[2] else "")
    try:
        return ReleaseChoice(text, options=variant_options(text), trained=text)
    except PerdureError:
        names = ", ".join((*STRATEGIES, *VARIANTS, *TIMED))
        more = "delta-N with N 2 or more, linear-N or geometric-N"
        raise PerdureError(f"place must be one of {names}, {more}, not {text!r}") from None


@dataclass(frozen=True)
class SkillPolicy:
    """What acts in one skill."""

    source: str
    """Path of the policy's file, or "oracle"; `@constant:50` and the like at its end name the clock."""
    sha256: str = ""
    """Of the file; empty for the oracle."""

    @property
    def learned(self) -> bool:
        """Whether it is a policy, not the oracle."""
        return self.source != ORACLE

    @property
    def policy(self) -> Policy | None:
        """The policy, loaded once in a process; None for the oracle. PerdureError if its file has changed."""
        return _load(_split(self.source)[0], self.sha256) if self.learned else None

    @property
    def clock(self) -> Clock | None:
        """The clock of its time-to-go input; None where none is named."""
        clock = _split(self.source)[1]
        return parse_clock(clock[1:]) if clock else None

    @property
    def name(self) -> str:
        """For a reader: `oracle`, `shipped set_table/place/seed-0 (SHA-256 1e2d3fcb)`, or the file's path and hash."""
        if not self.learned:
            return ORACLE
        text, clock = _split(self.source)
        path, where = Path(text), self.source
        if path.is_relative_to(SHIPPED):
            where = f"shipped {path.relative_to(SHIPPED).with_suffix('')}{clock}"
        return f"{where} (SHA-256 {self.sha256[:8]})"


def _split(source: str) -> tuple[str, str]:
    """Return the path of a source, and the clock behind it, such as "@constant:50", or ""."""
    clock = re.search(r"@\w+:[^/]*$", source)
    return (source, "") if clock is None else (source[: clock.start()], clock[0])


@lru_cache(maxsize=64)
def _load(source: str, sha256: str) -> Policy:
    if file_digest(Path(source)) != sha256:
        raise PerdureError(f"{source} has changed since this run began")
    return load_policy(source)


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
    planner: PlannerName = "open",
) -> dict[SkillName, SkillPolicy]:
    """Return the policy of each skill that a planner may choose in a task.

    Args:
        task: Name of the task.
        train_seed: The training seed, from 0, which `{seed}` in a path stands for; UNTRAINED where no skill is learned.
        chosen: Skill to `SkillPolicy.source`; skills that are not named get the shipped policy, or the oracle without
            one.
        release: The release choice, which decides the place policy; the benchmark's when None.
        planner: The planner.

    Raises:
        PerdureError: If a skill is unknown or scripted, a file is given for a skill that the task never uses, a file is
            missing or gets a clock that it cannot take, there is no policy of this training seed though there is one of
            another, or none was trained for what `release` asks: the oracle does not stand in for one that should be
            there, for it would pass for a result of that training.
    """
    chosen, release = dict(chosen or {}), release or read_release("rl")
    for skill in chosen:
        lookup(SKILLS, skill, "skill")
    learned = [each for each in needed_skills(get_task(task), planner) if each != "reset_arm"]
    if unused := [skill for skill, named in chosen.items() if named != ORACLE and skill not in learned]:
        why = "reset_arm is scripted" if unused[0] == "reset_arm" else f"{task} never uses {unused[0]}"
        raise PerdureError(f"{why}; the skills of {task} that need a policy are {', '.join(learned)}")
    result: dict[SkillName, SkillPolicy] = {}
    for skill in learned:
        named = chosen.get(skill)
        text, clock = _split(named or "")
        timed = skill == "place" and release.trained in TIMED and named != ORACLE
        clock = (release.clock if timed else "") or clock
        if named is None:
            policy = release.policy if skill == "place" else skill
            seeds = shipped_seeds(task, policy)
            path = seeds.get(train_seed)
            if path is None and ((seeds and train_seed != UNTRAINED) or policy not in ("place", skill)):
                variant, home = release.flags if skill == "place" else "", LEARNED_ON.get(skill, task)
                flags = f"--task {home} {variant}--seeds {train_seed}"
                raise PerdureError(
                    f"no policy of training seed {train_seed} is shipped for {policy} on {task} (there are "
                    f"{len(seeds)}): train one (perdure home train {skill} {flags}) and name it: --policies "
                    f"{skill}=FILE, where {{seed}} stands for the seed"
                )
        else:
            path = None if named == ORACLE else Path(text.replace("{seed}", str(train_seed)))
        if path is not None and not path.exists():
            raise PerdureError(f"there is no policy {path} for {skill}")
        result[skill] = SkillPolicy(ORACLE) if path is None else SkillPolicy(f"{path}{clock}", file_digest(path))
        if path is not None and (named is not None or timed):
            acting = result[skill].policy  # what is no policy, or does not fit, is refused before anything runs
            assert acting is not None
            if (timed or result[skill].clock) and not acting.has_clock:
                raise PerdureError(f"{skill}={path}{clock}: the policy has no time-to-go input, so it takes no clock")
            method = str(acting.provenance.get("method", "")).partition("-")[2]
            if timed and method in TIMED and method != release.trained:
                raise PerdureError(f"{skill}={path}: trained with --method {method}, not {release.trained}")
            Learned(acting).check_fits(get_skill(skill, **(release.options if skill == "place" else {})))
    return result


def make_agents(policies: Mapping[SkillName, SkillPolicy], strategy: str) -> dict[str, SkillAgent]:
    """Return an agent for each skill, that of place under the release strategy."""
    oracle = Oracle()
    agents: dict[str, SkillAgent] = {"reset_arm": Scripted()}
    for skill, chosen in policies.items():
        agent: SkillAgent = oracle if (policy := chosen.policy) is None else Learned(policy, chosen.clock)
        agents[skill] = make_strategy(strategy, Oracle() if agent is oracle else agent) if skill == "place" else agent
    return agents
