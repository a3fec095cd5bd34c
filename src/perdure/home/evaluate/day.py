"""Days without a reset: errand after errand in the same home, until the time is up; resumable.

The homes of one training seed and one evaluation seed run their errands side by side, in rounds of one errand each. An
errand begins in the state in which the one before it ended: robot, objects, drawers and doors. Between two errands the
simulator is set to this state anew, so that speeds are zero, the hand is empty, and objects that passed through the
robot since they were held collide with it again. After every round the homes are written down. A killed run goes on
from there, with the same results.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from perdure.errors import PerdureError
from perdure.home.evaluate.day_table import (
    DIVERGED,
    GOES_ON,
    NO_ERRAND_LEFT,
    TIME_IS_UP,
    Row,
    errand_columns,
    join_days,
    read_days,
    to_frame,
    write_days,
)
from perdure.home.evaluate.execute import Executor
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.policies import SkillPolicy, choose_policies, make_agents
from perdure.home.evaluate.protocol import (
    Block,
    EvaluationProtocol,
    check_distinct_seeds,
    make_blocks,
    policy_digests,
    run_config,
)
from perdure.home.skills import Skill, get_skill
from perdure.home.tasks.errands import Errand, HomeState, draw_errand, errand_generator, first_state, state_after
from perdure.home.tasks.planners import ClosedLoop, needed_skills
from perdure.home.tasks.tasks import SkillName, get_task
from perdure.runs import Observer, Store, Unit, Work, run_missing, write_atomic
from perdure.schema import read_json

HOMES_SIDE_BY_SIDE = 20
"""Homes of one unit. More of them cost less each; fewer keep more cores busy."""
TABLE = "day.parquet"
_CHECKPOINT = "homes.json"

Policies = Mapping[str, Mapping[SkillName, SkillPolicy]]
"""Task to the policy of each skill."""


@dataclass(frozen=True)
class DayProtocol:
    """What to run.

    Raises:
        PerdureError: If there is no such task, split or strategy, or a number is out of range.
    """

    errands: tuple[str, ...]
    """Tasks, in the order in which they alternate."""
    hours: float
    """Simulated hours. An errand begins before they are up, and ends."""
    first: EvaluationProtocol
    """Release strategy, split, seeds, policies and options, with the first task. Its episodes are the homes."""

    def __post_init__(self) -> None:
        if not self.errands:
            raise PerdureError("errands must name at least one task")
        for task in self.errands:
            get_task(task)
        if not 0.0 < self.hours <= 10_000.0:
            raise PerdureError(f"hours must be above 0 and at most 10,000, not {self.hours:g}")

    @property
    def folder(self) -> str:
        """Where the store keeps all of it, such as `day/tidy_house-set_table/4-hours/eval/rl-closed-no-fallback`."""
        _, split, strategy = self.first.folder.split("/")
        return f"day/{'-'.join(self.errands)}/{self.hours:g}-hours/{split}/{strategy}"

    def policies_of(self, train_seed: int) -> dict[str, dict[SkillName, SkillPolicy]]:
        """Return the policy of each skill by task, for a training seed; PerdureError as for `choose_policies`."""
        release = self.first.release
        return {
            task: choose_policies(task, train_seed, self.protocol_of(task).policies, release, ClosedLoop.name)
            for task in self.errands
        }

    def protocol_of(self, task: str) -> EvaluationProtocol:
        """Return the protocol of one of the errands' tasks, with the policies that were named for its skills."""
        needed = {each: needed_skills(get_task(each), ClosedLoop.name) for each in self.errands}
        known = {skill for skills in needed.values() for skill in skills}
        # A skill that no errand uses is left to the first one, which refuses it.
        policies = {
            skill: source
            for skill, source in self.first.policies.items()
            if skill in needed[task] or (skill not in known and task == self.errands[0])
        }
        return replace(self.first, task=task, policies=policies)

    def skills(self, task: str) -> dict[str, Skill]:
        """Return the skills that an errand of a task may need, whatever is open in the home."""
        release = self.first.release.options
        names = needed_skills(get_task(task), ClosedLoop.name)
        return {name: get_skill(name, **(release if name == "place" else {})) for name in names}


def home_blocks(protocol: DayProtocol, store: Store) -> Iterator[Block]:
    """Yield all blocks of a protocol, see `make_blocks`."""
    yield from make_blocks(protocol.first, protocol.folder, "homes", HOMES_SIDE_BY_SIDE, store)


