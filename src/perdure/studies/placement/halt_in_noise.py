"""Measure placements under exploration noise: do apples stay if the robot stops before it releases them?

SetTable's apples, drag only, `val` start states without clutter. The shipped place policy (training seed 0) carries
the apple. When it commands the hand to open and the apple is in its goal region, it either goes on, or the robot halts:
a mean action of 0, with the hand closed for half a second and then open. Normal noise, as in training, is added to
every action of base and arm (not of the hand) from the start. A robot that halts does not correct for it. Counted are
apples that then stayed in their goal for 200 consecutive steps, and apples that were first released outside it.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.home.evaluate.protocol.policies import shipped_policy
from perdure.home.sim.world import ARM, GRASP, GRIP, RELEASE
from perdure.home.skills import Place
from perdure.home.skills.gym import HomeSkillVectorEnv
from perdure.home.skills.place import GOAL_RADIUS
from perdure.policy import Policy, load_policy
from perdure.runs import Unit, Work
from perdure.studies.placement.grid import Grid
from perdure.studies.placement.unit_steps import TASK, Measurement, leave

VERSION = 1
"""Increase it when `measure` gives other numbers."""
APPLE = 1
"""Number of the target."""
HALT = 15
"""Control steps that the robot stands still before the hand opens: half a second."""
DELTA = 200
LANES = 20
EPISODE_COST = 400
"""See `Measurement.episode_cost`."""
BASE = slice(0, ARM.start)
NOISE = ("none", "exp(-4)", "exp(-3)", "exp(-2)", "exp(-1)")
PARTS = {"base and arm": (1.0, 1.0), "base": (1.0, 0.0), "arm": (0.0, 1.0)}
"""What is noisy, to factors of the noise of (base, arm)."""
CASES = (
    *((False, name, "base and arm") for name in ("none", "exp(-2)", "exp(-1)")),
    *((True, name, "base and arm") for name in NOISE),
    *((True, "exp(-2)", part) for part in ("base", "arm")),
)
"""Whether the robot halts, standard deviation of the noise, what is noisy."""
SCHEMA: dict[str, type[pl.DataType]] = {
    "halts": pl.Boolean,
    "noise": pl.String,
    "parts": pl.String,
    "commanded": pl.Int64,
    "stayed": pl.Int64,
    "let_go_outside": pl.Int64,
}
"""Of the table: the case, and counts of apples whose release was commanded in the goal."""


def noise_step(grid: Grid, out: Path) -> Measurement:
    """Return the step that measures every case."""
    units = tuple(_unit(*case, grid.noise_episodes) for case in CASES)
    return Measurement("halt-in-noise", units, EPISODE_COST, out, SCHEMA)


def _unit(halts: bool, noise: str, parts: str, episodes: int) -> Unit:
    arguments = {"halts": halts, "noise": noise, "parts": parts, "episodes": episodes}
    config = {"version": VERSION, "measurement": "halt-in-noise", **arguments}
    who = "halts" if halts else "goes-on"
    name = f"{who}-noise-{noise.replace('(', '').replace(')', '')}-{parts.replace(' ', '-')}"
    return Unit(f"halt-in-noise/{name}", config, f"{__name__}:measure", arguments, size=float(episodes))


def measure(work: Work, *, halts: bool, noise: str, parts: str, episodes: int) -> None:
    """Write one row of the table; the function of the units."""
    path = shipped_policy(TASK, "place", 0)
    assert path is not None
    found = outcomes(load_policy(path), episodes, halts, noise, parts)
    values = halts, noise, parts, found.total(), found["stayed"], found["let go outside"]
    leave(work, dict(zip(SCHEMA, values, strict=True)))


def outcomes(policy: Policy, episodes: int, halts: bool, noise: str, parts: str) -> Counter[str]:
    """Count what became of the apples.

    Args:
        policy: Carries them.
        episodes: How many, rounded up to a multiple of LANES.
        halts: Whether the robot halts; else the policy goes on.
        noise: Standard deviation, one of NOISE; 1 is full speed.
        parts: What is noisy, one of PARTS.

    Returns:
        Counts of "stayed", "let go outside" and "left its goal". Episodes without a release command do not count.
    """
    size = 0.0 if noise == "none" else float(np.exp(float(noise[4:-1])))
    env = _make_env()
    halting = _Halting(policy, env, halts, tuple(size * share for share in PARTS[parts]))
    left, stayed = np.full(LANES, -(-episodes // LANES)), np.zeros(LANES, dtype=bool)
    found: Counter[str] = Counter()
    observations, _ = env.reset(seed=1000)
    while left.any():
        observations, _, terminated, truncated, info = env.step(halting.act(observations))
        stayed |= env.progress.lasting >= DELTA
        over = terminated | truncated
        for lane in np.flatnonzero(over & (left > 0)):
            left[lane] -= 1
            outside = info["failure"][lane] == "wrong drop"
            if halting.asked[lane]:
                found["stayed" if stayed[lane] else "let go outside" if outside else "left its goal"] += 1
        if over.any():
            observations, _ = env.reset(options={"reset_mask": over})
            halting.since[over], stayed[over] = -1, False
    env.close()
    return found


class _Halting:
    """The policy with halt and noise."""

    def __init__(self, policy: Policy, env: HomeSkillVectorEnv, halts: bool, noise: tuple[float, ...]) -> None:
        self._policy, self._env, self._halts = policy, env, halts
        self._base, self._arm = noise
        self._rng = np.random.default_rng(0)
        self.since = np.full(LANES, -1)
        """Steps since the policy commanded the release in the goal, per lane; -1: not yet."""

    @property
    def asked(self) -> NDArray[np.bool_]:
        """Whether the release was commanded, per lane."""
        return np.asarray(self.since >= 0)

    def act(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the actions of all lanes. A policy with Delta = 1 does not observe how long the object has stayed."""
        env, policy = self._env, self._policy
        known = observations[:, : policy.task.observation_size]
        actions = np.array(policy.act(known, env.progress.elapsed), dtype=np.float64)
        asks = (actions[:, GRIP] < 0.0) & env.state.holds_target & (env.state.object_to_goal <= GOAL_RADIUS)
        self.since = np.where((self.since >= 0) | asks, self.since + 1, -1)
        asked = self.asked
        if self._halts:
            actions[asked] = 0.0
            actions[asked, GRIP] = np.where(self.since[asked] < HALT, GRASP, RELEASE)
        drawn = self._rng.standard_normal(actions.shape)
        actions[:, BASE] += self._base * drawn[:, BASE]
        actions[:, ARM] += self._arm * drawn[:, ARM]
        return actions


def _make_env() -> HomeSkillVectorEnv:
    return HomeSkillVectorEnv(
        LANES,
        max_episode_steps=Place(delta=DELTA).limit,
        skill="place",
        task=TASK,
        targets=APPLE,
        split="val",
        rolling="drag",
        delta=DELTA,
    )
