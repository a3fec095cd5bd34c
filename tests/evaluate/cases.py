"""Robots with a known answer: reward traces within the training horizon and far beyond it.

`ROBOTS` are several episodes of one policy, by what is hard about them. `CHOSEN_ON` are the cases on which thresholds
and windows were tried.
`LABELED` are others, looked at only afterwards; they use other rates, offsets, periods and seeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl

from perdure.evaluate.episodes import window_steps
from perdure.evaluate.judge import judge_table
from perdure.evaluate.reference import Idle
from perdure.evaluate.verdict import make_score_scale
from perdure.policy.reference import BIN_STEPS, Reference
from perdure.report.groups import NO_CLOCK
from perdure.report.schema import COLUMNS, GOALS, RAW

T, EPISODES = 1000, 20

Rewards = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""Step numbers from 1 -> rewards."""


@dataclass(frozen=True)
class Case:
    """A robot. `never worked` and `cannot tell` are said of its policy, the rest of its episode."""

    name: str
    expected: str
    within: Rewards
    """Its rewards within the training horizon."""
    beyond: Rewards | None = None
    """Its rewards in deployment; by default the same function."""
    idle: float = 0.0
    """Reward per step of the zero action; random actions earn `spread` less."""
    spread: float = 0.0
    task: float = math.nan
    steps: int = 20_000
    ends: int | None = None
    reason: str = "survived"
    at_goal: bool = False
    """Its last step is a success, the first one."""
    falls_within: int | None = None
    """Step at which its reference episodes end."""
    every_other_falls: int | None = None
    """Step at which every other reference episode ends."""
    horizon: int = T

    def reference(self) -> Reference:
        rng = np.random.default_rng(abs(hash_of(self.name)))
        lengths = np.full(EPISODES, self.falls_within or self.horizon)
        lengths[::2] = self.every_other_falls or lengths[0]
        rewards = np.zeros((EPISODES, self.horizon))
        for episode, length in enumerate(lengths):
            rewards[episode, :length] = self.within(np.arange(1, length + 1), rng)
        bins = rewards.reshape(EPISODES, self.horizon // BIN_STEPS, BIN_STEPS).sum(axis=2)
        ended = (lengths < self.horizon) | (self.falls_within is not None)
        return Reference(self.horizon, bins, lengths, ended, np.zeros(1), np.ones(1))

    def episode(self) -> tuple[np.ndarray, np.ndarray, int, str]:
        """Steps, returns, end step and end reason of one long episode."""
        rng = np.random.default_rng(abs(hash_of(self.name)) + 1)
        lasts = self.ends or self.steps
        rewards = np.zeros(self.steps)
        rewards[:lasts] = (self.beyond or self.within)(np.arange(1, lasts + 1), rng)
        marks = window_steps(self.steps)
        return marks, rewards.cumsum()[marks - 1], lasts, self.reason


def hash_of(name: str) -> int:
    return sum(ord(letter) * 31**k for k, letter in enumerate(name)) % 2**31


def steady(rate: float, noise: float = 0.3) -> Rewards:
    return lambda step, rng: rate + noise * rng.standard_normal(len(step))


def switch(at: int, before: Rewards, after: Rewards) -> Rewards:
    return lambda step, rng: np.where(step <= at, before(step, rng), after(step, rng))


def sparse(every: float, size: float) -> Rewards:
    """A reward now and then, after exponential waiting times."""
    return lambda step, rng: size * (rng.random(len(step)) < 1.0 / every)


def periodic(period: int, size: float, low: float = 0.0) -> Rewards:
    """Paid in the second half of each period; the phase is drawn."""

    def rewards(step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        phase = rng.integers(period)
        return np.where((step + phase) % period >= period / 2, size, low)

    return rewards


def drift(begin: float, end: float, over: int) -> Rewards:
    return lambda step, rng: begin + (end - begin) * np.minimum(step / over, 1.0) + 0.2 * rng.standard_normal(len(step))


def bonus(at_start: float, rewards: Rewards) -> Rewards:
    return lambda step, rng: rewards(step, rng) + at_start * (step == 1)


def work_and_pause(period: int, size: float, share: float) -> Rewards:
    """Pays in the first part of each period, from the start on."""
    return lambda step, rng: size * ((step - 1) % period < share * period) + 0.05 * rng.standard_normal(len(step))


def penalties(every: float, size: float, rewards: Rewards) -> Rewards:
    return lambda step, rng: rewards(step, rng) - size * (rng.random(len(step)) < 1.0 / every)


def glitch(at: int, size: float, rewards: Rewards) -> Rewards:
    return lambda step, rng: rewards(step, rng) + size * (step == at)


def bouts(share: float, length: int, rewards: Rewards, other: Rewards) -> Rewards:
    """Stretches of `length` steps of which a share is spent otherwise."""

    def mixed(step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        other_bouts = rng.random(len(step) // length + 1) < share
        return np.where(other_bouts[(step - 1) // length], other(step, rng), rewards(step, rng))

    return mixed


CHOSEN_ON = (
    Case("steady", "holds", steady(3.0), idle=1.0),
    Case("lies down at 7,000", "fails silently", steady(3.0), switch(7000, steady(3.0), steady(1.0, 0.01)), idle=1.0),
    Case("slows to half", "decays", steady(4.0), drift(4.0, 2.0, 10_000)),
    Case("rare rewards", "holds", sparse(80, 10.0)),
    Case("rare rewards stop", "fails silently", sparse(80, 10.0), switch(5000, sparse(80, 10.0), steady(0.0, 0.0))),
    Case("gait with a period of 300", "holds", periodic(300, 2.0)),
    Case("cost task", "holds", steady(-1.0), idle=-6.0),
    Case("cost task, lost", "fails silently", steady(-1.0), switch(9000, steady(-1.0), steady(-6.5)), idle=-6.0),
    Case("stands", "never worked", steady(1.0, 0.001), idle=0.97, task=3.1),
    Case("falls", "falls", steady(2.0), ends=3700, reason="terminated"),
    # pauses, single odd rewards, few windows
    Case("bonus, then half", "decays", bonus(3000.0, steady(3.0)), bonus(3000.0, steady(1.5))),
    Case("recovers late", "decays", steady(3.0), switch(4000, steady(3.0), switch(17_500, steady(0.0), steady(3.0)))),
    Case("pauses half of the time, and at the end", "decays", steady(3.0), work_and_pause(5000, 3.0, 0.5)),
    Case(
        "pauses half of the time, not at the end", "decays", steady(3.0), work_and_pause(5000, 3.0, 0.5), steps=22_500
    ),
    Case("pauses a fifth of the time", "holds", steady(3.0), work_and_pause(4000, 3.0, 0.8)),
    Case("period of 3,000, seen in pieces", "holds", periodic(3000, 2.0), steps=100_000),
    Case("0.9 to 0.7", "decays", steady(3.0), drift(2.7, 2.1, 18_000)),
    Case("stands still near the end", "decays", steady(3.0), switch(18_900, steady(3.0), steady(0.0))),
    Case("one odd reward while it stands still", "fails silently", steady(3.0), glitch(19_500, 3000.0, steady(0.0))),
    Case("heavy tails", "holds", lambda step, rng: 1.0 + rng.standard_t(2, len(step))),
)

SLIDES_BACK = steady(-0.7)
LIES = steady(1.0, 0.002)

LABELED = (
    # healthy
    Case("walks", "holds", steady(4.8), idle=0.9, task=4.9),
    Case("walks slowly", "holds", steady(1.6), idle=0.9, task=4.9),
    Case("gets better", "holds", steady(2.0), drift(2.0, 5.0, 15_000)),
    Case("loses a tenth", "holds", steady(5.0), drift(5.0, 4.5, 12_000)),
    Case(
        "stumbles once and goes on",
        "holds",
        steady(3.0),
        switch(6000, steady(3.0), switch(6400, steady(0.0), steady(3.0))),
    ),
    Case("noise twice the rate", "holds", steady(1.0, 2.0)),
    Case("offset of +100", "holds", steady(103.0), idle=100.0),
    Case("offset of -100", "holds", steady(-97.0), idle=-100.0),
    Case("tiny unit", "holds", steady(0.003, 0.0003), idle=0.001),
    Case("huge unit", "holds", steady(3e6, 3e5), idle=1e6),
    Case("cost of energy", "holds", steady(-0.4), idle=-2.0),
    Case("sparse, every 150 steps", "holds", sparse(150, 5.0)),
    Case("sparse, every 400 steps", "holds", sparse(400, 1.0), steps=100_000),
    Case("sparse cost", "holds", sparse(100, -1.0), idle=-0.5),
    Case("period of 90", "holds", periodic(90, 3.0, -1.0)),
    Case("period of 700", "holds", periodic(700, 1.0)),
    Case("bonus at the start", "holds", bonus(500.0, steady(1.5))),
    Case("penalty at the start", "holds", bonus(-500.0, steady(1.5))),
    Case("last window incomplete", "holds", steady(2.5), steps=12_345),
    Case("a quarter of the time idle, as in training", "holds", bouts(0.25, 50, steady(3.0), steady(0.0))),
    Case("healthy for a million steps", "holds", steady(3.0), steps=1_000_000),
    Case("pauses 600 of 3,000 steps", "holds", steady(2.0), work_and_pause(3000, 2.2, 0.8)),
    Case("period of 2,400, seen in pieces", "holds", periodic(2400, 3.0), steps=100_000),
    Case("1.1 to 0.82", "holds", steady(5.0), drift(5.5, 4.1, 17_000)),
    Case(
        "stumbles near the end",
        "holds",
        steady(2.0),
        switch(19_000, steady(2.0), switch(19_300, steady(0.0), steady(2.0))),
    ),
    Case("penalties, as in training", "holds", penalties(250, 100.0, steady(2.0)), idle=-1.0),
    Case("only falls cost, and it never falls", "holds", steady(0.0, 0.0), idle=-2.0),
    Case("a first step worth the whole episode", "holds", bonus(3000.0, steady(3.0))),
    # silent failures
    Case("on its back from the start", "fails silently", steady(3.5), LIES, idle=1.0, task=4.1),
    Case(
        "on its back within the first window", "fails silently", steady(3.5), switch(150, steady(3.5), LIES), idle=1.0
    ),
    Case("on its back near the end", "fails silently", steady(3.5), switch(17_000, steady(3.5), LIES), idle=1.0),
    Case("slides backwards from the start", "fails silently", steady(5.0), SLIDES_BACK),
    Case("slides backwards later", "fails silently", steady(5.0), switch(4000, steady(5.0), SLIDES_BACK)),
    Case("sparse rewards end", "fails silently", sparse(150, 5.0), switch(8000, sparse(150, 5.0), steady(0.0, 0.0))),
    Case("period ends", "fails silently", periodic(500, 2.0), switch(9000, periodic(500, 2.0), steady(0.0, 0.01))),
    Case("cost grows", "fails silently", steady(-0.4), drift(-0.4, -2.2, 9000), idle=-2.0),
    Case("offset, stops", "fails silently", steady(-97.0), switch(5000, steady(-97.0), steady(-100.0)), idle=-100.0),
    Case("bonus at the start, then nothing", "fails silently", bonus(500.0, steady(1.5)), bonus(500.0, steady(0.0))),
    Case("drifts to nothing", "fails silently", steady(3.0), drift(3.0, 0.0, 14_000)),
    Case("bonus, then on its back", "fails silently", bonus(2000.0, steady(2.0)), bonus(2000.0, LIES), idle=1.0),
    Case(
        "slides back, last window incomplete",
        "fails silently",
        steady(2.0),
        switch(11_000, steady(2.0), SLIDES_BACK),
        steps=17_777,
    ),
    Case("stops at step 40", "fails silently", steady(3.5), switch(40, steady(3.5), LIES), idle=1.0),
    Case("one odd reward while on its back", "fails silently", steady(4.0), glitch(18_300, 5000.0, LIES), idle=1.0),
    Case(
        "on its back after an early stumble",
        "fails silently",
        steady(3.0),
        switch(2000, steady(3.0), switch(2800, LIES, switch(9000, steady(3.0), LIES))),
        idle=1.0,
    ),
    # decay
    Case("works a third of the time", "decays", steady(2.0), work_and_pause(6000, 2.0, 1 / 3)),
    Case(
        "idle in the middle", "decays", steady(2.0), switch(3000, steady(2.0), switch(13_000, steady(0.0), steady(2.0)))
    ),
    Case("1.0 to 0.68", "decays", steady(5.0), drift(5.0, 3.4, 17_000)),
    Case(
        "cost with an offset, half lost",
        "decays",
        steady(-27.0),
        switch(7000, steady(-27.0), steady(-28.6)),
        idle=-30.0,
    ),
    Case("loses a half", "decays", steady(6.0), drift(6.0, 3.0, 10_000)),
    Case("loses two thirds at once", "decays", steady(3.0), switch(5000, steady(3.0), steady(1.0))),
    Case("works half of the time", "decays", steady(4.0), bouts(0.5, 100, steady(4.0), steady(0.0))),
    # ends
    Case("falls at once", "falls", steady(3.0), ends=30, reason="terminated", falls_within=30),
    Case("falls late", "falls", steady(3.0), ends=19_990, reason="terminated"),
    Case("stops at a time limit that is reported as its end", "falls", steady(3.0), ends=1000, reason="terminated"),
    # goals: without a gain over an idle robot, as where each step before the goal costs the same
    Case(
        "ends at its goal", "reaches its goal", steady(-1.0, 0.0), idle=-1.0, ends=43, reason="terminated", at_goal=True
    ),
    Case("is cut at its goal", "reaches its goal", steady(2.0), ends=50, reason="truncated", at_goal=True),
    Case("goes on at its goal", "holds", steady(2.0), at_goal=True),
    Case("blows up at its goal", "diverges", steady(2.0), ends=50, reason="diverged", at_goal=True),
    Case("blows up", "diverges", steady(3.0), ends=800, reason="diverged"),
    # policies that never worked
    Case("stands since training", "never worked", LIES, idle=0.97, task=3.1),
    Case("sways a little", "never worked", steady(1.05), idle=1.0, task=4.1),
    Case("sways a little on a task without a level", "never worked", steady(1.05, 0.05), idle=1.0, spread=0.5),
    Case("crawls backwards", "never worked", steady(-0.5)),
    Case("random walk of the reward", "never worked", steady(0.0, 3.0)),
    Case("costs more than idle", "never worked", steady(-9.0), idle=-8.0),
    # what cannot be judged
    Case("rewards too rare for the evaluation", "unknown", sparse(900, 100.0), steps=6_000),
    Case("shorter than its windows", "unknown", sparse(300, 5.0), steps=1500),
    Case("cut by its environment", "cut", steady(3.0), ends=5000, reason="truncated"),
)


@dataclass(frozen=True)
class Robots:
    """Episodes of one policy, and what must be said of them."""

    name: str
    label: str
    says: str
    """Part of the headline or of the sentence under it."""
    episodes: tuple[Case, ...]
    """All have the reference of the first."""
    disturbed: tuple[Case, ...] = ()
    clock: str = NO_CLOCK
    movement: tuple[float, ...] = ()
    """Of each calm episode in its last tenth, in training standard deviations; by default 0.3."""

    def table(self) -> pl.DataFrame:
        first = self.episodes[0]
        scale = make_score_scale(first.reference(), Idle(first.idle, first.idle - first.spread), first.task)
        kind, _, number = self.clock.rstrip(")").partition("(")
        labels = {"policy": "ppo", "method": "ppo", "task": "Robot", "train_seed": 0}
        labels |= {"train_horizon": float(first.horizon)}
        labels |= {"clock": self.clock, "clock_kind": kind, "clock_steps": float(number or math.nan), "end_detail": ""}
        labels |= {"not_applied": "", "step_seconds": 0.036, "movement_first": 0.3}
        rows, has_goal = [], any(case.at_goal for case in (*self.episodes, *self.disturbed))
        for disturbance, cases in (("none", self.episodes), ("standard-1", self.disturbed)):
            for seed, case in enumerate(cases):
                steps, returns, end, reason = case.episode()
                moved = self.movement[seed] if self.movement and disturbance == "none" else 0.3
                mine = labels | {"eval_seed": seed, "disturbance": disturbance, "test_horizon": case.steps}
                goals = (end, 1.0, 1.0) if case.at_goal else GOALS.values() if has_goal else (math.nan,) * 3
                mine |= {"end_step": end, "end_reason": reason, "movement_last": moved}
                mine |= dict(zip(GOALS, goals, strict=True))
                lives = reason == "survived"
                rows += [
                    mine | {"step": int(step), "return": total, "alive": lives or step < end}
                    for step, total in zip(steps, returns, strict=True)
                ]
        raw = pl.DataFrame(rows, infer_schema_length=None).select(pl.col(name).cast(COLUMNS[name]) for name in RAW)
        return judge_table(raw, {("ppo", 0): scale})


def several(count: int, case: Case, **changes: Any) -> tuple[Case, ...]:
    """Return a case from several start states: other draws of the same noise."""
    return tuple(replace(case, name=f"{case.name} {k}", **changes) for k in range(count))


def ending(steps: Sequence[int], case: Case) -> tuple[Case, ...]:
    """Return a case once for each step at which it ends."""
    return tuple(replace(each, ends=at) for at, each in zip(steps, several(len(steps), case), strict=True))


def falling(steps: Sequence[int], case: Case) -> tuple[Case, ...]:
    """Return a case once for each step at which it falls."""
    return ending(steps, replace(case, reason="terminated"))


def uneven(low: float, high: float) -> Rewards:
    """A rate drawn for each episode: no mean can be told from a few of them."""
    return lambda step, rng: np.where(rng.random() < 0.5, low, high) + 0.0 * step


WALKS = Case("walks", "holds", steady(3.0), idle=1.0, steps=10_000)
EXACT = replace(WALKS, within=steady(3.0, 0.0))
NOISY = replace(WALKS, within=uneven(-3.0, 8.0))
NEVER = replace(WALKS, within=steady(3.0), falls_within=300)
IDLE_BEFORE = replace(WALKS, beyond=LIES)
CUT = replace(WALKS, ends=300, reason="truncated")

REACHES = Case(
    "reaches", "reaches its goal", steady(-1.0, 0.0), idle=-1.0, steps=200, reason="terminated", at_goal=True
)
MISSES = replace(REACHES, reason="survived", at_goal=False)
LIMIT = "every episode ends at step {}: the environment may report its time limit as a termination"
LIMITED = replace(WALKS, ends=T, reason="terminated", falls_within=T)

ROBOTS = {
    "falls within the horizon": (
        Robots(
            "as in training",
            "falls",
            "ppo: falls within its own training horizon in 8 of 8 episodes: train longer",
            falling((300, 280, 290, 310, 305, 295, 301, 299), NEVER),
        ),
        Robots(
            "deployed alone",
            "falls",
            "falls within its own training horizon in 3 of 4 episodes: train longer",
            falling((600, 700, 900, 4000), WALKS),
        ),
        Robots(
            "under a clock that it was not trained with",
            "falls",
            "falls within its own training horizon in 4 of 4 episodes",
            falling((600, 700, 900, 800), WALKS),
            clock="constant(0)",
        ),
        Robots("later", "falls", "ppo: falls in 4 of 4 episodes", falling((1001, 3000, 2000, 4000), WALKS)),
    ),
    "noisy reference": (
        Robots(
            "some fall and some lie",
            "cannot tell",
            "cannot tell in 5 of 8 episodes: 3 of 8 fall at steps 200 to 900, 5 of 8 stay nearly motionless since "
            "step 4,000",
            (
                *falling((900, 200, 400), NOISY),
                *several(5, replace(NOISY, beyond=switch(4000, steady(3.0), LIES))),
            ),
            movement=(math.nan,) * 3 + (0.001,) * 5,
        ),
        Robots(
            "most fall",
            "falls",
            "falls in 3 of 4 episodes",
            (*falling((2000, 3000, 4000), NOISY), *several(1, NOISY)),
        ),
        Robots(
            "all move", "cannot tell", "cannot tell in 6 of 6 episodes: all 6 move until the end", several(6, NOISY)
        ),
        Robots(
            "motionless, but the reward never settles",
            "cannot tell",
            "cannot tell in 6 of 6 episodes: all 6 stay nearly motionless; within its",
            several(6, replace(NOISY, beyond=steady(3.0, 9.0))),
            movement=(0.001,) * 6,
        ),
    ),
    "cut by the environment": (
        Robots(
            "at one step",
            "cannot tell",
            "1 of 4 falls at step 200; the environment truncates episodes at step 300: remove its counter.",
            (*several(3, CUT), replace(CUT, ends=200, reason="terminated")),
        ),
        Robots(
            "at several steps",
            "cannot tell",
            "in 4 of 4 episodes; the environment ended the episodes, for a reason that is no failure.",
            ending((300, 300, 310, 300), CUT),
        ),
    ),
    "coinciding episodes": (
        Robots(
            "hold",
            "holds",
            "in 10 of 10 episodes; score against its own training at the end: 1.00; 10 start states behave as one",
            several(10, EXACT),
        ),
        Robots(
            "start states that differ",
            "holds",
            "in 10 of 10 episodes (95 % interval 69 % to 100 %); score",
            tuple(replace(each, beyond=steady(2.9 + 0.04 * k, 0.0)) for k, each in enumerate(several(10, EXACT))),
        ),
        Robots(
            "lie down together",
            "fails silently",
            "fails silently in 10 of 10 episodes; since step 4,000; 10 start states behave as one",
            several(10, replace(EXACT, beyond=switch(4000, steady(3.0, 0.0), steady(1.0, 0.0)))),
        ),
    ),
    "disturbed": (
        Robots(
            "half fall by step 600",
            "holds",
            "ppo: holds when calm; under standard-1 half of the episodes fail by step 600",
            several(3, EXACT),
            (*falling((300, 600), WALKS), *several(2, WALKS)),
        ),
        Robots(
            "holds",
            "holds",
            "ppo: holds for 10,000 steps when calm and for 10,000 under standard-1",
            several(3, EXACT),
            several(4, WALKS),
        ),
        Robots(
            "some fall",
            "holds",
            "under standard-1 falls in 1 of 4 episodes",
            several(3, EXACT),
            (*falling((5000,), WALKS), *several(3, WALKS)),
        ),
        Robots(
            "loses half of its speed",
            "holds",
            "ppo: holds when calm; under standard-1 half of the episodes fail from the start",
            several(3, EXACT),
            several(4, replace(WALKS, beyond=steady(2.0))),
        ),
        Robots(
            "lies down",
            "holds",
            "ppo: holds when calm; under standard-1 half of the episodes fail by step 2,000",
            several(3, EXACT),
            several(4, replace(WALKS, beyond=switch(2000, steady(3.0), LIES))),
        ),
        Robots(
            "falls calm and disturbed",
            "falls",
            "ppo: when calm falls in 4 of 4 episodes; under standard-1 half of the episodes fail by step 700",
            falling((3000, 4000, 5000, 6000), WALKS),
            falling((500, 700, 900, 1100), WALKS),
        ),
    ),
    "ends at its goal": (
        Robots(
            "all but one in time",
            "reaches its goal",
            "reaches its goal in 19 of 20 episodes, after 40 steps (median, 1.44 s)",
            (*ending(range(31, 50), REACHES), *several(1, MISSES)),
        ),
        Robots(
            "most fall before it",
            "falls",
            "falls within its own training horizon in 7 of 10 episodes: train longer; half of the episodes have failed "
            "by step 14; reaches its goal in 3 of 10 episodes, after 41 steps",
            (*ending((40, 41, 42), REACHES), *falling(range(10, 17), MISSES)),
        ),
        Robots(
            "misses it when disturbed",
            "reaches its goal",
            "under standard-1 misses its goal in 3 of 4 episodes",
            ending((40, 41, 42, 43), REACHES),
            (*ending((90,), REACHES), *several(3, MISSES)),
        ),
    ),
    "time limit as termination": (
        Robots("at the training horizon", "falls", LIMIT.format("1,000"), several(8, LIMITED)),
        Robots(
            "within the training horizon",
            "falls",
            LIMIT.format("400"),
            several(8, replace(LIMITED, ends=400, falls_within=400)),
        ),
        Robots(
            "beyond the training horizon",
            "falls",
            LIMIT.format("5,000"),
            several(8, replace(LIMITED, ends=5000, falls_within=None)),
        ),
    ),
    "exact ends": (
        Robots(
            "idle, then falls",
            "falls",
            "ppo: idle from the start; all 4 fall at step 9,980",
            falling((9980,) * 4, IDLE_BEFORE),
        ),
    ),
}
"""Truth about all episodes of a policy together, by what is hard about it."""
