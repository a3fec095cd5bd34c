"""Names of methods, settings and clocks in figures and tables."""

from __future__ import annotations

from collections.abc import Collection

from perdure.report import wording
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.grid import CLEANRL

METHODS = {
    "ppo": "discounted PPO",
    "ppo-undiscounted": "undiscounted PPO",
    "ppo-undiscounted-terminal": "undiscounted PPO, no bootstrap",
    "ppo-short": "PPO, episodes of 200 steps",
    "ppo-average-reward": "average-reward PPO",
    "linear": "linear time-to-go",
    "linear-10-workers": "linear time-to-go, ten workers",
    "linear-random": "linear time-to-go, random horizon",
    "geometric": "geometric time-to-go",
    "geometric-fixed": "geometric time-to-go, fixed horizon",
    "geometric-5": "geometric time-to-go, five numbers",
    "geometric-10": "geometric time-to-go, ten numbers",
    "geometric-film": "geometric time-to-go, FiLM",
    "random-horizon": "random horizon, no time-to-go",
}
RULES = {
    "chosen": "cross-validated C",
    "chosen periodic": "cross-validated C, repeated countdown",
    "best": "best C of the sweep",
    "value": "C by the critic",
    "bandit": "C by successive halving",
    "countdown": "countdown to the end",
}


def method(name: str) -> str:
    """Return a method in words: "ppo-gamma-0.99" -> "PPO, discount 0.99"."""
    if name.startswith("ppo-gamma-"):
        return f"PPO, discount {name.removeprefix('ppo-gamma-')}"
    return METHODS.get(name, name)


def condition(each: Condition) -> str:
    """Return a method and its clock in words."""
    if each.clock == "none":
        return method(each.method)
    return f"{method(each.method)}, {rule(each.clock)}"


def rule(name: str) -> str:
    """Return a rule for the clock in words."""
    kind, colon, steps = name.partition(":")
    return wording.clock(kind, steps) if colon else RULES[name]


def start_states(counts: Collection[int]) -> str:
    """Return how many start states training runs have, as a sentence."""
    least, most = min(counts), max(counts)
    number = wording.count(most, "start state") if least == most else f"{least} to {wording.count(most, 'start state')}"
    return f"Each training run: {number}."


def setting(name: str) -> str:
    """Return a setting in words: "Hopper-v3@cleanrl" -> "Hopper-v3 (CleanRL)"."""
    task, _, preset = name.partition("@")
    return f"{task} (CleanRL)" if preset == CLEANRL else task
