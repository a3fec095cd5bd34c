import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perdure.home.sim import occupancy

DIAMOND = np.array([[0.0, 0.0, 1.0, 1.0, math.pi / 4]])  # a square of side 2 on its corner: |x| + |y| <= sqrt(2)

rectangles = st.tuples(
    st.floats(-2, 2), st.floats(-2, 2), st.floats(0.1, 1.5), st.floats(0.1, 1.5), st.floats(-math.pi, math.pi)
).map(lambda row: np.array([row]))


def test_distance_to_a_turned_square_is_that_of_elementary_geometry():
    points = np.array([[0.0, 0.0], [math.sqrt(2) + 0.5, 0.0], [2.0, 2.0], [0.5, 0.5]])
    expected = [0.0, 0.5, 2 * math.sqrt(2) - 1.0, 0.0]  # inside, off a corner, off a side, inside
    assert occupancy.clearance(points, DIAMOND) == pytest.approx(expected, abs=1e-12)


def test_distance_to_no_rectangle_is_infinite():
    assert occupancy.clearance(np.zeros((2, 2)), np.empty((0, 5))).tolist() == [math.inf, math.inf]


def test_turned_squares_overlap_exactly_until_their_corners_part():
    reach = math.sqrt(2)  # of a corner of the diamond
    for gap, expected in ((-1e-6, True), (1e-6, False)):
        beside = np.array([[reach + gap + 1.0, 0.0, 1.0, 1.0, 0.0]])
        assert occupancy.overlap(DIAMOND, beside)[0, 0] == expected


def test_margin_widens_the_overlap_by_itself():
    first, second = np.array([[0.0, 0.0, 1.0, 1.0, 0.0]]), np.array([[2.1, 0.0, 1.0, 1.0, 0.0]])
    assert not occupancy.overlap(first, second, 0.09)[0, 0]
    assert occupancy.overlap(first, second, 0.11)[0, 0]


@settings(deadline=None)
@given(rectangles, rectangles)
def test_overlap_agrees_with_points_sampled_in_the_rectangles(first, second):
    ticks = np.linspace(-1.0, 1.0, 21)
    local = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2) * first[0, 2:4]
    cos, sin = math.cos(first[0, 4]), math.sin(first[0, 4])
    points = first[0, :2] + local @ np.array([[cos, sin], [-sin, cos]])
    nearest = occupancy.clearance(points, second).min()
    if occupancy.overlap(first, second)[0, 0]:
        assert nearest <= 0.5 * math.hypot(*(first[0, 2:4] * 0.1))  # no point of it is farther from a sample
    else:
        assert nearest > 0.0 or math.isclose(nearest, 0.0, abs_tol=1e-9)
        assert not occupancy.overlap(second, first)[0, 0]


def test_point_in_an_l_shaped_room_is_told_from_a_point_in_its_notch():
    room = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))
    points = np.array([[1.0, 3.0], [3.0, 1.0], [3.0, 3.0], [-0.1, 1.0], [2.1, 2.1]])
    assert occupancy.inside(points, room).tolist() == [True, True, False, False, False]
