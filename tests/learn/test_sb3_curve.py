"""The whole learner on MuJoCo's inverted pendulum, within a band around Stable-Baselines3's learning curves.

benchmarks/curves.json holds the mean training returns of ten seeds of stable-baselines3 with the same settings, in
parts of 2,560 steps; benchmarks/curves.py has made them.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from perdure.learn import TrainRun, method_config, train

TASK = "InvertedPendulum-v4"
CURVES = Path(__file__).parents[2] / "benchmarks" / "curves.json"
PART, PARTS = 2560, 9
WIDER = 2
"""Ten seeds do not show the whole spread."""


@pytest.mark.verify
def test_the_return_rises_as_stable_baselines3s_does(tmp_path):
    sb3 = np.array(list(json.loads(CURVES.read_text())[TASK]["sb3"].values()))[:, :PARTS]
    low, high = sb3.min(axis=0) / WIDER, sb3.max(axis=0) * WIDER
    assert high[0] < low[3], "the control: who learns nothing leaves the band"
    assert sb3[:, -1].min() == 1000, "in the end every seed keeps the pole up for the whole episode"
    config = replace(method_config("ppo", TASK, 4), total_steps=PART * PARTS)
    (path,) = train(TrainRun(TASK, "ppo", config), tmp_path, cores=1)
    episodes = pl.read_parquet(path.with_name("episodes.parquet")).filter(pl.col("step") <= PART * PARTS)
    part = (episodes["step"].to_numpy() - 1) // PART
    ours = np.array([episodes["return"].to_numpy()[part == k].mean() for k in range(PARTS)])
    assert np.all((low <= ours) & (ours <= high)), np.round(ours)
