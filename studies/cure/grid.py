"""The training runs of the study and what each is deployed under. Immutable; extend it by a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
    4: "secondary: other discounts, numbers of steps and disturbances; a time-to-go in the critic only",
    5: "robots to ship: continued for 1,000,000 steps under standard-1",
    6: "`--method steady` on fresh training seeds",
    7: "Ant and Humanoid, 10,000,000 steps",
    8: "pilots: FiLM layers, a task of dm_control, a hand",
    9: "what phases 3, 7 and 8 trained, continued",
    10: "Humanoid of phase 9, continued with a longer horizon still",
}
"""Phases 9 and 10 continue policies of earlier ones: they can be planned when these are in the results."""
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
CONTINUED_POLICIES = Path("results", "cure", "policies")
"""Of this study: TASK/KIND[@PRESET]/seed-N.safetensors."""
SECONDARY_SEEDS = BASE_SEEDS[:4]
CRITIC_SEEDS = BASE_SEEDS[:5]
SHIP_SEEDS = BASE_SEEDS[:3]
FRESH_SEEDS = (60, 61, 62)
LONG_SEEDS = (50, 51)
PILOT_TASKS = ("WalkerWalk-v1", "HandManipulateBlockRotateZDense-v1")
STABLE = ("standard-1",)
FIRST_CHOICE = 4000
"""First of the start states on which robots to ship are chosen. What ships is reported from 0 on."""
CHOICE_STARTS = 10
FIRST_START = 3000
"""First of the start states, as in the study of disturbances."""
STARTS = 5

STANDARD = Condition("standard-1", ("standard-1",), 10_000)
ACTION_NOISE = Condition("action noise 0.1", NOISE, 10_000)
PUSHES = Condition("pushes of 0.5 m/s", ("push:0.5",), 10_000)
CALM = Condition("calm", ("none",), 10_000)
CALM_LONG = Condition("calm", ("none",), 100_000)


CHOICE: dict[str, Any] = {"first": FIRST_CHOICE, "starts": CHOICE_STARTS, "conditions": (STANDARD, CALM_LONG)}
"""How robots to ship are evaluated."""


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
    base: str | None = BASE
    """Kind of run that is continued, each seed from the run with the same seed: committed ones of the horizon study, or
    an earlier phase of this one. None: trained from the start."""
    gamma: float | None = None
    """None: that of the method and the preset."""
    disturb: tuple[str, ...] = NOISE
    """What disturbs every training episode."""
    total_steps: int = CONTINUED_STEPS
    settings: tuple[tuple[str, object], ...] = ()
    """Further fields of `PPOConfig`."""
    conditions: tuple[Condition, ...] = (STANDARD, PUSHES, CALM)
    first: int = FIRST_START
    """First of the start states that its runs are evaluated from."""
    starts: int = STARTS

    def run(self, task: str) -> TrainRun:
        """Return the training runs on a task, which `perdure train` repeats."""
        start = self.base_folder(task)
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

    def base_folder(self, task: str) -> Path | None:
        """Return the folder of the policies that are continued, one for each seed; None: trained from the start."""
        if self.base is None:
            return None
        policies = POLICIES
        if any(self.base == arm.name for arm in ARMS):
            policies = CONTINUED_POLICIES
        return policies / task / variant(self.base, task)

    def config(self, task: str, start: Path | None) -> PPOConfig:
        """Return the learner's settings on a task."""
        config = method_config(self.method, task, task_spec(task).observation_size)
        if start is not None:
            config = config.continued(load_policy(start_file(start, self.seeds[0])))
            config = replace(config, log_std_init=CONTINUED_LOG_STD.get(task, -1.0))
        if self.gamma is not None:
            config = replace(config, protocol=replace(config.protocol, gamma=self.gamma))
        return replace(config, total_steps=self.total_steps, **dict(self.settings))  # type: ignore[arg-type]