def day_units(protocol: DayProtocol, command: str, store: Store) -> Iterator[Unit]:
    """Yield a unit for each block; PerdureError if a policy is missing."""
    policies = {seed: protocol.policies_of(seed) for seed in range(protocol.first.train_seeds)}
    digests = {seed: {task: policy_digests(each) for task, each in acting.items()} for seed, acting in policies.items()}
    check_distinct_seeds(digests)
    for block in home_blocks(protocol, store):
        config = {
            **run_config(protocol.first),
            **asdict(block),
            "errands": list(protocol.errands),
            "hours": protocol.hours,
            "policies": digests[block.train_seed],
        }
        acting = policies[block.train_seed]
        arguments = {"protocol": protocol, "block": block, "policies": acting, "command": command}
        size = float(block.last - block.first + 1)
        cores = len(os.sched_getaffinity(0))
        yield Unit(block.key, config, f"{__name__}:run_homes", arguments, size=size, cores=cores)


@dataclass(frozen=True)
class HomeDay:
    """The day of a home so far."""

    home: int
    state: HomeState
    rows: tuple[Row, ...] = ()
    """Of its errands, see `day_table.COLUMNS`."""

    @property
    def hours(self) -> float:
        """Simulated hours so far."""
        return float(self.rows[-1]["end"]) if self.rows else 0.0

    @property
    def over(self) -> bool:
        """Whether it has no further errand."""
        return bool(self.rows) and self.rows[-1]["then"] != GOES_ON


@dataclass(frozen=True)
class Asked:
    """A home with its next errand."""

    day: HomeDay
    errand: Errand


def run_homes(work: Work, *, protocol: DayProtocol, block: Block, policies: Policies, command: str) -> bool:
    """Run the next errand of every home of a block; the function of the units.

    Returns:
        False when the homes were written down and the function must be called again; True when the table is written.

    Raises:
        PerdureError: If a policy file has changed since the unit was made, or a home has no errand at its start.
    """
    checkpoint = work.folder / _CHECKPOINT
    days: Sequence[HomeDay]
    if checkpoint.exists():
        days = read_json(checkpoint.read_bytes(), tuple[HomeDay, ...])
    else:
        homes = range(block.first, block.last + 1)
        states = [first_state(protocol.errands, protocol.first.split, home, block.eval_seed)[1] for home in homes]
        days = [HomeDay(home, state) for home, state in zip(homes, states, strict=True)]
    days = _round(protocol, block, policies, days, work.threads)
    work.report(sum(min(day.hours, protocol.hours) for day in days), len(days) * protocol.hours)
    if not all(day.over for day in days):
        write_atomic(checkpoint, json.dumps([asdict(day) for day in days]))
        return False
    notes = {
        "errands": json.dumps(protocol.errands),
        "hours": json.dumps(protocol.hours),
        "policies": json.dumps(
            {task: {skill: each.name for skill, each in acting.items()} for task, acting in policies.items()}
        ),
        "command": command,
    }
    write_days(work.folder / TABLE, to_frame([row for day in days for row in day.rows]), notes)
    checkpoint.unlink(missing_ok=True)
    return True


def _round(
    protocol: DayProtocol, block: Block, policies: Policies, days: Sequence[HomeDay], threads: int
) -> tuple[HomeDay, ...]:
    """Return the days after one more errand of each home whose day is not over."""
    after = {day.home: day for day in days}
    # What each home does next. A home that has nothing to do is over.
    by_task: dict[str, list[Asked]] = {}
    for day in days:
        if day.over:
            continue
        errand = next_errand(protocol, block.eval_seed, day)
        if errand is not None:
            by_task.setdefault(errand.task, []).append(Asked(day, errand))
        elif day.rows:
            after[day.home] = _ended(day, NO_ERRAND_LEFT)
        else:
            raise PerdureError(
                f"no errand of {', '.join(protocol.errands)} can be drawn at the start of home {day.home}"
            )
    # Homes with the same task run side by side.
    for task, asked in by_task.items():
        for day in _run_errands(protocol, block, policies[task], asked, threads):
            after[day.home] = day
    return tuple(after[day.home] for day in days)


def _ended(day: HomeDay, then: str) -> HomeDay:
    return replace(day, rows=(*day.rows[:-1], {**day.rows[-1], "then": then}))


