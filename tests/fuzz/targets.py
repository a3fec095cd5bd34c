"""For each reader: valid files, how they are changed, and what a consumer does with whatever is still read."""

import hashlib
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
import polars as pl
from make_policy import random_policy
from safetensors.numpy import load, save

from perdure.cli.commands import policy_text
from perdure.errors import PerdureError
from perdure.evaluate.episodes import EpisodeSpec
from perdure.evaluate.reference import Idle
from perdure.evaluate.table import _episode_row
from perdure.evaluate.verdict import make_score_scale
from perdure.home.tasks.episodes import EpisodeSet, episode_hash, load_episodes, read_episodes, write_episodes
from perdure.home.tasks.planning import plan_problem
from perdure.horizon import Clock, HorizonProtocol
from perdure.learn.checkpoint import RunState, load_checkpoint, save_checkpoint
from perdure.policy import Policy, load_policy, save_policy
from perdure.policy.files import _digest as policy_digest
from perdure.policy.reference import Reference
from perdure.report import COLUMNS
from perdure.runs import Store
from perdure.runs.store import read_progress

FOLDER = Path(tempfile.mkdtemp(prefix="perdure-fuzz-"))


def _read(name, content, reader):
    """What a reader makes of content; None where it refuses it with an error of ours."""
    path = FOLDER / name
    path.write_bytes(content)
    with suppress(PerdureError):
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
    assert "\x1b" not in policy_text(policy)
    row = _episode_row("label", policy, EpisodeSpec(0, policy.clock, 0))
    pl.DataFrame({name: [value] for name, value in row.items()}, schema={name: COLUMNS[name] for name in row})
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


def cleanrl_model(rng):
    """A model of CleanRL changed in its archive, or in the description of its tensors."""
    whole = (altered.FIXTURES / "cleanrl.cleanrl_model").read_bytes()
    inner = {"cleanrl/data.pkl": lambda old: mutations.bytes_of(rng, old)}
    content = mutations.bytes_of(rng, whole) if rng.random() < 0.3 else altered.rebuilt(whole, inner)
    _read(
        "model.cleanrl_model",
        content,
        lambda path: Policy.from_cleanrl(path, "Pendulum-v1", normalizer="none", measure=False),
    )


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
        with suppress(PerdureError):  # numbers that no policy file may hold
            save_policy(read, path)
            use_policy(path.read_bytes())


def horizon_json(rng):
    protocol = random_policy().protocol.to_json()
    with suppress(PerdureError):
        read = HorizonProtocol.from_json(mutations.json_value(rng, protocol))
        assert np.isfinite(read.embed(np.arange(3.0), np.array([0.0, 5.0, np.inf]))).all()
    with suppress(PerdureError):
        clock = Clock.from_json(mutations.json_value(rng, {"name": rng.choice(("constant", "periodic")), "steps": 5.0}))
        assert not np.isnan(clock.time(np.arange(3.0))).any()
        assert Clock.from_json(clock.to_json()) == clock


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
        with suppress(PerdureError):  # other furniture, doors that stand ajar
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
    with suppress(PerdureError):
        assert isinstance(store.config("a/b"), dict)
    with suppress(PerdureError):
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
    learner = {"params": params, "adam": {"count": np.zeros((), np.int32), "mean": params}}
    state = RunState(0, 2, learner, np.zeros((5, 3)), np.zeros((2, 7)))
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
        assert state.learner["params"]["policy.0.weight"].shape == (3, 2)
        assert state.episodes.shape[1:] == (3,)
        save_checkpoint(state, FOLDER / "again.safetensors")


TARGETS = (
    *(policy_bytes, policy_parts, sb3_model, vecnormalize, cleanrl_model, horizon_json),
    *(episode_bytes, episode_values, records, checkpoints),
)
