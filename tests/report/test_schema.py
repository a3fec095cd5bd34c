"""The table: what was written is read back, and nothing else is taken for it."""

import math
import random
import re

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perdure.errors import PerdureError
from perdure.report import COLUMNS, read_table, schema, write_table
from perdure.report.outcomes import outcome_words
from perdure.schema import LARGEST, UNSEEN


@pytest.fixture(scope="module")
def frame(synthetic):
    return synthetic([{"hazard": 1e-4}, {"clock": "none", "method": "ppo", "train_horizon": math.inf}], episodes=3)


def test_a_table_is_read_back_as_written_with_its_metadata(tmp_path, frame):
    path = write_table(tmp_path / "deep" / "table.parquet", frame, {"command": 'perdure extrapolate "a b" --c 5'})
    back, metadata = read_table(path)
    assert back.equals(frame, null_equal=True)
    assert back.schema == dict(COLUMNS)
    assert metadata == {"command": 'perdure extrapolate "a b" --c 5'}
    notes = pl.read_parquet_metadata(path)
    assert (notes["schema"], notes["version"]) == ("perdure.extrapolation", "5")


def test_the_same_table_gives_the_same_bytes(tmp_path, frame):
    first = write_table(tmp_path / "a", frame, {}).read_bytes()
    assert write_table(tmp_path / "b", frame.select(reversed(frame.columns)), {}).read_bytes() == first


def test_infinite_and_unknown_numbers_survive_the_file(tmp_path, frame):
    odd = frame.with_columns(pl.lit(math.nan).alias("end_score_vs_training"), pl.lit(math.inf).alias("train_horizon"))
    back, _ = read_table(write_table(tmp_path / "t", odd, {}))
    assert back["end_score_vs_training"].is_nan().all()
    assert (back["train_horizon"] == math.inf).all()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda f: f.drop("alive"), r"missing columns \['alive'\]"),
        (lambda f: f.with_columns(extra=1), r"unknown columns \['extra'\]"),
        (lambda f: f.with_columns(pl.col("step").cast(pl.Int32)), "'step' is Int32, not Int64"),
        (lambda f: f.clear(), "has no rows"),
        (lambda f: f.with_columns(pl.lit(None, pl.String).alias("task")), "missing values in column 'task'"),
        (lambda f: f.with_columns(pl.lit("tired").alias("end_reason")), "end_reason must be one of .*not 'tired'"),
        (lambda f: f.with_columns(pl.lit("fine").alias("outcome")), "outcome must be one of .*not 'fine'"),
        (lambda f: f.with_columns(pl.lit("good").alias("policy_state")), "policy_state must be one of .*not 'good'"),
        (lambda f: f.with_columns(pl.lit(0).cast(pl.Int64).alias("step")), "step must be a whole number .*not 0"),
        (lambda f: f.with_columns((pl.col("step") * 2).alias("step")), "recorded step lies beyond"),
        (lambda f: f.with_columns(pl.lit(math.nan).alias("return")), "return must be a number"),
        (lambda f: f.with_columns(pl.lit(-math.inf).alias("return")), "return must be a number"),
        (lambda f: f.with_columns(pl.lit(0).cast(pl.Int64).alias("end_step")), "end_step must be .*not 0"),
        (lambda f: f.with_columns(end_step=pl.col("test_horizon") + 1), "end_step lies beyond"),
        (lambda f: f.with_columns(alive=pl.lit(True), end_step=pl.lit(500, pl.Int64)), "alive after its end_step"),
        (lambda f: f.with_columns(alive=pl.lit(False), end_step=pl.col("test_horizon")), "ended before its end_step"),
        (lambda f: f.with_columns(pl.lit(-1.0).alias("movement_first")), "movement_first must be"),
        (lambda f: f.with_columns(pl.lit(math.inf).alias("idle_rate")), "idle_rate must be"),
        (lambda f: f.with_columns(pl.lit(0.0).alias("train_horizon")), "train_horizon must be"),
        (lambda f: f.with_columns(pl.lit("x\x1b[2J").alias("policy")), "policy must be text"),
        (lambda f: f.with_columns(pl.lit("x" * 501).alias("task")), "task must be text"),
        (lambda f: f.with_columns(pl.lit(-1).cast(pl.Int64).alias("window")), "window must be"),
        (lambda f: f.with_columns(pl.lit(1e308).alias("train_horizon")), "train_horizon must be at most"),
        (lambda f: f.with_columns(method=pl.col("step").cast(pl.String)), "more than one method"),
        (lambda f: pl.concat([f, f.head(1)]), "twice at step 100"),
        (lambda f: f.slice(1), "do not share their recorded steps"),
        (lambda f: f.with_columns(pl.col("test_horizon") + pl.col("eval_seed")), "do not share"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_with_its_fault(tmp_path, frame, change, named):
    with pytest.raises(PerdureError, match=named):
        write_table(tmp_path / "t", change(frame), {})
    assert not (tmp_path / "t").exists()
    schema.table_episodes(frame, "the unchanged frame")


@pytest.mark.parametrize("metadata", [{"schema": "mine"}, {"sha256": "0"}, {"command": 3}])
def test_metadata_that_would_clash_is_refused(tmp_path, frame, metadata):
    with pytest.raises(PerdureError, match=next(iter(metadata))):
        write_table(tmp_path / "t", frame, metadata)


def test_files_that_are_no_table_are_refused_in_one_sentence(tmp_path, frame):
    (tmp_path / "text").write_text("policy,step\n")
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "cut").write_bytes(write_table(tmp_path / "t", frame, {}).read_bytes()[:-20])
    frame.write_parquet(tmp_path / "foreign")
    frame.write_parquet(tmp_path / "old", metadata={"schema": "perdure.extrapolation", "version": "0"})
    frame.write_parquet(tmp_path / "bare", metadata={"schema": "perdure.extrapolation", "version": "5"})
    expected = {
        "absent": "does not exist",
        ".": "is not a file",
        "text": "is not a Parquet file",
        "empty": "is not a Parquet file",
        "cut": "damaged",
        "foreign": "not a table of the schema perdure.extrapolation",
        "old": "has version 0 .* reads versions 4 and 5",
        "bare": "SHA-256",
    }
    for name, sentence in expected.items():
        with pytest.raises(PerdureError, match=sentence) as refusal:
            read_table(tmp_path / name)
        assert "\n" not in str(refusal.value)
        assert str(tmp_path) in str(refusal.value)


