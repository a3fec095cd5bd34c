"""Logs on disk: what is written is what is read; what is not whole is refused by name."""

import io
import json
from dataclasses import asdict, replace

import numpy as np
import polars as pl
import pytest
from home_stories import NOTES, Story, good, random_log
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal
from test_failure_modes import missed, placed_and_gone

from perdure.errors import PerdureError
from perdure.home.evaluate import files
from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.files import (
    SCHEMA_NAME,
    SCHEMA_VERSION,
    columns,
    describe_columns,
    read_logs,
    to_frame,
    write_logs,
)
from perdure.home.evaluate.log import Release
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.scene import SceneOptions


@pytest.fixture(scope="module")
def logs():
    return [
        good(0),
        good(1),
        replace(placed_and_gone().log(), eval_seed=1),
        replace(missed(Story(), 0).log(), eval_seed=2),
    ]


@pytest.fixture
def path(tmp_path, logs):
    return write_logs(tmp_path / "logs.parquet", logs, {**NOTES, "command": "perdure home run"})


def test_a_file_gives_back_what_was_written(path, logs):
    assert_frame_equal(to_frame(read_logs(path)), to_frame(logs), check_exact=True)
    one, other = analyze(read_logs(path)), analyze(logs)
    assert all(getattr(one, name).equals(getattr(other, name)) for name in vars(one))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(("prepare_groceries", "tidy_house", "set_table")))
def test_any_log_gives_the_same_analysis_from_its_file(tmp_path_factory, seed, task):
    log = random_log(np.random.default_rng(seed), task=task)
    found = read_logs(write_logs(tmp_path_factory.mktemp("logs") / "a.parquet", [log], NOTES))
    one, other = analyze(found), analyze([log])
    assert all(getattr(one, name).equals(getattr(other, name)) for name in vars(one))


def test_events_say_who_held_what_when(path, logs):
    record, log = read_logs(path)[0], logs[0]
    for step in range(record.length):
        event = record.at(step)
        distance = np.linalg.norm(log.history.facts.object_positions[step] - log.history.facts.goal_positions, axis=1)
        assert (event.held, event.in_goal) == (log.history.facts.held[step], tuple(distance <= 0.15))


def test_a_track_stays_within_2_mm_of_every_step(path, logs):
    record, log = read_logs(path)[2], logs[2]
    assert [release.target for release in record.releases] == [0, 1, 2]
    for release in record.releases:
        last = int(release.track.step[-1])
        rows = release.track.rows(release.step, last)
        true = log.history.facts.object_positions[release.step : last + 1, release.target]
        assert last == record.length - 1
        assert np.linalg.norm(release.track.position[rows] - true, axis=1).max() < 0.0025
        assert len(release.track.step) < 20 < len(rows)


def test_the_release_is_the_last_step_in_the_hand(path, logs):
    record, log = read_logs(path)[0], logs[0]
    for release in record.releases:
        assert log.history.facts.held[release.step] == release.target
        assert log.history.facts.held[release.step + 1] != release.target


def test_equal_episodes_have_equal_hashes(path):
    hashes = [record.episode_hash for record in read_logs(path)]
    assert hashes[0] == hashes[2] == hashes[3] != hashes[1]


def test_a_long_episode_with_five_rolling_objects_is_small(tmp_path):
    """TidyHouse in which every object rolls away for two seconds and the robot never stands still."""
    story, rng = Story("tidy_house"), np.random.default_rng(0)
    for target in range(5):
        for _ in range(700):
            story.base += rng.normal(0.0, 0.01, 3)
            story.gripper += rng.normal(0.0, 0.01, 3)
            story.wait()
        story.go(target)
        for _ in range(60):
            story.slide(target, rng.normal(0.0, 0.01, 3), 1, tilt=float(rng.normal(0.0, 3.0)))
    path = write_logs(tmp_path / "one.parquet", [story.log()], NOTES)
    rest = path.stat().st_size - write_logs(tmp_path / "good.parquet", [good()], NOTES).stat().st_size
    assert len(story.rows) > 3500
    assert rest < 30_000


