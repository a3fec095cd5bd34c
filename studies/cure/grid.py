"""The training runs of the study and what each is deployed under. Immutable; extend it by a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from perdure.envs import task_spec
from perdure.horizon import usual_preset
from perdure.learn import PPOConfig, method_config
from perdure.learn.run import TrainRun
from perdure.learn.start import start_file
from perdure.policy import load_policy
from studies.disturbance.grid import POLICIES, TASKS, Condition
from studies.horizon.grid import ZOO

PHASES = {
    1: "discounted PPO, continued for 300,000 steps",
    2: "geometric time-to-go, trained from the start under the same noise for as many steps in all",
    3: "Ant with a quiet start, 3,000,000 steps",
}
NOISE = ("action_noise:0.1",)
BASE = "ppo"
"""The committed runs that are continued: discounted PPO."""
BASE_SEEDS = tuple(range(13, 20))
"""Of the committed runs; pilots used 10 to 12."""
ANT_SEEDS = tuple(range(40, 50))
"""Pilots used 30 to 32."""
CONTINUED_STEPS = 300_000
LONG_GAMMA = 0.999
CONTINUED_LOG_STD = {"HalfCheetah-v3": -1.5}
"""Log standard deviation with which training continues; -1 on other tasks. The preset of HalfCheetah starts at -2."""
FIRST_START = 3000
"""First of the start states, as in the study of disturbances."""
STARTS = 5

STANDARD = Condition("standard-1", ("standard-1",), 10_000)
PUSHES = Condition("pushes of 0.5 m/s", ("push:0.5",), 10_000)
CALM = Condition("calm", ("none",), 10_000)
CALM_LONG = Condition("calm", ("none",), 100_000)


@dataclass(frozen=True)
class Arm:
    """Training runs of one kind, on several tasks."""

    name: str
    """Folder of its runs."""
    words: str
    method: str
    phase: int
    tasks: tuple[str, ...] = TASKS
    seeds: tuple[int, ...] = BASE_SEEDS
    continued: bool = True
    """Each seed continues the committed run of `BASE` with the same seed."""
    gamma: float | None = None
    """None: that of the method and the preset."""
    disturb: tuple[str, ...] = NOISE
    """What disturbs every training episode."""
    total_steps: int = CONTINUED_STEPS
    settings: tuple[tuple[str, object], ...] = ()
    """Further fields of `PPOConfig`."""
    conditions: tuple[Condition, ...] = (STANDARD, PUSHES, CALM)

    def run(self, task: str) -> TrainRun:
        """Return the training runs on a task, which `perdure train` repeats."""
        start = None
        if self.continued:
            start = POLICIES / task / variant(BASE, task)
        preset = usual_preset(task)
        return TrainRun(
            task,
            self.name,
            self.config(task, start),
            self.seeds,
            preset=preset,
            base_method=self.method,
            disturb=self.disturb,
            start=start,
        )

    def config(self, task: str, start: Path | None) -> PPOConfig:
        """Return the learner's settings on a task."""
        config = method_config(self.method, task, task_spec(task).observation_size)
        if start is not None:
            config = config.continued(load_policy(start_file(start, self.seeds[0])))
            config = replace(config, log_std_init=CONTINUED_LOG_STD.get(task, -1.0))
        if self.gamma is not None:
            config = replace(config, protocol=replace(config.protocol, gamma=self.gamma))
        return replace(config, total_steps=self.total_steps, **dict(self.settings))  # type: ignore[arg-type]


QUIET = (("log_std_init", -1.0), ("learning_rate_decay", "linear"))
ARMS = (
    Arm("continued-long-noise", "continued, gamma 0.999, noise", "ppo", 1, gamma=LONG_GAMMA),
    Arm("continued-noise", "continued, the preset's gamma, noise", "ppo", 1),
    Arm("continued-long", "continued, gamma 0.999, no noise", "ppo", 1, gamma=LONG_GAMMA, disturb=()),
    Arm("continued-geometric-noise", "continued, a time-to-go added, no discount, noise", "geometric", 1),
    Arm(
        "geometric-noise-1.3M",
        "geometric time-to-go from the start, noise",
        "geometric",
        2,
        continued=False,
        total_steps=1_300_000,
    ),
    *(
        Arm(
            f"{method}-quiet",
            f"{words}, quiet start",
            method,
            3,
            tasks=("Ant-v3",),
            seeds=ANT_SEEDS,
            continued=False,
            disturb=(),
            total_steps=3_000_000,
            settings=QUIET,
            conditions=(CALM_LONG,),
        )
        for method, words in (("geometric", "geometric time-to-go"), ("ppo", "discounted PPO"))
    ),
)


def variant(name: str, task: str) -> str:
    """Return the folder of a kind of run on a task, such as "ppo@cleanrl"."""
    preset = usual_preset(task)
    if preset == ZOO:
        return name
    return f"{name}@{preset}"


def cells(phases: Sequence[int]) -> Iterator[tuple[Arm, str]]:
    """Yield the kinds of runs of some phases, with each of their tasks."""
    for arm in ARMS:
        if arm.phase in phases:
            for task in arm.tasks:
                yield arm, task