def test_no_flipped_bit_goes_unnoticed(tmp_path, frame):
    whole = write_table(tmp_path / "t", frame, {"command": "perdure extrapolate"}).read_bytes()
    rng = random.Random(0)
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        (tmp_path / "damaged").write_bytes(damaged)
        try:
            back, metadata = read_table(tmp_path / "damaged")
        except PerdureError:
            continue
        assert back.equals(frame, null_equal=True)
        assert metadata == {"command": "perdure extrapolate"}


@settings(max_examples=20, deadline=None)
@given(
    label=st.text(min_size=1, max_size=20).filter(lambda text: not UNSEEN.search(text)),
    number=st.floats(-LARGEST, LARGEST) | st.just(math.nan),
    seed=st.integers(-(2**63), 2**63 - 1),
)
def test_any_label_and_number_survives_the_file(tmp_path_factory, frame, label, number, seed):
    odd = frame.filter((pl.col("method") == "ppo") & (pl.col("eval_seed") == 0)).with_columns(
        policy=pl.lit(label), train_seed=pl.lit(seed, pl.Int64), end_score_vs_training=pl.lit(number, pl.Float64)
    )
    path = tmp_path_factory.getbasetemp() / "any.parquet"
    back, _ = read_table(write_table(path, odd, {"command": label}))
    assert back.equals(odd, null_equal=True)


def test_an_outcome_that_is_registered_after_a_table_was_read_is_a_word_of_the_next(frame, monkeypatch):
    schema.table_episodes(frame, "the first table")
    monkeypatch.setattr(schema, "outcome_words", lambda **wanted: [*outcome_words(**wanted), "limps"])
    (found,) = schema.table_episodes(frame.with_columns(outcome=pl.lit("limps")), "the next")
    assert set(found.facts["outcome"]) == {"limps"}


def test_every_column_is_declared_once_and_documented():
    rows = dict(re.findall(r"^\| (\w+) \| (\w+ \| .+) \|$", schema.__doc__, re.MULTILINE))
    rows.pop("column")
    assert list(rows) == [*COLUMNS, *schema.MEASURES]
    assert list(COLUMNS) == list(schema.row_kind().fields)
    assert rows["outcome"].startswith('text | the verdict on the episode: "holds", "reaches its goal"')
    assert COLUMNS["ever_idle"] is pl.Boolean
