"""For each reader: valid files, how they are changed, and what a consumer does with whatever is still read."""

import hashlib
import io
import json
import math
import struct
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import altered
import mutations
import numpy as np
import payloads
import polars as pl
from home_stories import Story, good
from make_policy import random_policy
from safetensors.numpy import load, save

from perdure.cli import texts
from perdure.extrapolate.idle import Idle
from perdure.extrapolate.lanes import LaneSpec
from perdure.extrapolate.score import make_score_scale
from perdure.extrapolate.table import _lane_row
from perdure.home import HomeError
from perdure.home.benchmark.episodes import EpisodeSet, load_episodes, read_episodes, write_episodes
from perdure.home.benchmark.episodes.episode import episode_hash
from perdure.home.benchmark.plan import plan_problem
from perdure.home.evaluate.outcomes import analyze, files, find_overlaps, read_logs, write_logs
from perdure.home.evaluate.outcomes.schema import columns
from perdure.horizon import HorizonError, HorizonProtocol, clock_from_json
from perdure.policy import Policy, PolicyError, load_policy, save_policy
from perdure.policy.files import _digest as policy_digest
from perdure.policy.reference import Reference
from perdure.ppo.checkpoint import load_checkpoint, save_checkpoint
from perdure.ppo.errors import CheckpointError
from perdure.ppo.state import SeedState
from perdure.report import ReportError, read_table, schema, summary_text, write_table
from perdure.runs import Store, StoreError
from perdure.runs.unit import read_progress

FOLDER = Path(tempfile.mkdtemp(prefix="perdure-fuzz-"))
OWN = (PolicyError, HorizonError, ReportError, HomeError, StoreError, CheckpointError)


def _read(name, content, reader):
    """What a reader makes of content; None where it refuses it with an error of ours."""
    path = FOLDER / name
    path.write_bytes(content)
    with suppress(OWN):
        return reader(path)
    return None


# Policies


@cache
def policy_files():
    rng = np.random.default_rng(0)
    reference = Reference(
        40,
        rng.normal(size=(3, 4)),
        np.array([40, 12, 7]),
        np.array([False, True, True]),
        np.full(11, -1.0),
        np.ones(11),
    )
    made = []
    for embedding, activation, film, measured in (
        ("geometric", "tanh", False, reference),
        ("linear", "relu", False, None),
        (None, "tanh", False, None),
        ("geometric", "relu", True, None),
    ):
        policy = random_policy(embedding=embedding, activation=activation, film=film, hidden=(4,), reference=measured)
        made.append(save_policy(policy, FOLDER / f"{embedding}-{film}.safetensors").read_bytes())
    return made


def policy_bytes(rng):
    use_policy(mutations.bytes_of(rng, rng.choice(policy_files())))


def policy_parts(rng):
    whole = rng.choice(policy_files())
    (size,) = struct.unpack("<Q", whole[:8])
    description = json.loads(json.loads(whole[8 : 8 + size])["__metadata__"]["perdure.policy"])
    arrays = dict(load(whole))
    if rng.random() < 0.5:
        description = mutations.json_value(rng, description)
    else:
        name = rng.choice(sorted(arrays))
        kind = rng.randrange(5)
        arrays[name] = mutations.array(rng, arrays[name])
        if kind == 0:
            del arrays[name]
        elif kind == 1:
            arrays[rng.choice((f"{name}x", "value.9.weight", "normalizer.mean", "policy.0.weight"))] = arrays.pop(name)
    text = json.dumps(description)
    use_policy(save(arrays, {"perdure.policy": text, "sha256": policy_digest(text, arrays)}))


