"""The command ``demo``: a shipped Hopper that falls when disturbed, the same one cured, and their page."""

from __future__ import annotations

from pathlib import Path

from perdure.cli.extrapolate import extrapolate_words
from perdure.cli.parse import Cores, call

POLICIES = ("Hopper-v3/cured", "Hopper-v3/ppo")


def main(name: str, args: list[str]) -> None:
    """Run the command."""
    call(demo, args, name)


def demo(out: Path = Path("demo"), steps: int = 20_000, eval_seeds: int = 3, cores: Cores = None) -> None:
    """Run two shipped Hoppers, calm and under small disturbances, and write the page: a minute on two cores.

    Both hold when calm. Under standard-1 the one that was not cured falls.

    Args:
        out: Folder for the table and the page.
        steps: Steps of the calm episodes.
        eval_seeds: Start states of the calm episodes.
    """
    words = [*POLICIES, "--steps", str(steps), "--eval-seeds", str(eval_seeds), "--out", str(out)]
    if cores is not None:
        words += ["--cores", str(cores)]
    falls = POLICIES[1]
    print("A Hopper before and after its cure: ppo, and cured, which perdure cure trained further.")
    print(f"This runs each for {steps:,} calm steps, and 36 times under standard-1 (small disturbances).\n", flush=True)
    extrapolate_words(words)
    print("Open it in a browser. Then:")
    print(f"  perdure watch {falls} --out fall.mp4                   see it fall (needs perdure[film])")
    print(f"  perdure cure {falls}                                   make it hold (minutes)")
    print("  perdure extrapolate model.zip --env Hopper-v5 --out mine    judge your own policy")
