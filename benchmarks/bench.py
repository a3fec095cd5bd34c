"""``make bench``: perdure and its peers in turn on this machine; prints a table and writes benchmarks/latest.json.

Each figure is a ratio of two measurements of one run, ours and the peer's, taken alternately over ROUNDS rounds; their
median is kept. The peer runs in an environment of its own (.venv-bench), as a subprocess. Nothing else should run
meanwhile. The table in docs/reference/speed.md and the ratios in README.md are filled from the same file.

python benchmarks/bench.py [NAME ...]     only the cases whose names contain one of the words
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from perdure.envs import make_world
from perdure.ppo import method_config
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
        "Stable-Baselines3 on EnvPool, same settings",
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
ITERATIONS = {"Hopper-v3": 16, "HalfCheetah-v3": 12, "Ant-v3": 5}
"""Rollouts in one measurement; the first of SB3's and the first two of ours (compilation) do not count."""
SLICE = 240
"""Rollouts of a training run in the slice of the study: long enough that starting and compiling do not decide."""


@dataclass(frozen=True)
class Figure:
    """One line of the result."""

    ours: float
    peer: float
    unit: str
    how: str

    @property
    def ratio(self) -> float:
        return self.ours / self.peer


def sb3_config(task: str, seed: int, iterations: int) -> dict[str, Any]:
    """The settings that our preset gives this task, in the form the peer's script reads."""
    world = make_world(task, [0])
    config = method_config("ppo", task, world.spec.observation_size)
    world.close()
    values = {k: v for k, v in config.to_json().items() if k not in ("protocol", "segment_steps")}
    horizon = int(config.protocol.horizon.longest)
    gammas = {"gamma": config.protocol.gamma, "normalizer_gamma": config.protocol.normalizer_gamma}
    steps = config.rollout_size * iterations
    return {**values, **gammas, "horizon": horizon, "task": task, "seed": seed, "total_steps": steps}


def ours(cores: str, *words: object) -> dict[str, float]:
    """Runs our side, pinned to these cores."""
    command = ["taskset", "-c", cores, sys.executable, str(HERE / "measure.py"), *(str(word) for word in words)]
    output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
    result: dict[str, float] = json.loads(output.splitlines()[-1])
    return result


