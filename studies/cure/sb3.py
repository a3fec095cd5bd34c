"""The cure with another learner: Stable-Baselines3's PPO, trained, then trained further as the how-to page shows.

Run it from the root of a clone in an environment that has Stable-Baselines3 (`pip install stable-baselines3`):
``python -m studies.cure.sb3``. It takes about four hours of one core, and continues when it is run again.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl

from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.policy.readers.found import policy_file
from perdure.report.estimates import estimate_table
from perdure.runs import Store, Unit, Work, run_missing, write_atomic
from perdure.runs.progress import show_progress
from studies.agents.study import row_of
from studies.files import write_csv

MODULE = "studies.cure.sb3"
OUT = Path("results", "cure")
TABLE = OUT / "tables" / "sb3.csv"
TASKS = ("Hopper-v5", "Walker2d-v5")
SEEDS = (0, 1, 2, 3, 4)
STEPS = 1_000_000
FURTHER_STEPS = 300_000
GAMMA = 0.999
LOG_STD = -1.0
DISTURB = ("action_noise:0.1",)
KINDS = ("trained", "further", "further, critic anew")
MODEL = "model.zip"
NORMALIZER = "vecnormalize.pkl"


def units(store: Path) -> list[Unit]:
    """Return the units: each training run of each kind, then its verdicts."""
    found = []
    for task in TASKS:
        for seed in SEEDS:
            base = _training(task, seed, KINDS[0], STEPS)
            found += [base, _verdict(task, base, store)]
            for kind in KINDS[1:]:
                further = _training(task, seed, kind, FURTHER_STEPS)
                start = str((store / base.key).resolve())
                further = replace(further, arguments={**further.arguments, "start": start}, after=(base.key,))
                found += [further, _verdict(task, further, store)]
    return found


def _training(task: str, seed: int, kind: str, steps: int) -> Unit:
    config = {"task": task, "seed": seed, "kind": kind, "steps": steps}
    name = kind.replace(", ", "-").replace(" ", "-")
    return Unit(f"sb3/{task}/{name}/seed-{seed}", config, f"{MODULE}:train", config, size=float(steps))


def _verdict(task: str, training: Unit, store: Path) -> Unit:
    arguments = {"task": task, "folder": str((store / training.key).resolve())}
    config = {"training": dict(training.config)}
    return Unit(f"verdict/{training.key}", config, f"{MODULE}:judge", arguments, (training.key,), 100_000.0)


def train(work: Work, *, task: str, seed: int, kind: str, steps: int, start: str | None = None) -> None:
    """Train PPO with Stable-Baselines3's defaults and `VecNormalize`, or train such a model further."""
    import gymnasium
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    from perdure.wrappers import Disturb

    torch.set_num_threads(1)
    if start is None:
        env = VecNormalize(make_vec_env(task, seed=seed))
        model = PPO("MlpPolicy", env, seed=seed, device="cpu")
    else:
        disturbed = make_vec_env(lambda: Disturb(gymnasium.make(task), list(DISTURB)), seed=seed)
        env = VecNormalize.load(str(Path(start) / NORMALIZER), disturbed)
        model = PPO.load(Path(start) / MODEL, env=env, gamma=GAMMA, seed=seed, device="cpu")
        model.policy.log_std.data.fill_(LOG_STD)
        if kind == KINDS[2]:
            for critic in (model.policy.mlp_extractor.value_net, model.policy.value_net):
                critic.apply(model.policy.init_weights)
            model.policy.optimizer.state.clear()
    model.learn(steps)
    model.save(work.folder / MODEL)
    env.save(str(work.folder / NORMALIZER))


def judge(work: Work, *, task: str, folder: str) -> None:
    """Leave a row for each condition of `perdure extrapolate`."""
    store = work.folder / "parts"
    options = {"normalizer": str(Path(folder) / NORMALIZER)}
    file = policy_file(Path(folder) / MODEL, store, task, options, (), lambda sentence: None)
    result = evaluate_files(Extrapolation((file,)), Execution(store / "episodes", on="here"))
    (groups,) = estimate_table(result.frame).values()
    write_atomic(work.folder / "rows.json", json.dumps([row_of(item) for item in groups]))
    shutil.rmtree(store, ignore_errors=True)


def table(store: Store) -> pl.DataFrame:
    """Return a row for each finished training run and condition."""
    rows: list[dict[str, Any]] = []
    for unit in units(store.root):
        if unit.key.startswith("verdict/") and store.done(unit.key):
            trained = unit.config["training"]
            who = {name: trained[name] for name in ("task", "kind", "seed")}
            rows += [who | row for row in json.loads((store.get(unit.key) / "rows.json").read_text())]
    return pl.DataFrame(rows, infer_schema_length=None)


def main() -> None:
    """Run what is missing and write the table."""
    store = OUT / "runs"
    with show_progress("Stable-Baselines3") as observe:
        run_missing(units(store), store, "local", 1, observe, lambda: None)
    print(f"written: {write_csv(TABLE, table(Store(store)))}")


if __name__ == "__main__":
    main()
