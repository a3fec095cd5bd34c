"""Clocks against time tables written out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perdure.errors import PerdureError
from perdure.horizon import Clock, Constant, Countdown, Geometric, LaneClocks, Linear, Periodic, parse_clock

ELAPSED = np.arange(6.0)
TIMETABLES = {
    Countdown(4): ([0, 1, 2, 3, 4, 5], [4, 4, 4, 4, 4, 4]),
    Constant(4): ([0, 0, 0, 0, 0, 0], [4, 4, 4, 4, 4, 4]),
    Constant(0): ([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]),
    Constant(np.inf): ([0, 0, 0, 0, 0, 0], [np.inf] * 6),
    Periodic(4): ([0, 1, 2, 3, 0, 1], [4, 4, 4, 4, 4, 4]),
    Periodic(1): ([0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]),
    Periodic(0): ([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]),
    Periodic(np.inf): ([0, 1, 2, 3, 4, 5], [np.inf] * 6),
}
clocks = st.builds(
    lambda kind, steps: kind(steps), st.sampled_from([Countdown, Constant, Periodic]), st.sampled_from([0, 1, 7, 500])
)


def table(clock, elapsed):
    times, horizons = clock.time(elapsed)
    return np.asarray(times).tolist(), np.asarray(horizons).tolist()


@pytest.mark.parametrize("clock", TIMETABLES, ids=lambda clock: clock.label)
def test_a_clock_keeps_its_timetable(clock):
    assert table(clock, ELAPSED) == TIMETABLES[clock]


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("clock", TIMETABLES, ids=lambda clock: clock.label)
def test_a_clock_keeps_its_timetable_in_jax(clock, x64):
    with jax.enable_x64(x64):
        assert table(clock, jnp.asarray(ELAPSED)) == TIMETABLES[clock]
        traced = jax.jit(clock.time)(jnp.asarray(ELAPSED))
    assert [np.asarray(part).tolist() for part in traced] == list(TIMETABLES[clock])


def test_a_clock_reads_single_python_numbers():
    assert Countdown(10).time(3) == (3, 10)
    assert Constant(10).time(3) == (0, 10)
    assert Periodic(10).time(23) == (3, 10)


def test_constant_clocks_of_any_length_look_alike_to_linear_but_not_to_geometric():
    short, long = (clock.time(np.array([12345.0])) for clock in (Constant(100), Constant(1000)))
    assert Linear()(*short) == Linear()(*long) == 1
    assert not np.allclose(Geometric(10)(*short), Geometric(10)(*long), atol=0.1)


def test_a_finished_countdown_stays_at_nothing_left():
    assert Geometric(3)(*Countdown(5).time(np.array([5.0, 6.0, 1e6]))).tolist() == [[1.0, 1.0, 1.0]] * 3


@pytest.mark.parametrize("kind", [Countdown, Constant, Periodic])
@pytest.mark.parametrize("steps", [-1, -0.5, float("nan")])
def test_fewer_than_no_steps_are_refused(kind, steps):
    with pytest.raises(PerdureError, match=f"{kind.name}.*got {steps}"):
        kind(steps)


@pytest.mark.parametrize(
    ("clock", "label"),
    [
        (Constant(500), "constant(500)"),
        (Constant(500.0), "constant(500)"),
        (Countdown(100_000), "countdown(100000)"),
        (Countdown(1_234_567), "countdown(1234567)"),
        (Periodic(0), "periodic(0)"),
        (Constant(2.5), "constant(2.5)"),
        (Constant(float("inf")), "constant(inf)"),
    ],
)
def test_a_label_names_the_clock_and_can_be_read_back(clock, label):
    assert clock.label == label
    assert parse_clock(label) == clock


def test_the_command_line_writes_a_clock_as_name_and_steps():
    assert parse_clock("constant:500") == Constant(500)
    assert parse_clock(" periodic:200 ") == Periodic(200)
    assert parse_clock("countdown:1e5") == Countdown(100_000)


@pytest.mark.parametrize("text", ["constant", "constant:", "500", "", "constant:many"])
def test_text_without_steps_is_refused_with_an_example(text):
    with pytest.raises(PerdureError, match="constant:500"):
        parse_clock(text)


def test_an_unknown_clock_is_refused_with_the_known_ones():
    with pytest.raises(PerdureError, match=r"'sundial'.*constant, countdown, .*periodic"):
        parse_clock("sundial:3")


def test_negative_steps_on_the_command_line_are_refused():
    with pytest.raises(PerdureError, match="got -5"):
        parse_clock("constant:-5")


@pytest.mark.parametrize("clock", TIMETABLES, ids=lambda clock: clock.label)
def test_a_clock_survives_json(clock):
    assert Clock.from_json(clock.to_json()) == clock


@given(st.lists(clocks, min_size=1, max_size=12), st.data())
def test_clocks_of_lanes_are_each_clock_alone(some, data):
    elapsed = np.array(data.draw(st.lists(st.integers(0, 10_000), min_size=len(some), max_size=len(some))), float)
    times, horizons = LaneClocks(some).time(elapsed)
    for lane, clock in enumerate(some):
        assert table(clock, elapsed[lane : lane + 1]) == ([times[lane]], [horizons[lane]])


def test_one_batch_mixes_clocks():
    mixed = LaneClocks([Constant(9), Countdown(5), Periodic(2), Constant(9)])
    assert table(mixed, [3, 3, 3, 4]) == ([0, 3, 1, 0], [9, 5, 2, 9])


def test_lanes_that_do_not_fit_are_refused():
    with pytest.raises(PerdureError, match="at least one clock"):
        LaneClocks([])
    two = LaneClocks([Constant(1), Constant(2)])
    with pytest.raises(PerdureError, match=r"\(2,\).*\(3,\)"):
        two.time([0, 0, 0])


@pytest.mark.parametrize("steps", [0, 1, 7, 500, np.inf])
@pytest.mark.parametrize("kind", [kind for kind in Clock.kinds().values() if kind.__module__ == "perdure.horizon"])
def test_every_clock_tells_a_time_at_every_number_in_numpy_and_jax_and_is_stored(kind, steps):
    clock = kind(steps)
    times, horizons = clock.time(ELAPSED)
    assert np.isfinite(times).all()
    assert (np.asarray(horizons) >= 0).all()
    with jax.enable_x64(True):
        traced = jax.jit(clock.time)(jnp.asarray(ELAPSED))
    np.testing.assert_array_equal(traced, np.broadcast_arrays(times, horizons))
    assert Clock.from_json(clock.to_json()) == parse_clock(clock.label.replace("(", ":").rstrip(")")) == clock
