"""Train a row of the grid: one step of the study."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from perdure.ppo import PPOConfig, method_config
from perdure.runs import Unit
from perdure.studies.horizon.grid import Grid, Row, training_folder
from perdure.studies.horizon.row_step import RowStep
from perdure.studies.status import count_units
from perdure.studies.study import RunOptions, StepProgress

if TYPE_CHECKING:
    from perdure.ppo.training import TrainRun

POLICY, EPISODES = "policy.safetensors", "episodes.parquet"
LANE_STEPS_PER_TRAINING_STEP = {"HalfCheetah": 10.0, "Hopper": 2.6, "Walker2d": 4.0, "Ant": 2.0, "Swimmer": 3.0}
"""What a training step costs beside a lane step of the bare task (HalfCheetah and Hopper: make bench; the others are
estimates). Tasks without a number count as Hopper."""

COMPILE_SECONDS = 10.0
"""Seconds for starting a process and compiling, for each seed."""


@dataclass(frozen=True)
class TrainRow(RowStep):
    """All training seeds of a row."""

    stage: str = "training"

    measure = "training steps"
    after = ()

    @cached_property
    def run_(self) -> TrainRun:
        """What is trained."""
        return train_run(self.grid, self.row)

    @cached_property
    def _units(self) -> list[Unit]:
        return [self.run_.unit(seed) for seed in self.row.seeds]

    @property
    def amount(self) -> float:
        """See `StudyStep`."""
        return sum(unit.size for unit in self._units)

    def seconds(self, speed: float) -> float:
        """See `StudyStep`."""
        robot = self.task.partition("-")[0]
        ratio = LANE_STEPS_PER_TRAINING_STEP.get(robot, LANE_STEPS_PER_TRAINING_STEP["Hopper"])
        return COMPILE_SECONDS * len(self.row.seeds) + self.amount * ratio / speed

    def progress(self) -> StepProgress:
        """See `StudyStep`."""
        sizes = {unit.key: unit.size for unit in self._units}
        return count_units(training_folder(self.out), sizes, {unit.key: unit.config for unit in self._units})

    def run(self, options: RunOptions) -> None:
        """See `StudyStep`."""
        from perdure.ppo.training import train

        train(
            self.run_,
            training_folder(self.out),
            cores=options.cores,
            on=options.on,
            observe=options.observe,
            waiting=options.waiting,
        )


def train_run(grid: Grid, row: Row) -> TrainRun:
    """Return the training run of a row; its units are those of `perdure train TASK --method METHOD --preset PRESET`."""
    from perdure.ppo.training import TrainRun

    config, base = row_config(grid, row), _base_method(row)
    return TrainRun(row.task, row.method, config, row.seeds, preset=row.preset, base_method=base)


def row_config(grid: Grid, row: Row) -> PPOConfig:
    """Return the learner's settings of a row."""
    from perdure.envs import make_world

    world = make_world(row.task, [0])
    size = world.spec.observation_size
    world.close()
    config = method_config(_base_method(row), row.task, size, row.preset)
    if row.gamma is not None:
        config = replace(config, protocol=replace(config.protocol, gamma=row.gamma))
    return config if grid.training_steps is None else replace(config, total_steps=grid.training_steps)


def _base_method(row: Row) -> str:
    """Return the method whose settings a row starts from."""
    return "ppo" if row.gamma is not None else row.method


def seed_folders(out: Path, row: Row) -> dict[int, Path]:
    """Return the folder of each finished training seed of a row."""
    folders = {seed: training_folder(out) / row.key / f"seed-{seed}" for seed in row.seeds}
    return {seed: folder for seed, folder in folders.items() if (folder / EPISODES).is_file()}


def policy_paths(out: Path, row: Row) -> list[Path]:
    """Return the policy files of a row, trained or not, in the order of its seeds."""
    return [training_folder(out) / row.key / f"seed-{seed}" / POLICY for seed in row.seeds]
