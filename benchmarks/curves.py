"""Learning curves beside Stable-Baselines3, same EnvPool tasks and settings, and the interval of their difference.

python benchmarks/curves.py run          train what is missing on both sides (hours on two cores; resumable)
python benchmarks/curves.py compare      print the differences, and draw benchmarks/curves.png

benchmarks/curves.json holds the mean training returns of each run in 20 equal parts. A score is a seed's
mean training return over the last fifth of its steps. Seeds of the two sides have nothing in common but their number,
so the difference is bootstrapped over independent groups.
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
from bench import HERE, peer, sb3_config

from perdure.envs import task_spec
from perdure.learn import TrainRun, method_config, train
from perdure.report import charts
from perdure.report.charts import Axis, Curve, Figure, curve_chart, save
from perdure.runs import write_atomic
from perdure.stats import compare_unpaired

RUNS = HERE / "curves.json"
BINS = 20
PLANS = {"Hopper-v3": (3, 3, 1_000_000), "HalfCheetah-v3": (9, 3, 1_000_000), "InvertedPendulum-v4": (10, 10, 51_200)}
"""Seeds of ours, seeds of Stable-Baselines3 (each takes as long as five of ours), environment steps of a seed."""
NAMES = {"perdure": "perdure", "sb3": "Stable-Baselines3"}


def keep(task: str, side: str, seed: int, steps: Any, returns: Any) -> None:
    """Add a run: the mean return of the episodes that ended in each of BINS equal parts."""
    which = np.minimum(np.asarray(steps) * BINS // PLANS[task][2], BINS - 1)
    curve: list[float | None] = [None] * BINS  # None: no episode ended there
    for k in np.unique(which):
        curve[k] = float(np.mean(returns[which == k]))
    runs = json.loads(RUNS.read_text())
    runs.setdefault(task, {}).setdefault(side, {})[str(seed)] = curve
    write_atomic(RUNS, json.dumps(runs, indent=1) + "\n")


def run() -> None:
    """Train what is missing."""
    for task, (ours, sb3, steps) in PLANS.items():
        made = json.loads(RUNS.read_text()).get(task, {})
        config = method_config("ppo", task, task_spec(task).observation_size, "zoo")
        missing = tuple(seed for seed in range(ours) if str(seed) not in made.get("perdure", {}))
        if missing:
            training = TrainRun(task, "ppo", dataclasses.replace(config, total_steps=steps), missing, preset="zoo")
            for seed, path in zip(missing, train(training, HERE / "runs", on="local"), strict=True):
                episodes = pl.read_parquet(path.parent / "episodes.parquet")
                keep(task, "perdure", seed, episodes["step"].to_numpy(), episodes["return"].to_numpy())
        for seed in range(sb3):
            if str(seed) not in made.get("sb3", {}):
                result = peer("0,1", "train", {**sb3_config(task, seed, 1), "total_steps": steps})
                ends, returns, _ = np.array(result["episodes"]).T
                keep(task, "sb3", seed, ends.astype(int), returns)


def compare() -> None:
    """Print the difference of each task and draw the curves."""
    panels = []
    for task, (*_, total) in PLANS.items():
        runs = json.loads(RUNS.read_text())[task]  # curves of shape (seeds, BINS), NaN where no episode ended
        sides = {side: np.array([runs[side][seed] for seed in sorted(runs[side], key=int)], float) for side in NAMES}
        scores = [np.nanmean(each[:, -BINS // 5 :], axis=1) for each in sides.values()]
        interval = compare_unpaired(*scores)
        seeds = " and ".join(str(len(each)) for each in scores)
        print(f"{task}: {interval.estimate:.0f} [{interval.lower:.0f}, {interval.upper:.0f}], {seeds} seeds")
        steps = (np.arange(BINS) + 1) / BINS * total
        shown = [
            Curve(f"{NAMES[side]} (n = {len(each)})", steps, np.nanmean(each, axis=0), charts.style(k), members=each)
            for k, (side, each) in enumerate(sides.items())
        ]
        x = Axis("environment steps")
        y = Axis("mean training return of an episode")
        panels.append(curve_chart(shown, x, y, width=charts.WIDE // len(PLANS)) | {"title": task})
    title = "Learning curves of PPO with the same settings in perdure and in Stable-Baselines3"
    note = "Thick: mean of n training seeds. Thin: each seed."
    scales = dict.fromkeys(("color", "strokeDash"), "independent")
    chart = {"hconcat": panels, "resolve": {"scale": scales}}
    save([Figure("curves", title, chart, note, wide=True)], HERE)


if __name__ == "__main__":
    {"run": run, "compare": compare}[(sys.argv[1:] or ["compare"])[0]]()
