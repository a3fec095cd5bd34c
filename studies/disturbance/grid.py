"""Which committed policies are evaluated, under which disturbances. Immutable; add a line to extend it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

POLICIES = Path("results", "horizon", "policies")
"""Of the horizon study: TASK/METHOD[@PRESET]/seed-N.safetensors."""
TASKS = ("Hopper-v3", "Walker2d-v3", "HalfCheetah-v3")
"""Of the registered claims: those that some policy fails."""
ROBOTS = (*TASKS, "Swimmer-v3")
LEFT_OUT = (
    # RL Zoo's settings, under which most policies stand still.
    "Hopper-v3/ppo",
    "Hopper-v3/geometric",
    # Trained when all episodes had been run.
    "Hopper-v3/ppo-short@cleanrl",
    "Walker2d-v3/ppo-short@cleanrl",
)
FIRST_START = 3000
"""First of the start states. The horizon study uses 1000 to 2009, the choice of `standard-1` 4000 to 4003
and 50000 to 50002."""
STARTS = 5
FAST_PUSH = {"HalfCheetah-v3": "push:1"}
"""What "push" is for a robot that runs several meters a second; for others, push:0.5."""


@dataclass(frozen=True)
class Condition:
    """What disturbs every episode."""

    name: str
    disturb: tuple[str, ...]
    """As `--disturb`; ("none",): calm; "push": by task."""
    steps: int
    held_out: bool = False
    """No part of `standard-1`: it tests what the verdict foresees."""
    world: str = ""
    """Another world of the same robot; "": the policy's own."""

    def disturbs(self, task: str) -> tuple[str, ...]:
        """Return what is applied to a task."""
        push = FAST_PUSH.get(task, "push:0.5")
        return tuple({"push": push}.get(each, each) for each in self.disturb)


CONDITIONS = (
    Condition("calm", ("none",), 10_000),
    Condition("action noise 0.1", ("action_noise:0.1",), 10_000),
    Condition("standard-1", ("standard-1",), 10_000),
    Condition("pushes", ("push",), 10_000),
    Condition("slope of 3 degrees", ("slope:3",), 3_000, held_out=True),
    Condition("payload off center", ("payload:0.1",), 3_000, held_out=True),
    Condition("slow actuators", ("lag:0.3",), 3_000, held_out=True),
    Condition("half the time step", ("time_step:0.5",), 3_000, held_out=True),
    Condition("Walker2d-v5", ("none",), 3_000, held_out=True, world="gymnasium:Walker2d-v5"),
    Condition("observation noise 0.05", ("observation_noise:0.05",), 3_000),
    Condition("mass x 1.2", ("mass:1.2",), 3_000),
)
"""In the order in which they run. Written down before the first run; the levels of the held-out ones were not tried."""

REGISTERED = (
    Condition("action noise 0.1", ("action_noise:0.1",), 10_000),
    Condition("pushes of 0.5 m/s", ("push:0.5",), 10_000),
    Condition("standard-1", ("standard-1",), 10_000),
    Condition("calm", ("none",), 100_000),
)
"""Of training seeds 10 to 19: those of the five registered claims (results/horizon/registered.md), and `standard-1`."""


@dataclass(frozen=True)
class Subject:
    """All committed training runs of one method on one task."""

    task: str
    variant: str
    """Method, and its preset if it is not RL Zoo's: "ppo@cleanrl"."""
    files: tuple[Path, ...]


def subjects(robots: Sequence[str] = ROBOTS, seeds: str = "?") -> Iterator[Subject]:
    """Yield every subject of the study, in the order of its task, then by name.

    Args:
        robots: The tasks.
        seeds: Pattern of the training seeds: "?": 0 to 9; "1?": 10 to 19.
    """
    for robot in robots:
        for folder in sorted((POLICIES / robot).iterdir()):
            files = sorted(folder.glob(f"seed-{seeds}.safetensors"))
            if files and f"{robot}/{folder.name}" not in LEFT_OUT:
                yield Subject(robot, folder.name, tuple(files))


GRIDS = {1: (CONDITIONS, ROBOTS, "?"), 2: (REGISTERED, TASKS, "1?"), 3: (REGISTERED[2:3], TASKS, "2?")}
"""Phase to conditions, tasks, and pattern of training seeds."""
