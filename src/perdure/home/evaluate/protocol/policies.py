"""The policy of each skill: shipped ones, files of your own, or the oracle where there is none."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from perdure.home.agents import Learned, Scripted, SkillAgent
from perdure.home.agents.oracle import Oracle
from perdure.home.agents.release import make_strategy
from perdure.home.benchmark.tasks import SkillName, get_task
from perdure.home.errors import HomeError
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.protocol.release_choice import ReleaseChoice, read_release
from perdure.home.skills import SKILLS
from perdure.policy import Policy, load_policy, shipped

SHIPPED = shipped.SHIPPED / "home"
"""Policies that come with the package: TASK/POLICY/seed-K.safetensors, POLICY: the skill or `ReleaseChoice.policy`."""
ORACLE = "oracle"
LEARNED_ON: Mapping[str, str] = {"navigate": "set_table"}
"""Skills trained on one task for all tasks: they do not depend on the task."""


@dataclass(frozen=True)
class SkillPolicy:
    """What acts in one skill."""

    source: str
    """Path of the policy's file, or "oracle"."""
    sha256: str
    """Of the file; empty for the oracle."""
    policy: Policy | None

    @property
    def name(self) -> str:
        """For a reader: `oracle`, `shipped set_table/place/seed-0 (SHA-256 1e2d3fcb)`, or the file's path and hash."""
        if self.policy is None:
            return ORACLE
        path = Path(self.source)
        shipped = path.is_relative_to(SHIPPED)
        where = f"{_SHIPPED_AS}{path.relative_to(SHIPPED).with_suffix('')}" if shipped else self.source
        return f"{where} (SHA-256 {self.sha256[:8]})"


_SHIPPED_AS = "shipped "


def logged_policies(names: Mapping[str, str], without: Collection[str] = ()) -> dict[str, str]:
    """Return the policies that logs name, as the argument `chosen` of `choose_policies`.

    Args:
        names: `SkillPolicy.name` of each skill, as the logs note it.
        without: Skills that are not looked up.

    Raises:
        HomeError: If a name names no file, or the file is missing or another one now.
    """
    return {skill: _logged(skill, name) for skill, name in names.items() if skill not in without}


def _logged(skill: str, name: str) -> str:
    if name == ORACLE:
        return ORACLE
    named = re.fullmatch(r"(.+) \(SHA-256 ([0-9a-f]+)\)", name, re.DOTALL)
    if named is None:
        raise HomeError(f"{skill} of these logs was {name!r}, which names no file: --policies {skill}=FILE names one")
    where, sha256 = named.groups()
    shipped = where.startswith(_SHIPPED_AS)
    path = SHIPPED / f"{where.removeprefix(_SHIPPED_AS)}.safetensors" if shipped else Path(where)
    if not path.exists() or not hashlib.sha256(path.read_bytes()).hexdigest().startswith(sha256):
        now = "is another one now" if path.exists() else "is missing"
        raise HomeError(f"{skill} of these logs was {name}; that file {now}: --policies {skill}=FILE names one")
    return str(path)


def shipped_policy(task: str, policy: str, train_seed: int) -> Path | None:
    """Return the file of a shipped policy, the task's own before one trained for all tasks; None when there is none."""
    paths = [folder / f"seed-{train_seed}.safetensors" for folder in _folders(task, policy)]
    return next((path for path in paths if path.exists()), None)


def shipped_seeds(task: str, policy: str) -> list[int]:
    """Return the training seeds of which a policy is shipped."""
    paths = [path for folder in _folders(task, policy) for path in folder.glob("seed-*.safetensors")]
    return sorted({int(path.stem.removeprefix("seed-")) for path in paths})


def _folders(task: str, policy: str) -> list[Path]:
    return [SHIPPED / each / policy for each in dict.fromkeys((task, LEARNED_ON.get(policy, task)))]


def choose_policies(
    task: str, train_seed: int, chosen: Mapping[str, str] | None = None, how: ReleaseChoice | None = None
) -> dict[SkillName, SkillPolicy]:
    """Return the policy of each skill of a task.

    Args:
        task: Name of the task.
        train_seed: Number of the training seed, from 0: number k takes each skill's shipped policy with the
            k-th lowest seed, which differs from k where a seed fell below 90 % and is not shipped. `{seed}` in a path
            stands for it. UNTRAINED where no skill is learned.
        chosen: Skill to path or "oracle"; skills that are not named get the shipped policy, or the oracle without one.
        how: The release choice, which decides the place policy; the benchmark's when None.

    Raises:
        HomeError: If a skill is unknown or scripted, a file is given for a skill that the task never uses, a file is
            missing, there is no policy of this training seed though there is one of another, or none was trained for
            what `how` asks: the oracle does not stand in for one that should be there, for it would pass for a result
            of that training.
    """
    chosen, how = dict(chosen or {}), how or read_release("rl")
    unknown = chosen.keys() - SKILLS.keys()
    if unknown:
        raise HomeError(f"no skill is named {sorted(unknown)[0]!r}; there are {', '.join(SKILLS)}")
    learned = [each for each in dict.fromkeys(step.skill for step in get_task(task).skills) if each != "reset_arm"]
    unused = [skill for skill, named in chosen.items() if named != ORACLE and skill not in learned]
    if unused:
        why = "reset_arm is scripted" if unused[0] == "reset_arm" else f"{task} never uses {unused[0]}"
        raise HomeError(f"{why}; the skills of {task} that need a policy are {', '.join(learned)}")
    result: dict[SkillName, SkillPolicy] = {}
    for skill in learned:
        named = chosen.get(skill)
        path: Path | None
        if named is None:
            policy = how.policy if skill == "place" else skill
            seeds = shipped_seeds(task, policy)
            path = shipped_policy(task, policy, seeds[train_seed]) if 0 <= train_seed < len(seeds) else None
            if path is None and seeds and train_seed != UNTRAINED:
                raise HomeError(
                    f"no policy of training seed {train_seed} is shipped for {policy} on {task} (there are "
                    f"{len(seeds)}): train one (perdure home train {skill} --task {task} --seeds "
                    f"{train_seed}) and name it: --policies {skill}=FILE, where {{seed}} stands for the seed"
                )
            if path is None and skill == "place" and how.policy != "place":
                raise HomeError(
                    f"no policy is shipped for {how.name} on {task} (training seed {train_seed}): "
                    f"train one (perdure home train place) and name it: --policies place=FILE"
                )
        else:
            path = None if named == ORACLE else Path(named.replace("{seed}", str(train_seed)))
        if path is not None and not path.exists():
            raise HomeError(f"there is no policy {path} for {skill}")
        result[skill] = read_policy(ORACLE if path is None else str(path))
    return result


def make_agents(policies: Mapping[SkillName, SkillPolicy], strategy: str) -> dict[str, SkillAgent]:
    """Return an agent for each skill, that of place behind its arm."""
    oracle = Oracle()
    agents: dict[str, SkillAgent] = {"reset_arm": Scripted()}
    for skill, chosen in policies.items():
        agent: SkillAgent = oracle if chosen.policy is None else Learned(chosen.policy)
        agents[skill] = make_strategy(strategy, Oracle() if agent is oracle else agent) if skill == "place" else agent
    return agents


def read_policy(source: str) -> SkillPolicy:
    """Return a policy's file, or "oracle"."""
    if source == ORACLE:
        return SkillPolicy(ORACLE, "", None)
    return SkillPolicy(source, hashlib.sha256(Path(source).read_bytes()).hexdigest(), load_policy(source))
