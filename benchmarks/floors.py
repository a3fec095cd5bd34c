"""What a step cannot do without, however it is written.

python benchmarks/floors.py [TASK ...]     training: the engine's step and the networks' matrix products
python benchmarks/floors.py home           the home world: MuJoCo's `mj_step`

For each task, in one run on core 0: microseconds of a step of one environment in EnvPool, fed ready actions; those that
the products of all minibatches take for each environment step, by NumPy's BLAS on one thread; what our training takes;
what Stable-Baselines3's takes (`make bench` makes its environment). The last column is the most that any program can
gain on this machine: optimizer, activations and acting are left out.

For the home world: how many times the simulated seconds a second of gymnasium-robotics' FetchPickAndPlace-v4 we make,
as in `make bench`, which share of our time MuJoCo takes, and what a program would make that needs no other time.
"""

from __future__ import annotations

import json
import subprocess
import sys

from bench import HERE, ITERATIONS, cases, one_thread, ours, peers, sb3_config

TASKS = ("Hopper-v3", "HalfCheetah-v3", "Ant-v3")


def main(tasks: list[str]) -> None:
    """Prints one row a task."""
    print("| task | engine | products | together | ours | Stable-Baselines3 | most that can be gained |")
    print("|---|---|---|---|---|---|---|")
    for task in tasks:
        floor = ours("0", "floors", task)
        needed = floor["engine"] + floor["products"]
        mine = 1e6 / ours("0", "train", task, 1, ITERATIONS[task], 1)["steps_per_second"]
        config = sb3_config(task, 0, ITERATIONS[task])
        peer = 1e6 / peers("0", "sb3_train.py", [config])[0]["steps_per_second"]
        values = " | ".join(f"{each:,.0f} us" for each in (floor["engine"], floor["products"], needed, mine, peer))
        print(f"| {task} | {values} | {peer / needed:.1f} times |", flush=True)


def home() -> None:
    """Prints one row for each of the two worlds that are timed without anybody acting."""
    print("| what | ours, times FetchPickAndPlace-v4 | share of MuJoCo | most that can be gained |")
    print("|---|---|---|---|")
    for what in ("scene", "place"):
        figure = cases()[f"home.{what}.vs_fetch_env"]()
        command = ["taskset", "-c", "0", sys.executable, str(HERE / "measure_home.py"), what]
        output = subprocess.run(command, check=True, capture_output=True, text=True, env=one_thread()).stdout
        share = json.loads(output.splitlines()[-1])["engine_share"]
        print(f"| {what} | {figure.ratio:.2f} | {share:.2f} | {figure.ratio / share:.1f} times |", flush=True)


if __name__ == "__main__":
    if sys.argv[1:] == ["home"]:
        home()
    else:
        main(sys.argv[1:] or list(TASKS))