def use_policy(content):
    policy = _read("policy.safetensors", content, load_policy)
    if policy is None:
        return
    rows = np.array([[0.0], [1e300], [-1e300]]) * np.ones(policy.task.observation_size)
    for elapsed in (0.0, 1e9):
        actions = policy.act(rows, np.full(3, elapsed))
        assert np.isfinite(actions).all()
        assert (actions >= policy.task.action_low).all()
        assert (actions <= policy.task.action_high).all()
    assert "\x1b" not in texts.policy(policy)
    row = _lane_row("label", policy, LaneSpec(0, policy.clock, 0))
    pl.DataFrame({name: [value] for name, value in row.items()}, schema={name: schema.COLUMNS[name] for name in row})
    if policy.reference is not None:
        make_score_scale(policy.reference, Idle(0.0, 0.1), math.nan)
    save_policy(policy, FOLDER / "again.safetensors")


def sb3_model(rng):
    """A model of Stable-Baselines3 changed in its archive, in the archive of its weights, or in one member."""
    name, kind = rng.choice(("ppo", "sac-sde", "td3")), rng.randrange(4)
    if kind == 0:
        content = mutations.bytes_of(rng, altered.model(name))
    elif kind == 1:
        content = altered.rebuilt(altered.model(name), {"policy.pth": lambda old: mutations.bytes_of(rng, old)})
    elif kind == 2:
        content = altered.with_state({"data.pkl": lambda old: mutations.bytes_of(rng, old)}, name)
    else:
        content = altered.rebuilt(
            altered.model(name), {"data": lambda old: json.dumps(mutations.json_value(rng, json.loads(old)))}
        )
    use_sb3(content, altered.FIXTURES / "ppo.pkl")


def vecnormalize(rng):
    path = FOLDER / "statistics.pkl"
    path.write_bytes(mutations.bytes_of(rng, (altered.FIXTURES / "ppo.pkl").read_bytes()))
    use_sb3(altered.model("ppo"), path)


def use_sb3(content, normalizer):
    read = _read(
        "model.zip", content, lambda path: Policy.from_sb3(path, "Pendulum-v1", normalizer=normalizer, measure=False)
    )
    if read is not None:
        path = FOLDER / "imported.safetensors"
        with suppress(PolicyError):  # numbers that no policy file may hold
            save_policy(read, path)
            use_policy(path.read_bytes())


def horizon_json(rng):
    protocol = random_policy().protocol.to_json()
    with suppress(OWN):
        read = HorizonProtocol.from_json(mutations.json_value(rng, protocol))
        assert np.isfinite(read.embed(np.arange(3.0), np.array([0.0, 5.0, np.inf]))).all()
    with suppress(OWN):
        clock = clock_from_json(mutations.json_value(rng, {"name": rng.choice(("constant", "periodic")), "steps": 5.0}))
        assert not np.isnan(clock.time(np.arange(3.0))).any()
        assert clock_from_json(clock.to_json()) == clock


# Tables


@cache
def table_file():
    frame = payloads._builder()([{"hazard": 1e-2}, {"clock": "none", "method": "ppo"}], lanes=2, recorded=(100, 1000))
    content = write_table(FOLDER / "table.parquet", frame, {"command": "perdure extrapolate"}).read_bytes()
    old = frame.rename({"movement_first": "first_tenth", "movement_last": "last_tenth", "window": "stuck_steps"})
    old = old.select(pl.col(name).cast(kind) for name, kind in schema._COLUMNS_1.items())
    notes = {"schema": schema.SCHEMA_NAME, "version": "1", "command": "x"}
    buffer = io.BytesIO()
    old.write_parquet(buffer, metadata={**notes, "sha256": schema._digest(old.get_column, notes, schema._COLUMNS_1)})
    return frame, content, buffer.getvalue()


def table_bytes(rng):
    _, content, old = table_file()
    use_table(mutations.bytes_of(rng, content if rng.random() < 0.7 else old))


def table_resealed(rng):
    """Bytes of the file changed by somebody who knows how it is sealed."""
    content = bytearray(table_file()[1])
    foot = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(foot if rng.random() < 0.7 else 4, len(content) - 8)
        content[at] = rng.choice((0, 255, 127, 128, content[at] ^ (1 << rng.randrange(8))))
    with suppress(OverflowError):
        content = schema._sealed(bytes(content))
    use_table(bytes(content))


