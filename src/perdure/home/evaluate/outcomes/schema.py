"""The table `perdure.home.episodes.log`, version 2: one row per episode, as Parquet; any simulator can write it.

| column | type | meaning |
|---|---|---|
| task, split, index | text, text, int | the episode; `tidy_house`, `prepare_groceries` or `set_table` |
| episode_hash | text | equal hashes: equal starts and goals (elsewhere: any name of the episode) |
| arm, train_seed, eval_seed | text, int, int | what was run; -1 where nothing was trained |
| control_hz | float | control steps per second |
| steps, length | int | control steps of the episode; with the settling time after it |
| diverged | bool | the simulation blew up; nothing after the last step counts |
| targets | list | `kind`, `cylinder`, `container` ("", "drawer" or "fridge"), `goal_x`, `goal_y`, `goal_z`, |
| | | `stabilizing` |
| stages | list | `name`, `reached` (step at which it latched, -1 for never), `stabilizing` |
| runs | list | skills as they went: `number`, `skill`, `target`, `begin`, `end`, `ending` ("stopped", "timed out", |
| | | "task limit"), `success`, `forced_release`, `force`, `reach` |
| events | list | `step`, `held`, `in_goal` (list of bool), `drawer`, `fridge`: the state until the next event |
| releases | list | `target`, `object_speed`, `gripper_speed`, `base_speed`, `track` |
| final_objects | list | every object after the last step, targets first: `kind`, `x`, `y`, `z`, `qw`, `qx`, `qy`, |
| | | `qz`, `speed`, `held`; an empty list where unknown. Version 1 has no such column |

Lengths are in [m], speeds in [m/s], forces in [N], the fridge in [rad]; z is up. Steps count from 0: the state after
the first control step. A run acts in steps `begin` to `end` - 1.

An event is due at step 0 and whenever `held` (target in the hand, -1 nothing, -2 clutter or a handle), a member of
`in_goal` (within 0.15 m), or one of these changes: drawer at or above 0.4 m, at or below 0.1 m; fridge at or above
1.42 rad, at or below 0.15 rad. A grasp is an event at which `held` becomes a target, a release one at which it ceases
to be it. `stages` and `targets.stabilizing` follow from the events; a file in which they do not is refused.

`force` is the largest normal contact force at arm, hand and held object (not the base), `reach` the smallest distance
of the gripper point from the target's middle in the run; nan where unknown. A track holds lists of equal length:
`step`, `x`, `y`, `z` and `up` of the object (`up`: height of the object's z axis, 1 upright), `gripper_x`, `gripper_y`,
`gripper_z`, `base_x`, `base_y`, `base_yaw`. It begins with the last step in the hand and ends with the last step of
all, or before the hand takes the object again. Steps at which the object is within 2 mm (and 0.01 in `up`) of the step
before them in the track may be left out.

The file's key-value metadata holds `schema`, `version`, a SHA-256 of the content and what the writer adds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.home.errors import HomeError
from perdure.home.evaluate.log import EpisodeLog, Event, FinalObject, Release, SkillRun, Target, Track
from perdure.home.evaluate.outcomes.counting import stabilizing, stage_steps, stages_stabilizing
from perdure.home.evaluate.outcomes.fields import ROW

if TYPE_CHECKING:
    import polars as pl

SCHEMA_NAME, SCHEMA_VERSION = "perdure.home.episodes.log", "2"
READABLE_VERSIONS = ("1", "2")
FINAL_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TRACK_COLUMNS = ("x", "y", "z", "up", "gripper_x", "gripper_y", "gripper_z", "base_x", "base_y", "base_yaw")
_PLAIN = {
    **{name: name for name in ("task", "split", "index", "episode_hash")},
    "arm": "strategy",
    **{name: name for name in ("train_seed", "eval_seed", "control_hz", "steps", "length")},
}
"""Column to attribute of `EpisodeLog`."""
_RUN = ("number", "skill", "target", "begin", "end", "ending", "success", "forced_release", "force", "reach")


def columns(version: str = SCHEMA_VERSION) -> dict[str, pl.DataType]:
    """Return the columns of a version of the table and their types."""
    import polars as pl

    text, whole, real, flag = pl.String(), pl.Int64(), pl.Float64(), pl.Boolean()

    def rows(**fields: pl.DataType) -> pl.DataType:
        return pl.List(pl.Struct(fields))

    track = {"step": pl.List(pl.Int32()), **{name: pl.List(pl.Float32()) for name in TRACK_COLUMNS}}
    kinds = (text, text, whole, text, text, whole, whole, real, whole, whole)
    run_kinds = (whole, text, whole, whole, whole, text, flag, flag, real, real)
    final = rows(kind=text, **dict.fromkeys(FINAL_POSE, pl.Float32()), speed=pl.Float32(), held=flag)
    return {
        **dict(zip(_PLAIN, kinds, strict=True)),
        "diverged": flag,
        "targets": rows(
            kind=text, cylinder=flag, container=text, goal_x=real, goal_y=real, goal_z=real, stabilizing=flag
        ),
        "stages": rows(name=text, reached=whole, stabilizing=flag),
        "runs": rows(**dict(zip(_RUN, run_kinds, strict=True))),
        "events": rows(step=whole, held=whole, in_goal=pl.List(flag), drawer=real, fridge=real),
        "releases": rows(target=whole, object_speed=real, gripper_speed=real, base_speed=real, track=pl.Struct(track)),
        **({} if version == "1" else {"final_objects": final}),
    }


def to_frame(records: Sequence[EpisodeLog]) -> pl.DataFrame:
    """Return records as a table of the schema."""
    import polars as pl

    return pl.DataFrame([_to_row(record) for record in records], schema=columns())


def from_frame(frame: pl.DataFrame) -> list[EpisodeLog]:
    """Return records from a table of the schema.

    Raises:
        SchemaError: A value is out of its range, see `fields.py`.
        HomeError: A record contradicts itself.
    """
    return [_from_row(row) for row in frame.iter_rows(named=True)]


def _to_row(record: EpisodeLog) -> dict[str, Any]:
    kept = stabilizing(record)
    targets = [
        {
            **{"kind": target.kind, "cylinder": target.cylinder, "container": target.container},
            **dict(zip(("goal_x", "goal_y", "goal_z"), target.goal, strict=True)),
            "stabilizing": lasts,
        }
        for target, lasts in zip(record.targets, kept, strict=True)
    ]
    return {
        **{column: getattr(record, name) for column, name in _PLAIN.items()},
        "diverged": record.diverged,
        "targets": targets,
        "stages": _stages(record),
        "runs": [{name: getattr(run, name) for name in _RUN} for run in record.runs],
        "events": [{**vars(event), "in_goal": list(event.in_goal)} for event in record.events],
        "releases": [_release_row(release) for release in record.releases],
        "final_objects": [
            {
                "kind": each.kind,
                **dict(zip(FINAL_POSE, (*each.position, *each.quaternion), strict=True)),
                **{"speed": each.speed, "held": each.held},
            }
            for each in record.final_objects
        ],
    }


def _stages(record: EpisodeLog) -> list[dict[str, Any]]:
    names = [stage.name for stage in record.home_task.stages]
    counted = zip(names, stage_steps(record), stages_stabilizing(record), strict=True)
    return [{"name": name, "reached": step, "stabilizing": lasts} for name, step, lasts in counted]


def _release_row(release: Release) -> dict[str, Any]:
    track = release.track
    values = np.column_stack([track.position, track.up, track.gripper, track.base])
    poses = {name: column.tolist() for name, column in zip(TRACK_COLUMNS, values.T, strict=True)}
    speeds = {name: getattr(release, name) for name in ("object_speed", "gripper_speed", "base_speed")}
    return {"target": release.target, **speeds, "track": {"step": track.step.tolist(), **poses}}


def _from_row(row: Mapping[str, Any]) -> EpisodeLog:
    ROW.check(row)
    record = EpisodeLog(
        **{name: row[column] for column, name in _PLAIN.items()},
        diverged=row["diverged"],
        targets=tuple(
            Target(t["kind"], t["cylinder"], t["container"], (t["goal_x"], t["goal_y"], t["goal_z"]))
            for t in row["targets"]
        ),
        runs=tuple(SkillRun(**run) for run in row["runs"]),
        events=tuple(Event(**{**event, "in_goal": tuple(event["in_goal"])}) for event in row["events"]),
        releases=tuple(_release(release) for release in row["releases"]),
        final_objects=tuple(_final_object(each) for each in (row.get("final_objects") or ())),
    )
    if row["stages"] != _stages(record):
        raise HomeError(f"{record.name}: its stages do not follow from its events")
    if tuple(t["stabilizing"] for t in row["targets"]) != stabilizing(record):
        raise HomeError(f"{record.name}: which placements are goal-stabilizing does not follow from its events")
    return record


def _final_object(row: Mapping[str, Any]) -> FinalObject:
    x, y, z, qw, qx, qy, qz = (row[name] for name in FINAL_POSE)
    return FinalObject(row["kind"], (x, y, z), (qw, qx, qy, qz), row["speed"], row["held"])


def _release(row: Mapping[str, Any]) -> Release:
    lists = [row["track"][name] for name in ("step", *TRACK_COLUMNS)]
    if len({len(each) for each in lists}) != 1:
        raise HomeError(f"the lists of a track have different lengths: {[len(each) for each in lists]}")
    values = np.array(lists[1:], dtype=np.float64).T
    track = Track(np.array(lists[0], dtype=np.int64), values[:, :3], values[:, 3], values[:, 4:7], values[:, 7:])
    return Release(row["target"], row["object_speed"], row["gripper_speed"], row["base_speed"], track)
