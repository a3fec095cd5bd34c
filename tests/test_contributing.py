"""The classes and rows of CONTRIBUTING.md work as written, in the place where it says to add them."""

import gc
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from perdure.disturbances import Effect
from perdure.home.agents.release import ReleaseStrategy, Stop, make_strategy
from perdure.home.evaluate.comparison import describe
from perdure.home.evaluate.policies import read_release
from perdure.home.evaluate.strategy import Strategy
from perdure.horizon import Clock, Constant, Linear, parse_clock
from perdure.learn import presets
from tests.envs.test_disturbances import echoed

TEXT = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()


@pytest.fixture(autouse=True)
def forget():
    """Clocks, embeddings and disturbances are registered as long as they exist."""
    yield
    gc.collect()


def added(heading, *beside):
    """What the block under a heading defines, run among the names of the files of some existing classes."""
    block = re.search(rf"## {heading}\n.*?```python\n(.*?)```", TEXT, re.DOTALL)[1]
    before = {}
    for kind in beside:
        before |= vars(sys.modules[kind.__module__])
    before["__name__"] = __name__
    after = dict(before)
    exec(compile(block, heading, "exec"), after)
    (new,) = after.keys() - before.keys()
    return after[new]


def test_the_clock():
    kind = added("A clock", Constant, Clock)
    elapsed, horizon = kind(500).time(np.array([0, 100, 249, 250, 600]))
    assert (horizon - elapsed).tolist() == [500, 400, 251, 500, 400]
    assert parse_clock("hourglass:500") == kind(500)
    assert kind(0).time(np.arange(3.0))[0].tolist() == [0, 0, 0]


def test_the_embedding():
    phi = added("An embedding", Linear)()(np.array([0.0, 9.0, 5.0]), np.array([9.0, 9.0, np.inf]))
    assert phi.tolist() == [[0.1], [1.0], [0.0]]


def test_the_disturbance():
    added("A disturbance", Effect)
    assert echoed("action_bias:0.1", steps=2)[:, 0].tolist() == [[0.1, 2.2]] * 2  # half ranges 1 and 2


def test_the_method(monkeypatch):
    embedding = added("An embedding", Linear)
    row = re.search(r"## A training method\n.*?```python\n(.*?)```", TEXT, re.DOTALL)[1]
    (added_row,) = eval(f"{{{row}}}", {**vars(presets), "Reciprocal": embedding}).items()
    monkeypatch.setitem(presets.METHODS, *added_row)
    assert presets.method_config("reciprocal", "Hopper-v3", 11).protocol.embedding == embedding()


def test_the_release_strategy():
    """It holds base and arm for one second: thirty actions without any arm motion. Its name is known at once."""
    strategy = added("A release strategy", Stop)()
    assert read_release("wait").strategy == "wait"
    assert make_strategy("wait", SimpleNamespace()).strategy == strategy
    assert describe(Strategy("wait")) == "wait a second"
    assert isinstance(strategy, ReleaseStrategy)
    actions = list(strategy.motion(SimpleNamespace(base_error=(0.0, 0.0), base_speed=1.0)))
    assert len(actions) == 30
    assert not np.any(actions)


@pytest.mark.parametrize("target", sorted(set(re.findall(r"`(tests/\w+\.py|tools/\w+\.py|src/[\w/]+)`", TEXT))))
def test_a_file_that_it_names_exists(target):
    assert (Path(__file__).parents[1] / target).exists()
