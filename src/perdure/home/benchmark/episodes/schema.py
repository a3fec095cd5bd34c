"""What a file of episodes may hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from perdure.home.benchmark.tasks import TASKS
from perdure.home.sim.objects import KINDS
from perdure.schema import Anything, Choice, Items, Real, Rule, SchemaError, Table, Text, Whole

VERSION = 1
ROOM = 100.0
"""No coordinate in a room is larger, in [m]."""
_COUNT = 10_000
"""Kinds, receptacles or episodes in one file."""


@dataclass(frozen=True)
class PlacementRow:
    """A list [kind, x, y, z, qw, qx, qy, qz, receptacle]: position in [m] and unit quaternion between two indices."""

    def check(self, value: Any, where: str) -> None:
        """See `Kind.check`."""
        _NINE.check(value, where)
        _NUMBER.check(value[0], f"{where}[0]")
        _NUMBER.check(value[8], f"{where}[8]")
        if max(map(abs, value[1:4])) > ROOM:
            raise SchemaError(f"{where}[1:4] must be a position within {ROOM:g} m, not {value[1:4]}")
        if abs(math.hypot(*value[4:8]) - 1.0) > 1e-3:
            raise SchemaError(f"{where}[4:8] must be a unit quaternion, not {value[4:8]}")


_NINE, _NUMBER = Items(Real(-_COUNT, _COUNT), 9, 9), Whole(0, _COUNT)

_EPISODE = Table(
    {
        "index": Whole(0, _COUNT),
        "apartment": Items(Anything(1), 3, 3),
        "opened": Table({}, others=Real(-10.0, 10.0)),
        "objects": Items(PlacementRow()),
        "goals": Items(PlacementRow()),
    },
    rules=(
        Rule(
            "apartment must be two whole numbers and a fingerprint",
            lambda of: [type(each) for each in of("apartment")] != [int, int, str],
        ),
    ),
)
CONTENT = Table(
    {
        "schema": Text(100),
        "version": Whole(VERSION, VERSION),
        "task": Choice(tuple(TASKS)),
        "split": Text(50, shortest=1),
        "made_with": Table({}, others=Text()),
        "kinds": Items(Choice(tuple(KINDS)), longest=_COUNT),
        "receptacles": Items(Text(200), longest=_COUNT),
        "episodes": Items(_EPISODE, shortest=1, longest=_COUNT),
    },
    rules=(
        Rule(
            "a placement has a kind or a receptacle that is not in the file's lists",
            lambda of: any(
                row[0] >= len(of("kinds")) or row[8] >= len(of("receptacles"))
                for episode in of("episodes")
                for row in (*episode["objects"], *episode["goals"])
            ),
        ),
    ),
)
