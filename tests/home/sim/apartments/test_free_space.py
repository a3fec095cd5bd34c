"""Free space and geodesic distances against closed forms."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perdure.errors import PerdureError
from perdure.home.sim import occupancy
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.occupancy import FreeSpace, footprints, free_space
from perdure.home.sim.pieces import room_walls

ROOM = ((0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0))
OVERESTIMATE = 1.0 / math.cos(math.pi / 8.0)


def path_length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def space_of(*boxes, room=ROOM):
    """A room whose walls and `boxes` (x0, y0, x1, y1) are in the way."""
    walls = np.concatenate([footprints(wall) for wall in room_walls(room)])
    rows = [((x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2, 0.0) for x0, y0, x1, y1 in boxes]
    return FreeSpace.of(room, np.concatenate([walls, np.array(rows).reshape(-1, 5)]))


def cell(space, x, y):
    index, distance = space.nearest(np.array([[x, y]]))
    assert distance[0] < 1e-9, "choose a point that is the middle of a cell"
    return index


def test_free_area_of_an_empty_room_is_the_room_shrunk_by_the_radius():
    space = space_of()
    assert space.areas == pytest.approx([5.4 * 3.4], rel=0.01)


def test_grid_agrees_with_the_exact_test_at_every_cell():
    space = space_of((2.5, 1.5, 3.5, 2.5), (5.8, 3.7, 7.0, 5.0), (-3.0, -3.0, -2.0, -2.0))
    turned = np.concatenate([space.rectangles, [[1.2, 3.0, 0.5, 0.1, 0.6]]])
    space = FreeSpace.of(ROOM, turned)
    rows, columns = np.indices(space.free.shape)
    middles = np.stack([(columns + 0.5) * 0.05, (rows + 0.5) * 0.05], axis=-1).reshape(-1, 2)
    assert (space.is_free(middles) == space.free.ravel()).all()


def test_cells_are_free_exactly_from_the_radius_on():
    space = space_of()
    assert space.is_free(np.array([[0.3001, 2.0], [0.2999, 2.0], [5.6999, 0.3001], [5.7001, 2.0]])).tolist() == [
        True,
        False,
        True,
        False,
    ]
    low = space.centers.min(axis=0)
    assert low == pytest.approx([0.325, 0.325])  # the first middle at or above 0.3


@pytest.mark.parametrize(
    ("goal", "factor"),
    [
        ((4.525, 1.025), 1.0),  # along a row
        ((3.525, 3.525), 1.0),  # along a diagonal
        ((1.025 + 2.0, 1.025 + 1.0), (1.0 + math.sqrt(2)) / math.sqrt(5)),  # one straight and one diagonal step
        ((1.025 + 2.4, 1.025 + 1.0), (1.4 + math.sqrt(2)) / math.hypot(2.4, 1.0)),  # near 22.5 degrees, the worst
    ],
)
def test_distance_in_an_empty_room_is_octile(goal, factor):
    space = space_of()
    straight = math.dist((1.025, 1.025), goal)
    value = space.distances(cell(space, 1.025, 1.025)).values[cell(space, *goal)[0]]
    assert value == pytest.approx(factor * straight, abs=1e-9)
    assert straight <= value + 1e-9 <= OVERESTIMATE * straight + 2e-9


def detour(start, end, corner, radius):
    """Length of the shortest way of a disc around one corner of a wall: tangent, arc, tangent."""
    total = 0.0
    angles = []
    for point, side in ((start, 1.0), (end, -1.0)):
        distance = math.dist(point, corner)
        total += math.sqrt(distance**2 - radius**2)
        bearing = math.atan2(point[1] - corner[1], point[0] - corner[0])
        angles.append(bearing - side * math.acos(radius / distance))
    return total + radius * ((angles[0] - angles[1]) % math.tau)


def test_distance_around_the_end_of_a_wall_is_that_of_two_tangents_and_an_arc():
    """A wall of no width worth speaking of from the south side to y = 2.5; the way leads around its upper end."""
    space = space_of((2.9999, 0.0, 3.0001, 2.5))
    start, end = (1.525, 1.025), (4.475, 1.025)
    shortest = detour(start, end, (3.0, 2.5), 0.3)
    geodesic = space.distances(cell(space, *end))
    value = geodesic.values[cell(space, *start)[0]]
    assert shortest == pytest.approx(4.687, abs=1e-3)  # 2 * 2.0643 m of tangent and 0.3 m * 106.6 degrees of arc
    assert shortest - 0.01 <= value <= OVERESTIMATE * shortest + 0.1
    assert path_length(geodesic.path(np.array(start))) == pytest.approx(value)
    assert value > 1.3 * math.dist(start, end)  # a map that forgot the wall would say 2.95 m


def test_a_robot_passes_a_gap_wider_than_itself_and_no_other():
    for width, islands in ((0.75, 1), (0.55, 2)):
        middle = 1.0 + width / 2
        space = space_of((2.9, 0.0, 3.1, middle - width / 2), (2.9, middle + width / 2, 3.1, 4.0))
        assert len(space.areas) == islands


def test_no_way_leads_to_another_island():
    space = space_of((2.9, 0.0, 3.1, 4.0))
    here, there = (np.nonzero(space.island == k)[0] for k in (0, 1))
    assert np.isinf(space.distances(there[:1]).values[here]).all()
    with pytest.raises(PerdureError, match="no way leads"):
        space.distances(there[:1]).path(space.centers[here[0]])


def test_nearest_free_cell_to_a_point_in_a_wall_is_one_radius_away():
    space = space_of((2.5, 1.5, 3.5, 2.5))
    _, distance = space.nearest(np.array([[2.5, 2.0], [3.0, 2.0], [-1.0, 2.0]]))
    assert distance == pytest.approx([0.3, 0.8, 1.3], abs=0.05)


def test_distance_to_several_goals_is_that_to_the_nearest():
    space = space_of()
    goals = np.concatenate([cell(space, 1.025, 1.025), cell(space, 5.025, 1.025)])
    values = space.distances(goals).values
    assert values[cell(space, 2.025, 1.025)[0]] == pytest.approx(1.0)
    assert values[cell(space, 4.525, 1.025)[0]] == pytest.approx(0.5)


def test_a_geodesic_without_goals_is_refused():
    with pytest.raises(PerdureError, match="at least one goal"):
        space_of().distances(np.array([], dtype=int))


boxes = st.lists(
    st.tuples(st.floats(0.5, 4.5), st.floats(0.5, 3.0), st.floats(0.05, 1.0), st.floats(0.05, 1.0)), max_size=4
)


@given(boxes, st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_every_path_keeps_the_robot_clear(sizes, choice):
    space = space_of(*((x, y, x + width, y + depth) for x, y, width, depth in sizes))
    main = np.nonzero(space.island == 0)[0]
    goal, start = main[choice % len(main)], main[(choice * 7919) % len(main)]
    geodesic = space.distances(np.array([goal]))
    points = geodesic.path(space.centers[start])
    dense = [points] + [a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(points)]
    clear = occupancy.clearance(np.concatenate(dense), space.rectangles).min()
    assert clear >= math.sqrt(0.3**2 - 2 * 0.05**2 / 4) - 1e-9
    assert points[0] == pytest.approx(space.centers[start])
    assert points[-1] == pytest.approx(space.centers[goal])
    assert path_length(points) == pytest.approx(geodesic.values[start])


def test_the_cell_that_holds_a_point_is_the_nearest_one():
    space = free_space(make_apartment(0, 3))
    rng = np.random.default_rng(0)
    low, high = np.min(space.room, axis=0) - 0.3, np.max(space.room, axis=0) + 0.3
    points = rng.uniform(low, high, (400, 2))
    index, _ = space.nearest(points)
    assert [space.cell_at(x, y) for x, y in points.tolist()] == index.tolist()


def test_what_lies_ahead_is_on_the_path():
    space = free_space(make_apartment(1, 0))
    route = space.distances(np.array([7]))
    rng = np.random.default_rng(1)
    for start in space.centers[rng.integers(len(space.centers), size=20)]:
        (cell,), (first,) = space.nearest(start[None])
        if not np.isfinite(route.values[cell]):
            continue
        path = route.path(start)
        distance, x, y = route.ahead(*start.tolist(), 10)
        np.testing.assert_allclose([distance, x, y], [first + route.values[cell], *path[min(10, len(path) - 1)]])
