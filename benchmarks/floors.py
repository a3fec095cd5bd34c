"""What a training step cannot do without, however it is written: the engine's step and the networks' matrix products.

python benchmarks/floors.py [TASK ...]

For each task, in one run on core 0: microseconds of a step of one environment in EnvPool, fed ready actions; those that
the products of all minibatches take for each environment step, by NumPy's BLAS on one thread; what our training takes;
what Stable-Baselines3's takes (`make bench` makes its environment). The last column is the most that any program can
gain on this machine: optimiser, activations and acting are left out.
"""

from __future__ import annotations

import sys

from bench import ITERATIONS, ours, peers, sb3_config

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


if __name__ == "__main__":
    main(sys.argv[1:] or list(TASKS))
