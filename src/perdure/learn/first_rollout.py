"""What the first rollout says of a training that has just begun: whether to end an episode pays better than to go on.

Where a step earns less than nothing, an early end saves the rest of the episode. Without a discount nothing else
counts, and the policy may learn to fall. Ant is such a task: with a standard deviation of 1 its first policy pays
about 2 a step for its actions and gets 1 for being alive. Less noise at the start makes going on pay from the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from perdure.errors import warn
from perdure.learn.advantages import Ends
from perdure.learn.rollout import Episodes

if TYPE_CHECKING:
    from perdure.learn.run import TrainRun
    from perdure.runs import Observer, Status

REWARD = "first_rollout/reward_per_step"
EARLY_ENDS = "first_rollout/early_ends"


def first_rollout_facts(episodes: Episodes, ends: Ends) -> dict[str, float]:
    """Return the mean reward of a step of the first rollout, unscaled, and how many episodes the task itself ended.

    Args:
        episodes: The running episodes at each step, all begun within the rollout.
        ends: What ended at each step.
    """
    returns = np.asarray(episodes.returns)
    last = np.array(episodes.done)
    last[-1] = True  # those that run on count up to here
    return {
        REWARD: float(returns[last].sum() / returns.size),
        EARLY_ENDS: float(np.asarray(ends.terminated).sum()),
    }


def ending_pays(facts: Mapping[str, float]) -> bool:
    """Return whether an early end is worth more than going on, by the facts of the first rollout."""
    return facts.get(REWARD, 0.0) < 0 and facts.get(EARLY_ENDS, 0.0) > 0


def say_advice(run: TrainRun) -> Observer:
    """Return an observer that warns once, in what the run's algorithm says of the first facts of any seed."""
    said = run.command is not None  # another command than `perdure train` has other flags

    def observe(status: Status) -> None:
        nonlocal said
        for seed in run.seeds:
            text = ""
            if not said:
                text = run.config.advice(status[run.key(seed)].facts)
            if text:
                said = True
                warn(f"{run.task}: {text}")

    return observe