BAD = {
    "missing": (None, "does not exist"),
    "text": (lambda content: b"no table", "not a Parquet file"),
    "cut off": (lambda content: content[: len(content) // 2], "damaged"),
    "empty": (lambda content: b"", "not a Parquet file"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_file_that_is_not_whole_is_refused_by_its_name(path, what):
    damage, sentence = BAD[what]
    content = path.read_bytes()
    path.unlink()
    if damage is not None:
        path.write_bytes(damage(content))
    with pytest.raises(PerdureError, match=rf"logs\.parquet.*{sentence}"):
        read_logs(path)


def test_flipped_bits_are_never_read_as_something_else(path):
    content, rng = path.read_bytes(), np.random.default_rng(0)
    true, refused = to_frame(read_logs(path)), 0
    for position in rng.integers(4, len(content), size=200):
        broken = bytearray(content)
        broken[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(broken))
        try:  # some bits mean nothing, such as those of the columns' statistics
            assert_frame_equal(to_frame(read_logs(path)), true, check_exact=True)
        except PerdureError as error:
            refused += "logs.parquet" in str(error)
    assert refused > 60


def rewrite(path, frame, **notes):
    """Writes a frame with a digest that fits it."""
    notes = {"schema": SCHEMA_NAME, "version": SCHEMA_VERSION, **notes}
    buffer = io.BytesIO()
    frame.write_parquet(buffer, metadata={**notes, "sha256": files.digest(frame, notes)})
    path.write_bytes(buffer.getvalue())


def test_the_digest_sees_in_which_list_a_value_is(path):
    one, other = pl.read_parquet(path), pl.read_parquet(path).to_dicts()
    other[1]["events"].insert(0, other[0]["events"].pop())
    other = pl.DataFrame(other, schema=one.schema)
    assert other["events"].explode().equals(one["events"].explode())
    assert files.digest(one, {}) != files.digest(other, {})


def changed(frame, column, change):
    rows = frame.to_dicts()
    change(rows[0][column])
    return pl.DataFrame(rows, schema=frame.schema)


def shorter(releases):
    releases[0]["track"]["x"].pop()


def unknown_ending(runs):
    runs[0]["ending"] = "bored"


def put(*steps_and_value):
    """A change that puts a value at a place in nested lists and tables."""
    *path, last, value = steps_and_value

    def change(column):
        for step in path:
            column = column[step]
        column[last] = value

    return change


OUT_OF_RANGE = {
    "null skill": ("runs", put(0, "skill", None), "skill"),
    "attempt 0 of a run": ("runs", put(0, "attempt", 0), "attempt"),
    "target that is not there": ("runs", put(0, "target", -1), "target"),
    "nan in a track": ("releases", put(0, "track", "x", 1, float("nan")), "track"),
    "null in a track": ("releases", put(0, "track", "up", 0, None), "track"),
    "a track that is null": ("releases", put(0, "track", "z", None), "track"),
    "held 99": ("events", put(0, "held", 99), "held"),
    "a held target that is not there": ("events", put(0, "held", 3), "a held target that is not there"),
    "in_goal that is null": ("events", put(0, "in_goal", None), "in_goal"),
    "nan as position of the drawer": ("events", put(0, "containers", 0, "position", float("nan")), "position"),
    "an unknown container": ("events", put(0, "containers", 0, "name", "wardrobe"), "name"),
    "no container in one event": ("events", put(0, "containers", []), "other containers"),
    "an infinite goal": ("targets", put(0, "goal_x", float("inf")), "goal_x"),
    "an escape in a kind": ("targets", put(0, "kind", "\x1b[2J"), "kind"),
    "a negative force": ("runs", put(0, "force", -1.0), "force"),
    "nan as final pose": ("final_objects", put(0, "qw", float("nan")), "qw"),
}


@pytest.mark.parametrize("what", OUT_OF_RANGE)
def test_values_out_of_range_are_refused_though_the_digest_fits(path, what):
    column, change, sentence = OUT_OF_RANGE[what]
    frame = pl.read_parquet(path)
    rewrite(path, changed(frame, column, change))
    with pytest.raises(PerdureError, match=rf"logs\.parquet.*{sentence}"):
        read_logs(path)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        *[("control_hz", value) for value in (float("inf"), float("nan"), -1.0, None)],
        *[("index", value) for value in (-1, None)],
        *[("split", value) for value in ("", "x" * 60, "a\nb", None)],
        *[("place", value) for value in ("", "\x1b[31m", "\u202e", None)],
        ("train_seed", -2),
        ("steps", 10**12),
        ("task", "clean_up"),
        ("targets", None),
    ],
)
def test_columns_out_of_range_are_refused_though_the_digest_fits(path, column, value):
    rows = pl.read_parquet(path).to_dicts()
    rows[0][column] = value
    rewrite(path, pl.DataFrame(rows, schema=columns()))
    with pytest.raises(PerdureError, match=rf"logs\.parquet.*{column}"):
        read_logs(path)


@pytest.mark.parametrize("note", ["[" * 100_000, "null", "[]", '{"pick": 1}', "{"])
def test_a_note_that_is_no_table_of_names_is_refused(note):
    with pytest.raises(PerdureError, match="note policies"):
        files.read_note({"policies": note}, "policies", files.POLICIES)


CONTRADICTIONS = {
    "ragged track": ("releases", shorter, "different lengths"),
    "endings": ("runs", unknown_ending, "ending"),
}


@pytest.mark.parametrize("what", CONTRADICTIONS)
def test_a_whole_file_that_contradicts_itself_is_refused(path, what):
    column, change, sentence = CONTRADICTIONS[what]
    frame = pl.read_parquet(path)
    rewrite(path, changed(frame, column, lambda value: None))
    read_logs(path)  # unchanged and written anew it is read
    rewrite(path, changed(frame, column, change))
    with pytest.raises(PerdureError, match=rf"logs\.parquet.*{sentence}"):
        read_logs(path)


def test_files_of_another_schema_version_or_shape_are_refused(path):
    frame = pl.read_parquet(path)
    for notes, table, sentence in (
        ({"schema": "perdure.extrapolation"}, frame, "not one of the schema"),
        ({"version": "2"}, frame, "reads version 6"),
        ({}, frame.drop("runs"), "runs"),
        ({}, frame.with_columns(pl.lit(1).alias("extra")), "extra"),
        ({}, pl.concat([frame, frame]), "twice"),
        ({}, frame.clear(), "at least one"),
    ):
        rewrite(path, table, **notes)
        with pytest.raises(PerdureError, match=rf"logs\.parquet.*{sentence}"):
            read_logs(path)


def without_touches(path):
    """The file as it was before there were disturbances and touches."""
    release = pl.element().struct
    kept = [release.field(name) for name in columns(Release) if name not in ("touches", "pushed")]
    frame = pl.read_parquet(path).drop("disturbance")
    return frame.with_columns(releases=pl.col("releases").list.eval(pl.struct(*kept)))


@pytest.mark.parametrize(("named", "world"), [(True, ""), (False, "snapped grasp, base 3 m per s")])
def test_a_file_of_version_5_is_of_the_earlier_physics_unless_its_note_names_another(path, logs, named, world):
    noted = asdict(EvaluationProtocol("prepare_groceries", "ik"))
    if not named:
        del noted["options"]["scene"]["grasp"], noted["options"]["scene"]["base_speed"]
    rewrite(path, without_touches(path), version="5", protocol=json.dumps(noted))
    read = read_logs(path)
    assert {log.world for log in read} == {world}
    assert {log.disturbance for log in read} == {"none"}
    assert [len(log.releases) for log in read] == [len(log.releases) for log in logs]
    assert {release.touches for log in read for release in log.releases} == {-1}


def as_version_4(path, name, **notes):
    """The file as it was when one text told what was run, and an event had a field for each of two containers."""
    frame = without_touches(path).with_columns(place=pl.lit(name)).drop("world", "planner", "fallback")
    events = frame["events"].to_list()
    for event in (each for row in events for each in row):
        event |= {each["name"]: each["position"] for each in event.pop("containers")}
    frame = frame.with_columns(pl.Series("events", events)).rename({"place": "strategy"})
    rewrite(path, frame, version="4", **notes)


def test_a_file_of_version_4_tells_what_was_run_in_its_note(path, logs):
    """The text is not read back: the options that made the file are in it."""
    scene = SceneOptions(rolling=0.0, apple="hull")
    options = ExecutorOptions(scene=scene, planner="closed")
    protocol = EvaluationProtocol("prepare_groceries", "ik", options=options)
    as_version_4(path, "ik drag hull-apple closed", protocol=json.dumps(asdict(protocol)))
    read = read_logs(path)
    assert {log.strategy for log in read} == {protocol.strategy}
    assert protocol.strategy == Strategy("ik", "drag only, apple a convex hull", "closed", "oracle")
    unknown = {log: [replace(each, touches=-1, pushed=float("nan")) for each in log.releases] for log in logs}
    same = [replace(log, **asdict(protocol.strategy), releases=tuple(unknown[log])) for log in logs]
    assert_frame_equal(to_frame(read), to_frame(same), check_exact=True)


def test_a_file_of_version_4_of_another_simulator_keeps_its_name(path):
    as_version_4(path, "TP+SRL")
    assert {log.strategy for log in read_logs(path)} == {Strategy("TP+SRL")}


@pytest.mark.parametrize("field", ["step", "held", "in_goal", "drawer"])
def test_a_file_of_version_4_with_an_event_that_lacks_a_value_is_refused(path, field):
    as_version_4(path, "ik")
    frame = changed(pl.read_parquet(path), "events", put(0, field, None))
    rewrite(path, frame, version="4")
    with pytest.raises(PerdureError, match=r"logs\.parquet.*null"):
        read_logs(path)


def test_a_file_of_version_4_with_a_damaged_note_is_refused(path):
    as_version_4(path, "ik", protocol="{}")
    with pytest.raises(PerdureError, match=r"logs\.parquet.*place"):
        read_logs(path)


def test_every_column_is_described():
    described = describe_columns()
    names = [name for each, _, _ in described for name in each.split(", ")]
    assert [name for name in names if "." not in name] == list(columns())
    assert {"runs.force", "releases.track.gripper_z", "targets.goal_x", "final_objects.qw"} <= set(names)
    assert (
        "runs.reach",
        "m",
        "smallest distance of the gripper point from the target's middle; nan: unknown",
    ) in described
    assert all(about for _, _, about in described)


def test_a_write_that_is_refused_leaves_the_old_file(path, logs):
    before = path.read_bytes()
    for wrong, run in (([], NOTES), ([logs[0], logs[0]], NOTES), (logs, {**NOTES, "sha256": "1"})):
        with pytest.raises(PerdureError):
            write_logs(path, wrong, run)
    assert path.read_bytes() == before


def test_records_that_do_not_fit_together_cannot_be_made():
    record = good()
    for change in (
        {"events": record.events[1:]},
        {"events": record.events[:1] * 2},
        {"length": record.steps},
        {"targets": record.targets[:2]},
        {"steps": 0},
        {"control_hz": 0.0},
        {"runs": (replace(record.runs[0], end=10**6),)},
        {"targets": (replace(record.targets[0], container="bag"), *record.targets[1:])},
    ):
        with pytest.raises(PerdureError, match="story, training seed 100"):
            replace(record, **change)


def test_another_simulators_records_are_written_and_read(tmp_path):
    """At 20 Hz: nothing in the analysis takes the control rate for granted."""
    record = replace(good(), control_hz=20.0, place="elsewhere")
    (found,) = read_logs(write_logs(tmp_path / "a.parquet", [record], {"simulator": "elsewhere"}))
    assert analyze([found]).episodes["settle_seconds"].to_list() == [7.5]
