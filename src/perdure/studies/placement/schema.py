"""Schema of `tables/strategies.json`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from perdure.home.benchmark.tasks import get_task
from perdure.home.evaluate.outcomes import COUNTINGS, FAILURE_CAUSES
from perdure.home.sim.objects import KINDS
from perdure.schema import Choice, Flag, Items, Real, Rule, Table, Text, Whole
from perdure.studies.placement.names import RELEASE_STRATEGIES, SPLITS, TITLES, WORLDS

RELEASE = ("release_height", "release_offset", "object_speed", "base_speed", "tilt")
"""Height and offset in [m], speeds in [m/s], tilt in [deg]."""


@dataclass(frozen=True)
class StrategyInWorld:
    """A release strategy in a world, such as "ik drag"."""

    def check(self, value: Any, where: str) -> None:
        """See `perdure.schema.Kind`."""
        NAME.check(value, where)
        strategy, _, world = value.partition(" ")
        STRATEGY.check(strategy, f"the strategy in {where}")
        WORLD.check(world, f"the world in {where}")


STAGES = {task: [stage.name for stage in get_task(task).stages] for task in TITLES}
STAGE_NAMES = dict.fromkeys(stage for stages in STAGES.values() for stage in stages)
NAME = Text(shortest=1)
STRATEGY, WORLD = Choice(RELEASE_STRATEGIES), Choice(tuple(WORLDS))
SUBJECT = {"task": Choice(tuple(TITLES)), "split": Choice(tuple(SPLITS))}
COUNT = Whole(0)
SHARE = Real(0.0, 1.0)
BOUND = Real(-1.0, 1.0, unknown=True)
DIFFERENCE = dict.fromkeys(("estimate", "lower", "upper"), BOUND)
SUCCESS = Table(
    {
        "mean": SHARE,
        **dict.fromkeys(("standard_error", "lower", "upper"), BOUND),
        "method": NAME,
        "train_seeds": Items(SHARE, shortest=1),
    }
)
KIND = Table(
    {
        "placements": COUNT,
        "not_stable": COUNT,
        "median_at_release": Table(dict.fromkeys(RELEASE, Real(unknown=True))),
    }
)
ROW = Table(
    {
        **SUBJECT,
        "strategy": StrategyInWorld(),
        "episodes": Whole(1),
        "seeds": Table({"train": Whole(1), "eval": Whole(1)}),
        **dict.fromkeys(COUNTINGS, SUCCESS),
        "stages": Table(dict.fromkeys(COUNTINGS, Table({}, optional=dict.fromkeys(STAGE_NAMES, SHARE)))),
        "kinds": Table({}, optional=dict.fromkeys(KINDS, KIND)),
        "failed": COUNT,
        "failed_at": Table({}, optional=dict.fromkeys(STAGE_NAMES, COUNT)),
        "did_not_last": COUNT,
        "modes": Table({}, optional={f"{stage}, {cause}": COUNT for stage in STAGE_NAMES for cause in FAILURE_CAUSES}),
        "hand_overs": Table({}, others=COUNT),
    },
    optional={"earlier_run": Flag()},  # true: numbers of a run whose logs were not kept
    rules=(
        Rule(
            "stages must be all stages of the task, in order",
            lambda of: any(list(stages) != STAGES[of("task")] for stages in of("stages").values()),
        ),
    ),
)
PAIR = Table(
    {
        **SUBJECT,
        "strategy": NAME,
        "world": WORLD,
        "first": STRATEGY,
        "second": STRATEGY,
        **DIFFERENCE,
        "placements": Table(DIFFERENCE),
        "units": Whole(1),
        "method": NAME,
    }
)
RESULTS = Table({"commands": Items(NAME), "rows": Items(ROW), "pairs": Items(PAIR)})
