"""The snippets of CONTRIBUTING.md work as written."""

import gc
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

TEXT = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()


def snippet(heading):
    """The first Python block under a heading."""
    section = TEXT.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    return re.search(r"```python\n(.*?)```", section, re.DOTALL)[1]


@pytest.fixture
def run(monkeypatch):
    """Executes the snippet under a heading as a module of its own."""

    def execute(heading):
        module = ModuleType(f"contributed_{heading.replace(' ', '_').lower()}")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        exec(compile(snippet(heading), module.__name__, "exec"), module.__dict__)
        return module

    yield execute
    gc.collect()  # a class that is gone is no longer among the registered ones


def test_the_clock(run):
    clock = run("A clock").Hourglass(500)
    elapsed, horizon = clock.time(np.array([0, 100, 249, 250, 600]))
    assert (horizon - elapsed).tolist() == [500, 400, 251, 500, 400]


def test_the_embedding(run):
    module = run("An embedding")
    (kind,) = [each for each in vars(module).values() if isinstance(each, type) and each.__module__ == module.__name__]
    assert kind()(np.array([0.0, 9.0]), np.array([9.0, 9.0])).shape == (2, 1)


def test_the_task(run):
    env = run("A task or a task suite (world)").Corridor()
    env.reset(seed=0)
    ended = [env.step(np.array([1.0]))[2] for _ in range(15)]
    assert not ended[0]
    assert ended[-1]


def test_the_method(run):
    """Its row, beside the embedding of that section, gives a method that trains with this embedding."""
    from perdure.ppo import methods

    embedding = run("An embedding").Reciprocal
    row = eval(f"{{{snippet('A method')}}}", {**vars(methods), "Reciprocal": embedding})
    (method,) = row.values()
    assert list(row) == ["reciprocal"]
    assert method.embedding(11, "Hopper-v3") == embedding()


def test_the_figure(run):
    """Its points and intervals are the shares that the estimates hold."""
    from types import SimpleNamespace

    def estimate(label, share, lower, upper):
        interval = SimpleNamespace(
            estimate=share, lower=lower, upper=upper, label="evaluation seeds only", method="Wilson score"
        )
        return SimpleNamespace(group=SimpleNamespace(label=label, lanes=10), verdict=SimpleNamespace(share=interval))

    chosen = [estimate("ppo", 0.1, 0.02, 0.4), estimate("geometric", 1.0, 0.72, 1.0)]
    (figure,) = run("A figure of the report").holding_figures(chosen)
    text = str(figure.spec)
    assert "ppo (n = 10)" in text
    assert "geometric (n = 10)" in text
    assert all(str(value) in text for value in (0.1, 0.02, 0.4, 0.72))
    assert figure.note == "Bars: 95 % intervals (Wilson score, evaluation seeds only)."


def test_the_release_strategy(run):
    """It holds base and arm for one second: thirty actions without any arm motion."""
    from types import SimpleNamespace

    strategy = run("A release strategy").Wait(inner=SimpleNamespace(sees=False))
    held = SimpleNamespace(base_error=(0.0, 0.0))
    actions = list(strategy.motion(held))
    assert len(actions) == 30
    assert not np.any(actions)