def table_cells(rng):
    frame = table_file()[0]
    for _ in range(rng.choice((1, 1, 2, 3))):
        frame = _other_frame(rng, frame)
    notes = {"schema": schema.SCHEMA_NAME, "version": rng.choice(("2", "2", "2", "2", "1", "3")), "command": "x"}
    buffer = io.BytesIO()
    digest = ""
    with suppress(pl.exceptions.PolarsError):
        digest = schema._digest(frame.get_column, notes)
    frame.write_parquet(buffer, metadata={**notes, "sha256": digest, "seal": schema._UNSEALED.decode()})
    use_table(schema._sealed(buffer.getvalue()))


def _other_frame(rng, frame):
    name, kind = rng.choice(frame.columns), rng.randrange(12)
    if frame.is_empty():
        return frame
    if kind == 0:
        return frame.drop(name) if len(frame.columns) > 1 else frame
    if kind == 1:
        return frame.with_columns(pl.lit(1).alias(f"{name}x"))
    if kind == 2:
        return frame.vstack(frame.sample(1, seed=rng.randrange(9)))
    if kind == 3:
        return frame.sample(rng.randrange(len(frame) + 1), seed=rng.randrange(9))
    if kind == 4:
        return frame.with_columns(pl.col(name).cast(rng.choice((pl.String, pl.Int32, pl.Float32)), strict=False))
    odd = [each for each in mutations.ODD if isinstance(each, int | float | str | None) and each != "\ud800"]
    values = frame[name].to_list()
    for row in rng.sample(range(len(values)), min(len(values), rng.choice((1, 1, 2, 8)))):
        values[row] = rng.choice(odd)
    with suppress(TypeError, OverflowError, pl.exceptions.PolarsError):
        return frame.with_columns(pl.Series(name, values, dtype=frame.schema[name], strict=False))
    return frame


def use_table(content):
    read = _read("table.parquet", content, read_table)
    if read is not None:
        assert summary_text(read[0])


# Logs


@cache
def log_file():
    logs = [good(0), Story(index=1).go(0).go(1, beside=0.5).go(2).log()]
    content = write_logs(FOLDER / "logs.parquet", logs, {"arm": "rl", "train_seed": "0", "policies": "{}"}).read_bytes()
    return pl.read_parquet(io.BytesIO(content)).to_dicts(), content


def logs_bytes(rng):
    use_logs(mutations.bytes_of(rng, log_file()[1]))


def logs_rows(rng):
    # Polars does not return from rows whose structs hold a deep list; files are not made of Python objects.
    rows = mutations.json_value(rng, log_file()[0][: rng.choice((1, 1, 2))], depths=(2, 5))
    notes = {"schema": files.SCHEMA_NAME, "version": rng.choice(("2", "2", "2", "1")), "arm": "rl"}
    notes |= {"policies": json.dumps(mutations.json_value(rng, {"pick": "oracle"}))}
    try:
        frame = pl.DataFrame(rows, schema=columns(notes["version"]))
        digest = files._digest(frame, notes)
        buffer = io.BytesIO()
        frame.write_parquet(buffer, metadata={**notes, "sha256": digest})
    except (pl.exceptions.PolarsError, TypeError, ValueError, OverflowError, AttributeError):
        return  # no table can hold these rows
    use_logs(buffer.getvalue())


def use_logs(content):
    records = _read("logs.parquet", content, read_logs)
    if records is None:
        return
    assert analyze(records).summary()
    with suppress(HomeError):  # objects whose shape is not known
        list(find_overlaps(records))
    with suppress(HomeError):
        files.noted_policies(files.read_notes(FOLDER / "logs.parquet"))


# Episodes


@cache
def episode_file():
    published = load_episodes("set_table", "val")
    write_episodes(FOLDER / "episodes.json", EpisodeSet("set_table", "val", {"seed": "0"}, published.episodes[:1]))
    content = (FOLDER / "episodes.json").read_bytes()
    return json.loads(content), content