def peers(cores: str, script: str, configs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Runs the peer's script once for each configuration, all at the same time, pinned to these cores."""
    with tempfile.TemporaryDirectory() as folder:
        running = []
        for number, config in enumerate(configs):
            source, out = Path(folder, f"{number}.json"), Path(folder, f"{number}-out.json")
            source.write_text(json.dumps(config))
            command = ["taskset", "-c", cores, str(PEER_PYTHON), str(HERE / "peers" / script), str(source), str(out)]
            quiet = subprocess.DEVNULL
            running.append((subprocess.Popen(command, env=one_thread(), stdout=quiet, stderr=quiet), out))
        for process, _ in running:
            if process.wait():
                raise RuntimeError(f"the peer failed: {process.args}")
        return [json.loads(out.read_text()) for _, out in running]


def one_thread() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def alternate(mine: Callable[[], float], theirs: Callable[[], float], rounds: int = ROUNDS) -> tuple[float, float]:
    """Medians of ours and the peer's over alternating rounds."""
    pairs = [(mine(), theirs()) for _ in range(rounds)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def train_one_core(task: str) -> Figure:
    config = sb3_config(task, 0, ITERATIONS[task])
    values = alternate(
        lambda: ours("0", "train", task, 1, ITERATIONS[task], 1)["steps_per_second"],
        lambda: peers("0", "sb3_train.py", [config])[0]["steps_per_second"],
    )
    return Figure(
        *values,
        "env steps/s",
        "training one seed, both pinned to one core, rl-zoo settings, Stable-Baselines3 on EnvPool too",
    )


def train_five_seeds(task: str) -> Figure:
    configs = [sb3_config(task, seed, ITERATIONS[task]) for seed in range(2)]
    values = alternate(
        lambda: ours("0,1", "train", task, 4, ITERATIONS[task], 2)["steps_per_second"],
        lambda: sum(each["steps_per_second"] for each in peers("0,1", "sb3_train.py", configs)),
    )
    return Figure(
        *values,
        "env steps/s",
        "training several seeds: two of our processes on two cores, against two of Stable-Baselines3 on them",
    )


def evaluate_engine(task: str) -> Figure:
    result = ours("0", "evaluate", task, 48, 2000)
    how = "evaluating 48 lanes x 2,000 steps on one core, against EnvPool alone fed the same actions"
    return Figure(result["ours"], result["engine"], "lane steps/s", how)


def evaluate_sb3(task: str, forms: tuple[str, ...], how: str) -> Figure:
    config = {**sb3_config(task, 0, 1), "cores": 2}

    def both_cores() -> float:
        with ThreadPoolExecutor(2) as pool:
            rates = pool.map(lambda core: ours(core, "evaluate", task, 48, 2000)["ours"], ("0", "1"))
            return sum(rates)

    def best_form() -> float:
        result = peers("0,1", "sb3_evaluate.py", [config])[0]
        return float(max(result[form] for form in forms))

    return Figure(*alternate(both_cores, best_form), "env steps/s", how)


def study(task: str) -> Figure:
    """Steps a second of a slice of the horizon study, training and evaluation in its proportion of about 1:7."""
    config = {**sb3_config(task, 0, SLICE), "seeds": [0, 1], "start_states": 8, "cores": 2}
    config["test_steps"] = 7 * int(config["total_steps"]) // 16
    steps = 2 * (config["total_steps"] + 2 * config["start_states"] * config["test_steps"])

    def ours_now() -> float:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, "config.json")
            source.write_text(json.dumps(config))
            command = ["taskset", "-c", "0,1", sys.executable, str(HERE / "study_slice.py"), str(source)]
            output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
        return steps / float(json.loads(output.splitlines()[-1])["seconds"])

    def peer_now() -> float:
        configs = [{**config, "seed": seed} for seed in config["seeds"]]
        return steps / max(float(each["seconds"]) for each in peers("0,1", "sb3_study.py", configs))

    how = (
        f"a slice of the horizon study from nothing to the table: 2 training runs of {config['total_steps']:,} steps, "
        f"2 clocks, 8 start states, {config['test_steps']:,} test steps; two cores, worker start and compilation "
        "included, imports not, against two processes of Stable-Baselines3 with `evaluate_policy` as documented, one "
        "environment each, not its fastest form; one round"
    )
    return Figure(*alternate(ours_now, peer_now, rounds=1), "steps/s", how)  # a round takes six minutes


def home(what: str, cores: str, how: str) -> Figure:
    """Simulated seconds a second of ours, against gymnasium-robotics' FetchPickAndPlace-v4 in its own environment."""

    def ours_now() -> float:
        command = ["taskset", "-c", cores, sys.executable, str(HERE / "measure_home.py"), what]
        output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
        result = json.loads(output.splitlines()[-1])
        return float(result["control_steps_per_second"]) / float(result["control_hz"])

    def peer_now() -> float:
        command = ["taskset", "-c", "0", str(ROBOTICS_PYTHON), str(HERE / "peers" / "fetch_env.py")]
        output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
        result = json.loads(output.splitlines()[-1])
        return float(result["steps_per_second"]) * float(result["step_s"])

    return Figure(*alternate(ours_now, peer_now), "simulated s/s", how)


def cases() -> dict[str, Callable[[], Figure]]:
    """Every benchmark by name."""
    table: dict[str, Callable[[], Figure]] = {}
    for task in ITERATIONS:
        table[f"train.{task}.vs_sb3"] = lambda task=task: train_one_core(task)
        table[f"train-5-seeds.{task}.vs_sb3"] = lambda task=task: train_five_seeds(task)
    for task in ("Hopper-v3", "HalfCheetah-v3"):
        table[f"extrapolate.{task}.vs_engine"] = lambda task=task: evaluate_engine(task)
    table["extrapolate.HalfCheetah-v3.vs_sb3_documented"] = lambda: evaluate_sb3(
        "HalfCheetah-v3",
        ("documented",),
        "evaluation, one process per core, against `evaluate_policy` as documented, one environment",
    )
    table["extrapolate.HalfCheetah-v3.vs_sb3_fastest"] = lambda: evaluate_sb3(
        "HalfCheetah-v3",
        ("subprocesses", "envpool"),
        "evaluation, one process per core, against the faster of SubprocVecEnv and a 48-lane EnvPool VecEnv",
    )
    table["study.HalfCheetah-v3.vs_sb3"] = lambda: study("HalfCheetah-v3")
    peer = "gymnasium-robotics' FetchPickAndPlace-v4 (physics step 2 ms), one core"
    for what, cores, how in (
        (
            "scene",
            "0",
            "full SetTable scene while the oracle manipulates (30 Hz control, physics step 8.3 ms), one core",
        ),
        ("place", "0", "the place skill's environment, 64 side by side, resets included (the same steps), one core"),
        ("tasks", "0,1", "perdure home run set_table, 100 episodes from start to end (the same steps), two cores"),
    ):
        table[f"home.{what}.vs_fetch_env"] = lambda what=what, cores=cores, how=how: home(
            what, cores, f"{how}, against {peer}"
        )
    return table


def fill_pages(results: dict[str, Any]) -> None:
    """Put every row into docs/reference/speed.md, and the ratios of the main ones into README.md."""
    rows = ["| benchmark | ours | peer | ratio | how |", "|---|---|---|---|---|"]
    for name, row in sorted(results.items()):
        figures = f"{row['ours']:,.0f} | {row['peer']:,.0f} {row['unit']} | {row['ratio']:.2f}"
        rows.append(f"| `{name}` | {figures} | {row['how']} |")
    _fill(PAGE, "benchmark table", rows)
    rows = ["| | compared with | ratio |", "|---|---|---|"]
    for what, peer, names in SUMMARY:
        ratios = ", ".join(f"{results[name]['ratio']:.1f}" for name in names if name in results)
        rows.append(f"| {what} | {peer} | {ratios} |")
    _fill(README, "speed", rows)


def _fill(page: Path, mark: str, rows: list[str]) -> None:
    write_atomic(page, put(page.read_text(), mark, "\n".join(rows)))


def main() -> None:
    for python in (PEER_PYTHON, ROBOTICS_PYTHON):
        if not python.exists():
            sys.exit(f"no {python.parent.parent.name}: run `make bench`, which installs the peers")
    words = sys.argv[1:]
    results: dict[str, Any] = json.loads(LATEST.read_text()) if LATEST.exists() else {}
    console = Console()
    for name, case in cases().items():
        if words and not any(word in name for word in words):
            continue
        console.print(f"{name} ...")
        figure = case()
        results[name] = {
            "ours": round(figure.ours, 1),
            "peer": round(figure.peer, 1),
            "ratio": round(figure.ratio, 3),
            "unit": figure.unit,
            "how": figure.how,
        }
        write_atomic(LATEST, json.dumps(results, indent=1, sort_keys=True) + "\n")
    fill_pages(results)
    table = Table("benchmark", "ours", "peer", "ratio", "unit")
    for name, row in sorted(results.items()):
        table.add_row(name, f"{row['ours']:,.0f}", f"{row['peer']:,.0f}", f"{row['ratio']:.2f}", row["unit"])
    console.print(table, f"how each was measured: {LATEST}", sep="\n")


if __name__ == "__main__":
    main()
