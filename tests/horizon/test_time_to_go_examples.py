"""The two example scripts run as their first lines say."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(script, *arguments):
    command = [sys.executable, EXAMPLES / script, "--task", "Pendulum-v1", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def cleanrl():
    spec = importlib.util.spec_from_file_location("cleanrl_time_to_go", EXAMPLES / "cleanrl_time_to_go.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_cleanrl_example_counts_every_step_as_a_transition_or_a_reset():
    # A pendulum never falls, so each of 4 x 300 steps an iteration is a transition unless a horizon ended just before.
    short = ("--iterations", "5", "--num-steps", "300", "--test-steps", "400")
    *lines, deployed = run("cleanrl_time_to_go.py", *short).splitlines()
    assert deployed.startswith("deployed for 400 of 400 steps: return -")  # no horizon ends it
    counts = [
        [int(number) for number in re.findall(r": (\d+) transitions, (\d+) term\w+, (\d+) ", line)[0]] for line in lines
    ]
    transitions, terminated, truncated = np.sum(counts, axis=0)
    assert len(lines) == 5
    assert truncated == 0
    assert 4 <= terminated <= 28  # horizons of 200 to 1000 in 4 x 1500 steps
    assert transitions in range(
        6000 - terminated, 6000 - terminated + 5
    )  # ends on the very last step have no reset yet


@pytest.mark.parametrize(("end", "advantage"), [("terminated", 3.0), ("truncated", 13.0), (None, 23.5)])
def test_the_cleanrl_example_bootstraps_where_the_world_goes_on_and_only_there(end, advantage):
    # gamma = lambda = 1, every value before a step 0. Rewards 2, 1, 1; values after the steps 0, 10, 9.5. By hand:
    # an end on step 2 gives 2 + 1, with a bootstrap 2 + 1 + 10; without an end step 3 adds 1 + 9.5.
    module = cleanrl()
    ended = np.array([False, True, False])[:, None]
    rollout = module.Rollout(
        values=np.zeros((3, 1)),
        next_values=np.array([[0.0], [10.0], [9.5]]),
        rewards=np.array([[2.0], [1.0], [1.0]]),
        terminated=ended & (end == "terminated"),
        truncated=ended & (end == "truncated"),
        is_reset=np.array([False, False, end is not None])[:, None],
    )
    assert module.advantages(rollout, gamma=1.0, gae_lambda=1.0)[:, 0].tolist()[0] == advantage


def test_the_sb3_example_trains_and_deploys():
    pytest.importorskip("stable_baselines3")
    lines = run("sb3_time_to_go.py", "--train-steps", "2048", "--deploy-steps", "50").splitlines()
    assert [line.split(":")[0] for line in lines[-3:]] == ["constant(100)", "constant(500)", "constant(1000)"]
    assert all("over 50 of 50 steps" in line for line in lines[-3:])