def next_errand(protocol: DayProtocol, eval_seed: int, day: HomeDay) -> Errand | None:
    """Return the next errand of a home: of the task whose turn it is, else of the next one that can be drawn."""
    number = len(day.rows) + 1
    turn = (number - 1) % len(protocol.errands)
    tasks = dict.fromkeys(protocol.errands[turn:] + protocol.errands[:turn])
    first, _ = first_state(protocol.errands, protocol.first.split, day.home, eval_seed)
    for task in tasks:
        errand = draw_errand(task, first, day.state, errand_generator(eval_seed, day.home, number, task))
        if errand is not None:
            return errand
    return None


def _run_errands(
    protocol: DayProtocol,
    block: Block,
    policies: Mapping[SkillName, SkillPolicy],
    asked: Sequence[Asked],
    threads: int,
) -> Iterator[HomeDay]:
    """Yield the days of homes after their errands of one task."""
    options = replace(protocol.first.options, eval_seed=block.eval_seed, threads=threads)
    train_seed = block.train_seed if any(each.learned for each in policies.values()) else UNTRAINED
    executor = Executor(
        protocol.skills(asked[0].errand.task),
        make_agents(policies, protocol.first.release.strategy),
        options,
        place=protocol.first.place,
        train_seed=train_seed,
    )
    strategy = protocol.first.strategy
    named = {name: getattr(strategy, name) for name in ("place", "world", "planner", "fallback", "disturbance")}
    by_index = {each.errand.index: each for each in asked}
    learned = {skill for skill, each in policies.items() if each.learned}
    for log, lane in executor.run_to_end([each.errand for each in asked]):
        each = by_index[log.index]
        state = state_after(each.errand, lane)
        begin = each.day.hours
        end = begin + log.length / log.control_hz / 3600.0
        then = GOES_ON
        if log.diverged:
            then = DIVERGED
        elif end >= protocol.hours:
            then = TIME_IS_UP
        row = {
            "errands": " ".join(protocol.errands),
            "split": protocol.first.split,
            **named,
            "train_seed": train_seed,
            "eval_seed": block.eval_seed,
            "home": each.day.home,
            "errand": len(each.day.rows) + 1,
            "begin": begin,
            "end": end,
            **errand_columns(log, each.errand, each.day.state, state),
            "taken_over": sum(run.scripted and run.skill in learned for run in log.runs),
            "then": then,
        }
        yield HomeDay(each.day.home, state, (*each.day.rows, row))


def find_errands(
    protocol: DayProtocol, home: int, numbers: Sequence[int], train_seed: int = 0, eval_seed: int = 0
) -> dict[int, Errand]:
    """Return some errands of a home by their numbers, from 1; its day is run up to the last of them.

    Raises:
        PerdureError: If a policy is missing, or the day has no errand of that number.
    """
    if not numbers or min(numbers) < 1:
        raise PerdureError(f"errands are numbered from 1, not {', '.join(map(str, numbers)) or 'by nothing'}")
    policies = protocol.policies_of(train_seed)
    block = Block(protocol.folder, "homes", train_seed, eval_seed, home, home)
    day = HomeDay(home, first_state(protocol.errands, protocol.first.split, home, eval_seed)[1])
    found = {}
    for number in range(1, max(numbers) + 1):
        errand = None
        if not day.over:
            errand = next_errand(protocol, eval_seed, day)
        if errand is None:
            raise PerdureError(f"the day of home {home} has {number - 1} errands, so none has number {max(numbers)}")
        if number in numbers:
            found[number] = errand
        if number < max(numbers):
            (day,) = _run_errands(protocol, block, policies[errand.task], [Asked(day, errand)], threads=1)
    return found


def run_days(
    protocol: DayProtocol,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    command: str = "",
    observe: Observer = lambda status: None,
) -> Path:
    """Run what is missing of a protocol, and return the path of the table of all its days.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call resumes an interrupted one.
        cores: Cores to use; all by default. Results do not depend on it.
        on: Where to run, see `perdure.runs.make_workers`.
        command: The command that asked for it, noted in new tables.
        observe: Called with the progress of every unit, measured in simulated hours of all its homes.

    Raises:
        PerdureError: If a policy is missing, before anything is run, or a unit failed.
    """
    store = Store(out)
    units = list(day_units(protocol, command, store))
    store.warn_of_other_source(unit.key for unit in units)
    run_missing(units, out, on, cores, observe)
    read = [read_days(store.get(unit.key, unit.config) / TABLE) for unit in units]
    notes = dict(read[0][1])
    policies = {
        unit.config["train_seed"]: json.loads(each["policies"]) for unit, (_, each) in zip(units, read, strict=True)
    }
    notes["policies"] = json.dumps(policies)
    return write_days(store.root / protocol.folder / TABLE, join_days(frame for frame, _ in read), notes)
