"""The lane tracker against a plain model of one lane each, over random histories."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perdure.envs.world import TrackedWorld, checked_lanes
from perdure.errors import PerdureError

LANES = 4
event = st.tuples(
    st.booleans(),
    st.lists(st.integers(0, LANES - 1), min_size=1, max_size=LANES, unique=True),
    st.lists(st.booleans(), min_size=LANES, max_size=LANES),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(event, max_size=25))
def test_every_lane_lives_as_if_it_were_alone(history: list) -> None:
    tracker = TrackedWorld(LANES)
    made: list[int | None] = [None] * LANES  # steps of each running lane; None before a reset and after an end
    for is_reset, lanes, falls in history:
        if is_reset:
            tracker.begin(tracker.lanes_to_reset(lanes))
            for lane in lanes:
                made[lane] = 0
        elif any(made[lane] is None for lane in lanes):
            with pytest.raises(PerdureError):
                tracker.lanes_to_step(lanes)
        else:
            chosen = tracker.lanes_to_step(lanes)
            elapsed = tracker.advance(chosen, np.array([falls[lane] for lane in lanes]))
            for row, lane in enumerate(lanes):
                made[lane] += 1
                assert elapsed[row] == made[lane]
                if falls[lane]:
                    made[lane] = None
        assert tracker.running.tolist() == [steps is not None for steps in made]


@given(st.lists(st.integers(-2, LANES + 1), max_size=LANES + 1))
def test_lanes_are_accepted_exactly_when_each_exists_and_is_named_once(lanes: list[int]) -> None:
    if lanes and len(set(lanes)) == len(lanes) and set(lanes) <= set(range(LANES)):
        assert checked_lanes(lanes, LANES).tolist() == lanes
    else:
        with pytest.raises(PerdureError):
            checked_lanes(np.array(lanes, dtype=np.int64), LANES)
