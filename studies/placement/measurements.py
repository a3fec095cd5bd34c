"""Two measurements beside the grid, SetTable with drag only: each row of their tables is a unit of work.

*Hand-over*: each row places the same episodes with the same policies (training seed 0), with another descent and speed
of the hand-over by inverse kinematics. A descent of 0 stops without lowering.

*Halting under exploration noise*: do apples stay if the robot stops before it releases them? The shipped place policy
(training seed 0) carries SetTable's apple from `val` start states without clutter. When it commands the hand to open
and the apple is in its goal region, it either goes on, or the robot halts: a mean action of 0, with the hand closed for
half a second and then open. Normal noise, as in training, is added to every action of base and arm (not of the hand)
from the start. A robot that halts does not correct for it. Counted are apples that then stayed in their goal for 200
consecutive steps, and apples that were first released outside it.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.home.agents.release import EPSILON, SPEED, Ik
from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.policies import choose_policies, make_agents, shipped_seeds
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.simulator import ARM, GRASP, GRIP, RELEASE
from perdure.home.skills import Place
from perdure.home.skills.environment import HomeSkillVectorEnv
from perdure.home.skills.place import GOAL_RADIUS
from perdure.home.tasks.episodes import load_episodes
from perdure.policy import Policy, load_policy
from perdure.runs import Store, Unit, Work, write_atomic
from studies.placement.grid import DRAG, Grid

TASK = "set_table"
VERSION = 1
"""Increase it when a measurement gives other numbers."""
SUMMARY = "summary.json"
HAND_OVERS = (
    *((descent, SPEED) for descent in (0.0, 0.02, EPSILON, 0.1, 0.2)),
    *((EPSILON, speed) for speed in (0.05, 0.3, 0.6)),
)
"""Descent [m], speed [m/s]."""
APPLE = 1
"""Number of the target."""
HALT_STEPS = 15
"""Control steps that the robot stands still before the hand opens: half a second."""
DELTA = 200
LANES = 20
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
SCHEMAS: Mapping[str, Mapping[str, type[pl.DataType]]] = {
    "hand-over": {
        "descent": pl.Float64,
        "speed": pl.Float64,
        "placements": pl.Int64,
        "not_stable": pl.Int64,
        "release_height": pl.Float64,
        "object_speed": pl.Float64,
        "out_of_reach": pl.Int64,
        "blocked": pl.Int64,
    },
    "halt-in-noise": {
        "halts": pl.Boolean,
        "noise": pl.String,
        "parts": pl.String,
        "commanded": pl.Int64,
        "stayed": pl.Int64,
        "let_go_outside": pl.Int64,
    },
}
"""Columns of both tables: [m], [m/s], counts, median height [m] and object speed [m/s] at release, counts of outcomes;
the case, and counts of apples whose release was commanded in the goal."""


def measurement_units(grid: Grid) -> dict[str, list[Unit]]:
    """Return the units of both measurements by the name of their table; none of one that the grid leaves out."""
    found: dict[str, list[Unit]] = {name: [] for name in SCHEMAS}
    for descent, speed in HAND_OVERS if grid.hand_over_episodes else ():
        arguments: dict[str, Any] = {"descent": descent, "speed": speed, "episodes": grid.hand_over_episodes}
        found["hand-over"].append(
            _unit("hand-over", f"descent-{descent:.2f}-speed-{speed:.2f}", "measure_hand_over", arguments)
        )
    for halts, noise, parts in CASES if grid.noise_episodes else ():
        arguments = {"halts": halts, "noise": noise, "parts": parts, "episodes": grid.noise_episodes}
        size = noise.replace("(", "").replace(")", "")
        name = f"{'halts' if halts else 'goes-on'}-noise-{size}-{parts.replace(' ', '-')}"
        found["halt-in-noise"].append(_unit("halt-in-noise", name, "measure_halting", arguments))
    return found


def _unit(table: str, name: str, function: str, arguments: Mapping[str, Any]) -> Unit:
    config = {"version": VERSION, "measurement": table, **arguments}
    return Unit(f"{table}/{name}", config, f"{__name__}:{function}", dict(arguments), size=float(arguments["episodes"]))


def read_measurement(table: str, units: list[Unit], folder: Path) -> pl.DataFrame | None:
    """Return the table of a measurement; None unless all its units are finished in the store at `folder`."""
    if not units or not folder.is_dir():
        return None
    store = Store(folder)
    if not all(store.done(unit.key, unit.config) for unit in units):
        return None
    rows = [json.loads((store.get(unit.key) / SUMMARY).read_text()) for unit in units]
    return pl.DataFrame(rows, schema=SCHEMAS[table])


def _write_row(work: Work, table: str, *values: Any) -> None:
    """Write a row of a table into the work folder."""
    write_atomic(work.folder / SUMMARY, json.dumps(dict(zip(SCHEMAS[table], values, strict=True)), indent=1) + "\n")


def measure_hand_over(work: Work, *, descent: float, speed: float, episodes: int) -> None:
    """Write one row of the table of hand-overs; the function of the units."""
    agents = make_agents(choose_policies(TASK, 0), "rl")
    ik = agents["place"] = Ik(agents["place"], epsilon=descent, speed=speed)
    options = ExecutorOptions(scene=DRAG, threads=work.threads)
    executor = Executor(EvaluationProtocol(TASK).skills(), agents, options, strategy="ik", train_seed=0)
    logs = []
    for log in executor.run(load_episodes(TASK, "val").episodes[:episodes]):
        logs.append(log)
        work.report(len(logs), episodes)
    placed, ways = analyze(logs).placements, Counter(ik.outcomes)
    medians = [round(float(np.median(placed[name].to_numpy())), 3) for name in ("release_height", "object_speed")]
    lost = int((~placed["stabilizing"]).sum())
    _write_row(work, "hand-over", descent, speed, len(placed), lost, *medians, ways["out of reach"], ways["blocked"])


def measure_halting(work: Work, *, halts: bool, noise: str, parts: str, episodes: int) -> None:
    """Write one row of the table of halting; the function of the units."""
    found = outcomes(load_policy(shipped_seeds(TASK, "place")[0]), episodes, halts, noise, parts)
    counts = found.total(), found["stayed"], found["let go outside"]
    _write_row(work, "halt-in-noise", halts, noise, parts, *counts)


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
            actions[asked, GRIP] = np.where(self.since[asked] < HALT_STEPS, GRASP, RELEASE)
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
