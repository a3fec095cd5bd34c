"""Learning curves beside Stable-Baselines3, same EnvPool tasks and settings, and the interval of their difference.

python benchmarks/curves.py run          train what is missing on both sides (hours on two cores; resumable)
python benchmarks/curves.py collect SB3_FOLDER RUNS_FOLDER   take in runs made elsewhere
python benchmarks/curves.py compare      print and write benchmarks/curves.json and benchmarks/curves.png

A score is a seed's mean training return over the last fifth of its steps. Seeds of the two sides have nothing in common
but their number, so the difference is bootstrapped over independent groups.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

sys.path.insert(0, str(Path(__file__).parent))
from bench import peers, sb3_config

from perdure.envs import make_world
from perdure.extrapolate import LaneSpec, evaluate_lanes
from perdure.policy import load_policy
from perdure.ppo import TrainRun, method_config, train
from perdure.report import theme
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import Figure, save
from perdure.report.statistics import difference_interval, make_units
from perdure.runs import write_atomic

HERE = Path(__file__).parent
FOLDER = HERE / "curves"
BINS = 20


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is trained on a task."""

    ours: int
    """Seeds of ours."""
    sb3: int
    """Seeds of Stable-Baselines3, each of which takes as long as five of ours."""
    steps: int
    """Environment steps of a seed."""


PLANS = {
    "Hopper-v3": Plan(3, 3, 1_000_000),
    "HalfCheetah-v3": Plan(9, 3, 1_000_000),
    "InvertedPendulum-v4": Plan(10, 10, 51_200),
}


def binned(steps: np.ndarray, returns: np.ndarray, total: int) -> list[float | None]:
    """Mean return of the episodes that ended in each of BINS equal parts of the training."""
    which = np.minimum((steps * BINS / total).astype(int), BINS - 1)
    return [float(returns[which == i].mean()) if (which == i).any() else None for i in range(BINS)]


def keep(task: str, side: str, seed: int, curve: list[float | None], evaluation: list[float]) -> None:
    path = FOLDER / task / f"{side}-{seed}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, json.dumps({"curve": curve, "evaluation": evaluation}) + "\n")


def keep_sb3(task: str, seed: int, result: dict[str, Any]) -> None:
    episodes = np.array(result["episodes"])
    keep(task, "sb3", seed, binned(episodes[:, 0], episodes[:, 1], PLANS[task].steps), result["evaluation"])


def keep_ours(task: str, seed: int, folder: Path) -> None:
    episodes = pl.read_parquet(folder / "episodes.parquet")
    curve = binned(episodes["step"].to_numpy(), episodes["return"].to_numpy(), PLANS[task].steps)
    policy = load_policy(folder / "policy.safetensors")
    records = evaluate_lanes([policy], [LaneSpec(0, policy.clock, i) for i in range(20)], 1000)
    keep(task, "perdure", seed, curve, records.returns[:, -1].tolist())


def run() -> None:
    for task, plan in PLANS.items():
        world = make_world(task, [0])
        config = dataclasses.replace(method_config("ppo", task, world.spec.observation_size), total_steps=plan.steps)
        world.close()
        missing = tuple(s for s in range(plan.ours) if not (FOLDER / task / f"perdure-{s}.json").exists())
        if missing:
            paths = train(TrainRun(task, "ppo", config, missing), HERE / "runs", on="local")
            for seed, path in zip(missing, paths, strict=True):
                keep_ours(task, seed, path.parent)
        for seed in range(plan.sb3):
            if not (FOLDER / task / f"sb3-{seed}.json").exists():
                settings = {**sb3_config(task, seed, 1), "total_steps": plan.steps}
                keep_sb3(task, seed, peers("0,1", "sb3_train.py", [settings])[0])


def collect(sb3: Path, runs: Path) -> None:
    for task in PLANS:
        for path in sorted(sb3.glob(f"{task}-*.json")):
            keep_sb3(task, int(path.stem.rsplit("-", 1)[1]), json.loads(path.read_text()))
        for folder in sorted((runs / task / "ppo").glob("seed-*")):
            keep_ours(task, int(folder.name.removeprefix("seed-")), folder)


def score(curve: list[float | None]) -> float:
    last = [value for value in curve[-BINS // 5 :] if value is not None]
    return float(np.mean(last))


def compare() -> None:
    result: dict[str, Any] = {}
    for task, plan in PLANS.items():
        sides = {
            side: [json.loads(p.read_text()) for p in sorted((FOLDER / task).glob(f"{side}-*.json"))]
            for side in ("perdure", "sb3")
        }
        scores = {side: [score(each["curve"]) for each in runs] for side, runs in sides.items()}
        if not all(scores.values()):
            continue
        units = [make_units(np.array(scores[side]), np.arange(len(scores[side]))) for side in ("perdure", "sb3")]
        interval = difference_interval(*units, np.random.default_rng(0))
        result[task] = {
            "steps": plan.steps,
            "seeds": {side: len(runs) for side, runs in sides.items()},
            "seeds_planned": {"perdure": plan.ours, "sb3": plan.sb3},
            "scores": scores,
            "evaluation_means": {side: [float(np.mean(r["evaluation"])) for r in runs] for side, runs in sides.items()},
            "difference": float(interval.estimate),
            "interval_95": [None if np.isnan(b) else float(b) for b in (interval.lower, interval.upper)],
        }
        print(task, json.dumps(result[task], indent=1))
    write_atomic(HERE / "curves.json", json.dumps(result, indent=1, sort_keys=True) + "\n")
    draw()


def draw() -> None:
    import altair as alt

    panels, names = [], {"perdure": "perdure", "sb3": "Stable-Baselines3"}
    tasks = [task for task in PLANS if (FOLDER / task).exists()]
    for task in tasks:
        steps, curves = (np.arange(BINS) + 1) / BINS * PLANS[task].steps, []
        for number, (side, name) in enumerate(names.items()):
            paths = sorted((FOLDER / task).glob(f"{side}-*.json"))
            seeds = np.array([json.loads(path.read_text())["curve"] for path in paths], dtype=np.float64)
            label = f"{name} (n = {len(seeds)})"
            curves.append(Curve(label, steps, np.nanmean(seeds, axis=0), theme.style(number), members=seeds))
        x, y = Axis("environment steps"), Axis("mean training return of an episode")
        panels.append(curve_chart(curves, x, y, width=theme.WIDE // len(tasks)).properties(title=task))
    title = "Learning curves of PPO with the same settings in perdure and in Stable-Baselines3"
    note = "Thick: mean of n training seeds. Thin: each seed."
    chart = alt.hconcat(*panels).resolve_scale(color="independent", strokeDash="independent")
    save([Figure("curves", title, chart, note, wide=True)], HERE)


if __name__ == "__main__":
    command, *words = sys.argv[1:] or ["compare"]
    {"run": run, "collect": collect, "compare": compare}[command](*(Path(word) for word in words))
