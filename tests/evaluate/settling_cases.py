"""Policies that first reach a state and then keep it, and others whose reference hides what they can do.

Each has its reference episodes, three calm and eight disturbed episodes. Labels were written before the rules that they
test, by what the robot does: `holds`, `holds, but` (less than when calm, or with interruptions), `fails` (any failure)
or `cannot tell`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import polars as pl
from cases import Case, Rewards, Robots, bonus, bouts, periodic, several, sparse, steady

STEPS = 10_000


@dataclass(frozen=True)
class Settling:
    """A policy, and the verdict on its disturbed episodes."""

    name: str
    label: str
    within: Rewards
    """Its rewards within the training horizon."""
    disturbed: Rewards
    idle: float = 0.0
    horizon: int = 200
    calm: Rewards | None = None
    """Its rewards when calm, beyond the training horizon too; by default those within it."""
    fall_at: int | None = None
    """Step at which every other reference episode falls."""

    def table(self) -> pl.DataFrame:
        """Return the table of its episodes."""
        calm = Case(
            self.name,
            "",
            self.within,
            self.calm,
            idle=self.idle,
            steps=STEPS,
            horizon=self.horizon,
            every_other_falls=self.fall_at,
        )
        disturbed = replace(calm, beyond=self.disturbed)
        return Robots(self.name, "", "", several(3, calm), several(8, disturbed)).table()


def arrive(way: float, keep: Rewards, by: int) -> Rewards:
    """Earn `way` a step for a time drawn from half of `by` to `by`, then keep."""

    def rewards(step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        at = rng.integers(by // 2, by + 1)
        noise = 0.05 * abs(way) * rng.standard_normal(len(step))
        return np.where(step <= at, way + noise, keep(step, rng))

    return rewards


def ramp(begin: float, end: float, over: int) -> Rewards:
    """Change evenly from one rate to another."""
    return lambda step, rng: begin + (end - begin) * np.minimum(step / over, 1.0) + 0.1 * rng.standard_normal(len(step))


def paid_once(size: float, by: int, rewards: Rewards) -> Rewards:
    """Pay a bonus on arrival, and nothing before it."""

    def paid(step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        at = rng.integers(by // 2, by + 1)
        return np.where(step < at, 0.0, rewards(step, rng)) + size * (step == at)

    return paid


def gait(rate: float, period: int) -> Rewards:
    """A noise-free gait, which starts from rest."""
    return lambda step, rng: rate * (1.0 - np.exp(-step / 30.0)) + 0.3 * np.sin(2.0 * np.pi * step / period)


def once_late(size: float, at: int, rewards: Rewards) -> Rewards:
    """One large reward, in one of twenty episodes."""
    return lambda step, rng: rewards(step, rng) + size * (step == at) * (rng.random() < 0.05)


SWING_UP = arrive(-2.8, steady(-0.01, 0.01), 100)
UPRIGHT = steady(-0.01, 0.01)
FALLEN = steady(-5.0, 1.0)
REACHER = arrive(-0.12, steady(-0.015, 0.003), 25)
HAND = arrive(0.0, sparse(40, 5.0), 150)
GOAL = arrive(-1.0, steady(0.0, 0.0), 70)
DRONE = arrive(-20.0, steady(0.0, 0.2), 100)
WALKER = arrive(1.6, steady(3.0), 150)

SETTLING = (
    # Reach, then keep: a pendulum that swings up
    Settling("swing-up, never upright", "fails", SWING_UP, steady(-2.8, 0.5), idle=-5.9),
    Settling("swing-up, upright half of the time", "fails", SWING_UP, bouts(0.5, 60, UPRIGHT, FALLEN), idle=-5.9),
    Settling("swing-up, falls again and again", "holds, but", SWING_UP, bouts(0.2, 60, UPRIGHT, FALLEN), idle=-5.9),
    Settling("swing-up, little noise", "holds", SWING_UP, steady(-0.05, 0.05), idle=-5.9),
    Settling(
        "swing-up in a long episode, never upright", "fails", SWING_UP, steady(-2.8, 0.5), idle=-5.9, horizon=1000
    ),
    # an arm that reaches a point
    Settling("arm, never there", "fails", REACHER, steady(-0.11, 0.01), idle=-0.2, horizon=50),
    Settling("arm, circles the goal", "fails", REACHER, steady(-0.075, 0.01), idle=-0.2, horizon=50),
    Settling("arm, slightly off", "holds", REACHER, steady(-0.03, 0.005), idle=-0.2, horizon=50),
    # a hand that turns a cube to a goal, and then to the next
    Settling("hand, turns half as often", "fails", HAND, arrive(0.0, sparse(75, 5.0), 150), horizon=300),
    Settling("hand, turns nearly as often", "holds", HAND, arrive(0.0, sparse(43, 5.0), 150), horizon=300),
    # -1 a step until it is at its goal
    Settling(
        "goal, there half of the time", "fails", GOAL, bouts(0.5, 20, steady(0.0, 0.0), steady(-1.0, 0.0)), -1.0, 100
    ),
    Settling("goal, never there", "fails", GOAL, steady(-1.0, 0.0), -1.0, 100),
    Settling(
        "goal, nearly always there", "holds", GOAL, bouts(0.05, 10, steady(0.0, 0.0), steady(-1.0, 0.0)), -1.0, 100
    ),
    # an idle drone falls, which costs far more than the way up
    Settling("drone, on its way for ever", "fails", DRONE, steady(-19.0, 1.0), -100.0),
    Settling(
        "drone, away more than half of the time",
        "fails",
        DRONE,
        bouts(0.6, 80, steady(0.0, 0.2), steady(-20.0, 1.0)),
        -100.0,
    ),
    Settling("drone, little wind", "holds", DRONE, steady(-2.0, 0.5), -100.0),
    # Long settling, drifting and falling references
    Settling("speeds up over 600 steps", "fails", ramp(0.0, 4.0, 600), steady(2.4), horizon=1000),
    Settling("speeds up over the whole horizon", "fails", ramp(0.0, 4.0, 1000), steady(2.0), horizon=1000),
    Settling("lies down in its references", "fails", ramp(5.0, 0.5, 600), steady(0.5, 0.05), horizon=1000),
    Settling("half of its references fall", "fails", ramp(0.0, 4.0, 200), steady(2.5), horizon=1000, fall_at=150),
    Settling(
        "calm twice as fast as in training", "holds, but", steady(2.0), steady(1.9), calm=steady(4.0), horizon=1000
    ),
    # Rare large values
    Settling("bonus on arrival, then as before", "holds", paid_once(100.0, 80, steady(1.0, 0.1)), steady(1.0, 0.1)),
    Settling("bonus on arrival, then half", "fails", paid_once(100.0, 80, steady(1.0, 0.1)), steady(0.4, 0.1)),
    Settling("bonus on arrival once in training", "holds", once_late(300.0, 150, steady(1.0, 0.1)), steady(0.95, 0.1)),
    # Must stay as they are
    Settling("noise", "holds", steady(1.0, 2.0), steady(0.95, 2.0), horizon=1000),
    Settling("a period of 500", "holds", periodic(500, 2.0), periodic(500, 2.0), horizon=1000),
    Settling("rare rewards", "holds", sparse(80, 10.0), sparse(80, 10.0), horizon=1000),
    Settling("heavy tails", "holds", lambda step, rng: 1.0 + rng.standard_t(3, len(step)), steady(0.95), horizon=1000),
    Settling("a slow gait", "holds", WALKER, steady(2.6), idle=1.0, horizon=1000),
    Settling(
        "a walker that needs 150 steps to speed up, disturbed",
        "holds",
        WALKER,
        arrive(1.6, steady(2.7), 150),
        1.0,
        1000,
    ),
    Settling("a gait without noise", "holds", gait(3.0, 37), gait(2.7, 41), horizon=1000),
    Settling("a bonus at the start", "holds", bonus(300.0, steady(1.0)), bonus(300.0, steady(0.9)), horizon=1000),
)
