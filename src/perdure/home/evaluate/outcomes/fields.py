"""What the rows of a file of logs may hold: ranges of every column of `schema.py`, and rules between them."""

from __future__ import annotations

from perdure.home.benchmark.tasks import TASKS
from perdure.home.evaluate.log.episode_log import CONTAINERS, ENDINGS
from perdure.schema import Choice, Flag, Items, Maybe, Real, Rule, Table, Text, Whole

LONGEST = 1_000_000
"""Control steps of an episode."""
FAR = 1e9
"""No position is farther from the room's origin, in [m]; a simulation that blows up throws objects far."""
_NAME = Text(200, shortest=1)
_STEP = Whole(0, LONGEST)
_PLACE = Real(-FAR, FAR)
_SPEED = Real(0.0, unknown=True)
_TARGETS = 100

TRACK = Table(
    {
        "step": Items(_STEP, shortest=1),
        **{name: Items(_PLACE) for name in ("x", "y", "z", "gripper_x", "gripper_y", "gripper_z", "base_x", "base_y")},
        "up": Items(Real(-1.001, 1.001)),
        "base_yaw": Items(Real(-1e6, 1e6)),
    }
)
TARGET = Table(
    {
        "kind": _NAME,
        "cylinder": Flag(),
        "container": Choice(CONTAINERS),
        **dict.fromkeys(("goal_x", "goal_y", "goal_z"), _PLACE),
        "stabilizing": Flag(),
    }
)
RUN = Table(
    {
        "number": Whole(0, 10_000),
        "skill": _NAME,
        "target": Whole(0, _TARGETS),
        "begin": _STEP,
        "end": _STEP,
        "ending": Choice(ENDINGS),
        "success": Flag(),
        "forced_release": Flag(),
        "force": Real(0.0, unknown=True),
        "reach": Real(0.0, unknown=True),
    }
)
EVENT = Table(
    {
        "step": _STEP,
        "held": Whole(-2, _TARGETS),
        "in_goal": Items(Flag(), longest=_TARGETS),
        "drawer": Real(-10.0, 10.0),
        "fridge": Real(-10.0, 10.0),
    }
)
RELEASE = Table(
    {
        "target": Whole(0, _TARGETS),
        **dict.fromkeys(("object_speed", "gripper_speed", "base_speed"), _SPEED),
        "track": TRACK,
    }
)
FINAL = Table(
    {
        "kind": _NAME,
        **dict.fromkeys(("x", "y", "z"), _PLACE),
        **dict.fromkeys(("qw", "qx", "qy", "qz"), Real(-1.001, 1.001)),
        "speed": Real(0.0),
        "held": Flag(),
    }
)
ROW = Table(
    {
        "task": Choice(tuple(TASKS)),
        "split": Text(50, shortest=1),
        "index": Whole(0, 1_000_000),
        "episode_hash": _NAME,
        "arm": _NAME,
        "train_seed": Whole(-1),
        "eval_seed": Whole(-1),
        "control_hz": Real(0.0, 1e5, above=True),
        "steps": Whole(1, LONGEST),
        "length": Whole(1, LONGEST),
        "diverged": Flag(),
        "targets": Items(TARGET, longest=_TARGETS),
        "stages": Items(Table({"name": _NAME, "reached": Whole(-1, LONGEST), "stabilizing": Flag()}), longest=_TARGETS),
        "runs": Items(RUN),
        "events": Items(EVENT, shortest=1),
        "releases": Items(RELEASE),
    },
    optional={"final_objects": Maybe(Items(FINAL, longest=10_000))},
    rules=(
        Rule(
            "held must be a target of the episode, -1 or -2",
            lambda of: any(event["held"] >= len(of("targets")) for event in of("events")),
        ),
    ),
)
"""One row of the table."""
POLICIES = Table({}, others=Text(5000, lines=True))
"""The note `policies`: skill to who acted, a path among it; paths may hold any bytes."""
HAND_OVERS = Table({}, others=Whole(0))
"""The note `hand_overs`: outcome of a release strategy to how often it came."""
NOTES = Table({}, others=Text(100_000, lines=True))
"""Everything in a file's metadata."""
