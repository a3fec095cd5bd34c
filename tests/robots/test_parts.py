"""Commands, observations and measures of walks, against closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from perdure.robots.contract import RandomCommands, Term
from perdure.robots.world import Observer, Schedule, Walk


def commands(contract, seconds, seed=0):
    schedule = Schedule(contract)
    schedule.begin(np.random.default_rng(seed))
    return [schedule.at(each) for each in seconds]


def test_a_script_of_commands_begins_again(ant):
    script = ((0.0, 1.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.5), (3.0, 0.0, 0.0, 0.0))
    contract = replace(ant, script=script, repeat=5.0)
    forward, turn, stand = (1.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0)
    found = commands(contract, np.arange(0.0, 10.5, 0.5))
    one = [forward] * 4 + [turn] * 2 + [stand] * 4
    assert found == [*one, *one, forward]
    assert commands(replace(contract, repeat=2.5), [0.0, 2.0, 2.5, 4.0]) == [forward, turn, forward, forward]
    assert commands(replace(contract, repeat=math.inf), [0.0, 2.5, 3.0, 100.0]) == [forward, turn, stand, stand]


def test_random_commands_are_drawn_from_the_seed(ant):
    random = RandomCommands((-1.0, 0.0, -0.5), (1.0, 0.0, 0.5), (1.0, 2.0), 0.25)
    contract, seconds = replace(ant, random=random), np.arange(0.0, 2000.0, 0.1)
    found = commands(contract, seconds)
    assert found == commands(contract, seconds) != commands(contract, seconds, seed=1)
    values = np.array(found)
    assert np.abs(values).max(axis=0) == pytest.approx([1.0, 0.0, 0.5], abs=0.02)
    changes = np.count_nonzero((values[1:] != values[:-1]).any(axis=1))
    # Every 1.5 s, seen every 0.1 s; of two zero commands in a row the second is no change.
    assert changes == pytest.approx(2000.0 / 1.55 * (1.0 - 0.25**2), abs=70)
    assert np.mean((values == 0.0).all(axis=1)) == pytest.approx(0.25, abs=0.04)


def read(contract, count):
    """Observations of a robot whose command and angular velocity are multiples of 1, 2, ..."""
    observer = Observer(contract)
    observer.begin()
    found = []
    for step in range(1, count + 1):
        robot = SimpleNamespace(command=(10 * step, 20 * step, 30 * step), angular_velocity=(step, step, step))
        found.append(observer.read(robot).tolist())
    return found


TERMS = (Term("command_lin_vel", (0.1, 0.2), history=2), Term("command_ang_vel", 1.0, (-65.0, 65.0), 2))


@pytest.mark.parametrize(
    ("order", "layout", "third"),
    [
        ("oldest first", "by term", [2, 8, 3, 12, 60, 65]),
        ("newest first", "by term", [3, 12, 2, 8, 65, 60]),
        ("oldest first", "by step", [2, 8, 60, 3, 12, 65]),
        ("newest first", "by step", [3, 12, 65, 2, 8, 60]),
    ],
)
def test_layouts_of_the_history(ant, order, layout, third):
    contract = replace(ant, observations=TERMS, history_order=order, history_layout=layout)
    first = read(contract, 3)
    x, y, turn = "command_lin_vel[0]", "command_lin_vel[1]", "command_ang_vel[0]"
    named = {2: x, 3: x, 8: y, 12: y, 60: turn, 65: turn}
    assert Observer(contract).names == [named[value] for value in third]
    assert first[2] == pytest.approx(third)
    assert sorted(first[0]) == pytest.approx([1, 1, 4, 4, 30, 30])  # the first step fills it


def test_terms_may_have_histories_of_their_own(ant):
    terms = (Term("command_ang_vel", history=1), Term("base_ang_vel", 2.0, history=3))
    found = read(replace(ant, observations=terms), 4)
    assert found[3] == [120.0, *[4.0] * 3, *[6.0] * 3, *[8.0] * 3]
    clipped = read(replace(ant, observations=terms, observation_clip=5.0), 4)
    assert clipped[3] == [5.0, *[4.0] * 3, *[5.0] * 6]


def measured(seconds, speed, turning, command, sideways=0.0, watts=2.0, dt=0.02):
    """Measures of a robot that moves at these speeds, integrated far finer than the measures do."""
    walk, parts, x, y, yaw = Walk(), 10, 0.0, 0.0, 0.0
    for _ in range(round(seconds / dt)):
        for _ in range(parts):
            x += (speed * math.cos(yaw) - sideways * math.sin(yaw)) * dt / parts
            y += (speed * math.sin(yaw) + sideways * math.cos(yaw)) * dt / parts
            yaw += turning * dt / parts
        wrapped = math.remainder(yaw, math.tau)
        walk.move((x, y, wrapped), (speed, sideways), command, watts * dt, dt)
    return walk.measures()


def test_a_perfect_walk_has_no_error():
    found = measured(130.0, 0.5, 0.2, (0.5, 0.0, 0.2))
    assert found["heading_error"] == pytest.approx(0.0, abs=1e-6)
    assert found["lateral_drift"] < 0.02  # of 30 m in curves, by integrating in steps of 20 ms
    assert found["velocity_error"] == pytest.approx(0.0, abs=1e-9)
    assert found["energy_per_meter"] == pytest.approx(4.0)


@pytest.mark.parametrize("seconds", [30.0, 60.0, 150.0])
def test_a_robot_that_turns_is_off_its_heading_by_so_much_a_minute(seconds):
    turning = math.radians(453.0) / 60.0
    found = measured(seconds, 0.5, turning, (0.5, 0.0, 0.0))
    assert found["heading_error"] == pytest.approx(453.0)
    radius, angle = 0.5 / turning, turning * min(seconds, 60.0)
    aside = radius * (1.0 - math.cos(angle)) * (60.0 / min(seconds, 60.0))
    assert found["lateral_drift"] == pytest.approx(aside, rel=1e-3)


def test_a_robot_that_slides_drifts_and_misses_its_velocity():
    found = measured(120.0, 0.5, 0.0, (0.5, 0.0, 0.0), sideways=0.1)
    assert found["lateral_drift"] == pytest.approx(6.0)
    assert found["velocity_error"] == pytest.approx(0.1)
    assert found["energy_per_meter"] == pytest.approx(2.0 / math.hypot(0.5, 0.1))
    assert found["heading_error"] == 0.0


def test_a_commanded_side_step_is_no_drift_and_a_slower_one_neither():
    found = measured(60.0, 0.0, 0.0, (0.0, 0.3, 0.0), sideways=0.2)
    assert found["lateral_drift"] == pytest.approx(0.0, abs=1e-6)
    assert found["velocity_error"] == pytest.approx(0.1)


def test_a_robot_that_hardly_moves_has_no_energy_per_meter():
    assert measured(1.0, 0.5, 0.0, (0.5, 0.0, 0.0))["energy_per_meter"] is None
