"""A callback that judges a policy while Stable-Baselines3 trains it."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from perdure.disturbances import CALM
from perdure.errors import PerdureError
from perdure.evaluate.episodes import whole
from perdure.evaluate.run import extrapolate
from perdure.evaluate.table import ExtrapolationResult
from perdure.report.comparison import BETTER, compare_policies
from perdure.report.estimates import estimate_table
from perdure.report.outcomes import WORKED

try:
    BaseCallback: Any = import_module("stable_baselines3.common.callbacks").BaseCallback
except ImportError:
    BaseCallback = object


class VerdictCallback(BaseCallback):  # type: ignore[misc]
    """Evaluates the policy beyond its training horizon: at the start, every so many training steps, and at the end.

    Actions are deterministic, behind the current statistics of a `VecNormalize`. The model's logger, and with it
    TensorBoard and Weights & Biases, gets `perdure/holds_calm` (share of the episodes that hold),
    `perdure/mean_return_calm` and `perdure/median_failure_step_calm` (absent while less than half fail), and the same
    with `_standard-1`, or what else disturbs. The last evaluation is `result`.

    Args:
        env: A name, or a factory that applies the wrappers of training.
        every_steps: Training steps between two evaluations.
        steps: Steps of an evaluated episode.
        best: A file such as "best/model.zip". The model is saved there after the first evaluation, and again whenever
            it is better than the one there: by disturbed work over the same start states, as `perdure.compare` decides
            (an equal model replaces it with a chance of at most 2.5 %). A `VecNormalize` goes beside it, as
            vecnormalize.pkl.
        options: As `perdure.extrapolate` takes them, but not `clocks`, `hours`, `out` or `recurrent`. By default there
            are 3 calm episodes, and 36 of 10,000 steps under standard-1.
    """

    def __init__(
        self, env: Any, *, every_steps: int = 100_000, steps: int = 10_000, best: Any = None, **options: Any
    ) -> None:
        if BaseCallback is object:
            raise PerdureError("VerdictCallback needs Stable-Baselines3: pip install stable-baselines3")
        if refused := options.keys() & {"clocks", "hours", "out", "recurrent"}:
            raise PerdureError(f"VerdictCallback takes no {', '.join(sorted(refused))}")
        super().__init__()
        self.env = env
        self.options = {"steps": steps, **options}
        self.every_steps = whole("every_steps", every_steps, 1)
        self._evaluated = 0
        self.result: ExtrapolationResult | None = None
        self.best = None if best is None else Path(best)
        self.best_result: ExtrapolationResult | None = None

    def _on_training_start(self) -> None:
        self.num_timesteps = self.model.num_timesteps
        self._on_training_end()  # what is wrong with the environment or the options shows before hours of training

    def _on_step(self) -> bool:
        if self.num_timesteps // self.every_steps > self._evaluated // self.every_steps:
            self._on_training_end()
        return True

    def _on_training_end(self) -> None:
        model = self.model
        normalizer = model.get_vec_normalize_env()
        space = model.observation_space
        recurrent = hasattr(model.policy, "lstm_actor")  # RecurrentPPO of sb3-contrib

        def act(observations: Any, state: Any = None, starts: Any = None) -> Any:
            parts = observations if isinstance(observations, dict) else {"array": observations}
            given = {name: sorted(part.shape[1:]) for name, part in parts.items()}  # SB3 moves the channels of images
            needed = {name: sorted(part.shape) for name, part in getattr(space, "spaces", {"array": space}).items()}
            if given != needed:
                raise PerdureError(
                    f"VerdictCallback: the model observes shapes {needed}, env gives {given}: pass a function that "
                    "builds the environment with the wrappers of training (docs/how-to/check-in-ci.md)"
                )
            seen = observations if normalizer is None else normalizer.normalize_obs(observations)
            actions, state = model.predict(seen, state, starts, deterministic=True)
            return (actions, state) if recurrent else actions

        drawn = np.random.get_state()  # training shuffles by it; environments, and importing JAX, draw from it, too
        self.result = extrapolate(act, self.env, recurrent=recurrent, **self.options)
        np.random.set_state(drawn)
        self._evaluated = self.num_timesteps
        if self.best is not None and self._is_best(self.result):
            self.best_result = self.result
            self.best.parent.mkdir(parents=True, exist_ok=True)
            model.save(self.best)
            if normalizer is not None:
                normalizer.save(str(self.best.parent / "vecnormalize.pkl"))
        for item in (item for items in estimate_table(self.result.frame).values() for item in items):
            values = {"holds": float(item.verdict.share.estimate), "mean_return": item.final_return}
            values["median_failure_step"] = item.group.half_failed_by
            for name, value in values.items():
                if math.isfinite(value):
                    key = f"perdure/{name}_{'calm' if (met := item.group.disturbance) == CALM else met}"
                    # The library's text table cuts longer names, and refuses two that it cuts alike.
                    self.logger.record(key, value, None if len(key) <= 41 else ("stdout", "log"))
        self.logger.dump(self.num_timesteps)

    def _is_best(self, result: ExtrapolationResult) -> bool:
        """Return whether a result is the first, or better than that of the model that was saved."""
        import polars as pl

        if self.best_result is None:
            return True
        if not (result.frame["policy_state"] == WORKED).any():
            return False  # an untrained policy does no work
        sides = []
        for name, frame in (("saved", self.best_result.frame), ("new", result.frame)):
            sides.append(frame.with_columns(pl.lit(name).alias("policy"), pl.lit(0, pl.Int64).alias("train_seed")))
        frame = pl.concat(sides).sort(pl.col("disturbance") != CALM, maintain_order=True)
        return compare_policies(frame, ("saved", 0), ("new", 0), "work").verdict == BETTER
