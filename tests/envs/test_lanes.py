"""The book of lanes against a plain model of one lane each, over random histories."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perdure.envs import WorldError
from perdure.envs.checks import checked_lanes
from perdure.envs.lanes import LaneTracker

LANES = 4
horizon = st.one_of(st.integers(1, 4).map(float), st.just(math.inf), st.just(1e300))
event = st.tuples(
    st.booleans(),
    st.lists(st.integers(0, LANES - 1), min_size=1, max_size=LANES, unique=True),
    horizon,
    st.lists(st.booleans(), min_size=LANES, max_size=LANES),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(event, max_size=25))
def test_every_lane_lives_as_if_it_were_alone(history: list) -> None:
    book = LaneTracker(LANES)
    left: list[float | None] = [None] * LANES  # steps each lane may still make; None before a reset and after an end
    for is_reset, lanes, limit, falls in history:
        if is_reset:
            book.begin(*book.lanes_to_reset(lanes, limit))
            for lane in lanes:
                left[lane] = limit
        elif any(left[lane] is None for lane in lanes):
            with pytest.raises(WorldError):
                book.lanes_to_step(lanes)
        else:
            chosen = book.lanes_to_step(lanes)
            _, horizon_end = book.advance(chosen, np.array([falls[lane] for lane in lanes]))
            for row, lane in enumerate(lanes):
                left[lane] -= 1
                assert horizon_end[row] == (left[lane] == 0)
                if left[lane] == 0 or falls[lane]:
                    left[lane] = None
        assert book.running.tolist() == [steps is not None for steps in left]


@given(st.lists(st.integers(-2, LANES + 1), max_size=LANES + 1))
def test_lanes_are_accepted_exactly_when_each_exists_and_is_named_once(lanes: list[int]) -> None:
    if lanes and len(set(lanes)) == len(lanes) and set(lanes) <= set(range(LANES)):
        assert checked_lanes(lanes, LANES).tolist() == lanes
    else:
        with pytest.raises(WorldError):
            checked_lanes(np.array(lanes, dtype=np.int64), LANES)