ANT_CONTINUED = (("log_std_init", -1.5), ("learning_rate_decay", "linear"))
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
        base=None,
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
            base=None,
            disturb=(),
            total_steps=3_000_000,
            settings=QUIET,
            conditions=(CALM_LONG,),
        )
        for method, words in (("geometric", "geometric time-to-go"), ("ppo", "discounted PPO"))
    ),
    *(
        Arm(
            f"continued-{gamma}-noise", f"continued, gamma {gamma}, noise", "ppo", 4, seeds=SECONDARY_SEEDS, gamma=gamma
        )
        for gamma in (0.995, 0.9999)
    ),
    *(
        Arm(
            f"continued-long-noise-{name}",
            f"continued for {steps:,} steps, gamma 0.999, noise",
            "ppo",
            4,
            seeds=SECONDARY_SEEDS,
            gamma=LONG_GAMMA,
            total_steps=steps,
        )
        for name, steps in (("100k", 100_000), ("1M", 1_000_000))
    ),
    Arm(
        "continued-long-standard",
        "continued, gamma 0.999, standard-1",
        "ppo",
        4,
        seeds=SECONDARY_SEEDS,
        gamma=LONG_GAMMA,
        disturb=STABLE,
    ),
    Arm(
        "geometric-critic-noise",
        "geometric time-to-go in the critic only, from the start, noise",
        "geometric",
        4,
        tasks=("Hopper-v3", "Walker2d-v3"),
        seeds=CRITIC_SEEDS,
        base=None,
        total_steps=1_000_000,
        settings=(("conditioning", "critic"),),
    ),
    Arm(
        "ship",
        "continued for 1,000,000 steps, gamma 0.999, standard-1",
        "ppo",
        5,
        seeds=SHIP_SEEDS,
        gamma=LONG_GAMMA,
        disturb=STABLE,
        total_steps=1_000_000,
        **CHOICE,
    ),
    Arm(
        "ship",
        "continued for 1,000,000 steps, gamma 0.999, standard-1",
        "ppo",
        5,
        tasks=("Ant-v3",),
        seeds=(0, 1, 2),
        gamma=LONG_GAMMA,
        disturb=STABLE,
        total_steps=1_000_000,
        settings=ANT_CONTINUED,
        **CHOICE,
    ),
    Arm(
        "steady",
        "`--method steady`",
        "steady",
        6,
        tasks=(*TASKS, "Ant-v3"),
        seeds=FRESH_SEEDS,
        base=None,
        disturb=(),
        total_steps=1_000_000,
        conditions=(STANDARD, CALM_LONG),
    ),
    Arm(
        "ppo-quiet-10M",
        "discounted PPO, quiet start",
        "ppo",
        7,
        tasks=("Ant-v3",),
        seeds=LONG_SEEDS,
        base=None,
        disturb=(),
        total_steps=10_000_000,
        settings=QUIET,
        **CHOICE,
    ),
    Arm(
        "ppo-10M",
        "discounted PPO",
        "ppo",
        7,
        tasks=("Humanoid-v3",),
        seeds=LONG_SEEDS,
        base=None,
        disturb=(),
        total_steps=10_000_000,
        **CHOICE,
    ),
    Arm(
        "geometric-film-noise",
        "geometric time-to-go through FiLM layers, noise",
        "geometric-film",
        8,
        tasks=("Hopper-v3",),
        seeds=FRESH_SEEDS,
        base=None,
        total_steps=1_000_000,
    ),
    *(
        Arm(
            f"{method}-1M",
            words,
            method,
            8,
            tasks=PILOT_TASKS,
            seeds=FRESH_SEEDS,
            base=None,
            disturb=(),
            total_steps=1_000_000,
            conditions=(CALM, ACTION_NOISE),
        )
        for method, words in (("ppo", "discounted PPO"), ("geometric", "geometric time-to-go"))
    ),
    Arm(
        "pilot-continued",
        "continued, gamma 0.999, noise",
        "ppo",
        9,
        tasks=PILOT_TASKS,
        seeds=FRESH_SEEDS,
        base="ppo-1M",
        gamma=LONG_GAMMA,
        settings=(("learning_rate_decay", "linear"),),
        conditions=(CALM, ACTION_NOISE),
    ),
    *(
        Arm(
            f"ship-{base}",
            f"{words}, continued for 1,000,000 steps, gamma 0.999, standard-1",
            "ppo",
            9,
            tasks=("Ant-v3",),
            seeds=seeds,
            base=base,
            gamma=LONG_GAMMA,
            disturb=STABLE,
            total_steps=1_000_000,
            settings=ANT_CONTINUED,
            **CHOICE,
        )
        for base, seeds, words in (
            ("ppo-quiet", ANT_SEEDS[:3], "3,000,000 steps"),
            ("ppo-quiet-10M", LONG_SEEDS, "10,000,000 steps"),
        )
    ),
    *(
        Arm(
            f"humanoid-{gamma}",
            f"continued for 1,000,000 steps, gamma {gamma}, noise",
            "ppo",
            phase,
            tasks=("Humanoid-v3",),
            seeds=LONG_SEEDS,
            base=base,
            gamma=gamma,
            total_steps=1_000_000,
            settings=(("log_std_init", -2.0),),
            **CHOICE,
        )
        for phase, gamma, base in ((9, 0.99, "ppo-10M"), (10, 0.999, "humanoid-0.99"))
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