def episode_bytes(rng):
    use_episodes(mutations.bytes_of(rng, episode_file()[1]))


def episode_values(rng):
    content = mutations.json_value(rng, episode_file()[0])
    content.pop("sha256", None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    use_episodes(json.dumps(content | {"sha256": hashlib.sha256(text.encode()).hexdigest()}).encode())


def use_episodes(content):
    episodes = _read("episodes.json", content, read_episodes)
    if episodes is None:
        return
    for episode in episodes.episodes:
        assert episode_hash(episode)
        assert np.isfinite(episode.goal_positions).all()
        with suppress(HomeError):  # other furniture, doors that stand ajar
            plan_problem(episode)
            episode.container(0)


# Records of units


@cache
def unit_record():
    with Store(FOLDER / "store").workspace("a/b", {"x": [1, 2.5, None], "deep": {"y": "z"}}):
        pass
    return (FOLDER / "store/a/b/unit.json").read_bytes()


def records(rng):
    whole = unit_record()
    if rng.random() < 0.5:
        content = mutations.bytes_of(rng, whole)
    else:
        record = mutations.json_value(rng, json.loads(whole))
        with suppress(ValueError, TypeError, KeyError):
            text = json.dumps(record["config"], sort_keys=True, separators=(",", ":"))
            record["sha256"] = hashlib.sha256(text.encode()).hexdigest()
        content = json.dumps(record).encode()
    store = Store(FOLDER / "store")
    (FOLDER / "store/a/b/unit.json").write_bytes(content)
    with suppress(StoreError):
        assert isinstance(store.config("a/b"), dict)
    with suppress(StoreError):
        store.warn_of_other_source(["a/b"])
    path = store.note_path("progress", "a/b")
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(mutations.bytes_of(rng, b'{"done": 1.0, "total": 4.0, "facts": {"mean_return": 2.0}}'))
    done, total, facts = read_progress(store, "a/b")
    assert done >= 0
    assert total >= 0
    assert isinstance(facts, dict)


# Checkpoints


@cache
def checkpoint_file():
    rng = np.random.default_rng(0)
    params = {"policy.0.weight": rng.normal(size=(3, 2)).astype(np.float32), "log_std": np.zeros(2, np.float32)}
    state = SeedState(
        **{"seed": 0, "segment": 2, "params": params, "adam": {"count": np.zeros((), np.int32), "mean": params}},
        **{"statistics": {"mean": np.zeros(3)}, "estimator": (), "episodes": np.zeros((5, 3))},
        iterations=np.zeros((2, 7)),
    )
    save_checkpoint(state, FOLDER / "checkpoint.safetensors")
    return state, (FOLDER / "checkpoint.safetensors").read_bytes()


def checkpoints(rng):
    start, content = checkpoint_file()
    if rng.random() < 0.5:
        content = mutations.bytes_of(rng, content)
    else:
        arrays, name = dict(load(content)), rng.choice(sorted(load(content)))
        arrays[name] = mutations.array(rng, arrays[name])
        header = mutations.json_value(rng, {"version": "2", "seed": 0, "segment": 2})
        content = save(arrays, {"perdure.checkpoint": json.dumps(rng.choice((header, {"version": "2"} | header)))})
    state = _read("checkpoint.safetensors", content, lambda path: load_checkpoint(path, start))
    if state is not None:
        assert state.params["policy.0.weight"].shape == (3, 2)
        assert state.episodes.shape[1:] == (3,)
        save_checkpoint(state, FOLDER / "again.safetensors")


SHARES = {
    policy_bytes: 0.17,
    policy_parts: 0.13,
    sb3_model: 0.02,
    vecnormalize: 0.02,
    horizon_json: 0.1,
    table_bytes: 0.08,
    table_resealed: 0.04,
    table_cells: 0.08,
    logs_bytes: 0.08,
    logs_rows: 0.03,
    episode_bytes: 0.07,
    episode_values: 0.07,
    records: 0.06,
    checkpoints: 0.05,
}
"""Each target's share of all cases."""
