"""All 125 apartments, looked at with means of their own: MuJoCo's collisions, M3's regions, counting."""

import math
from collections import Counter

import mujoco
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.sim.apartments import (
    LAYOUTS,
    SPLITS,
    build_apartment,
    draw_apartments,
    invalid_because,
    make_apartment,
    split_apartments,
)
from perdure.home.sim.occupancy import CELL
from perdure.home.sim.pieces import Pose

OPEN_SET = {
    "receptacle_aabb_Chr1_Top1_frl_apartment_chair_01",
    "receptacle_aabb_Tbl1_Top1_frl_apartment_table_01",
    "receptacle_aabb_Tbl2_Top1_frl_apartment_table_02",
    "receptacle_aabb_TvStnd1_Top1_frl_apartment_tvstand",
    "receptacle_aabb_counter_right_kitchen_counter",
    "receptacle_aabb_counter_left_kitchen_counter",
    "receptacle_aabb_Sofa_frl_apartment_sofa",
}
OTHERS = {
    "receptacle_aabb_sink_kitchen_counter",
    "receptacle_aabb_topfrl_apartment_refrigerator",
    "receptacle_aabb_middle_topfrl_apartment_refrigerator",
    "receptacle_aabb_drawer_left_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_middle_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_right_top_frl_apartment_kitchen_counter",
}
TOP_DRAWERS = ("drawer1_top", "drawer2_top", "drawer3")


def loose_model(apartment, moved=None):
    """The apartment with every piece a free body, so that MuJoCo reports what it never reports of static bodies."""
    spec = build_apartment(apartment, visuals=False)
    spec.compiler.boundmass, spec.compiler.boundinertia = 1.0, 1.0
    for body in spec.worldbody.bodies:
        if body.name in {piece.name for piece in apartment.pieces}:
            body.add_freejoint()
        if body.name == moved:
            body.pos = spec.body("table_01").pos
    return spec.compile()


def touching(model):
    """Pairs of top-level bodies that MuJoCo finds in each other."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pairs = set()
    for contact in data.contact:
        first, second = (model.body(model.body_rootid[model.geom_bodyid[g]]).name for g in contact.geom)
        names = {first, second}
        if len(names) == 2 and contact.dist < -1e-6 and model.geom("floor").id not in contact.geom:
            pairs.add(tuple(sorted(names)))
    return pairs


def test_no_two_pieces_of_furniture_are_in_each_other(apartments):
    assert {apartment.name: touching(loose_model(apartment)) for apartment in apartments} == {
        apartment.name: set() for apartment in apartments
    }


def test_a_sofa_moved_into_the_table_is_noticed_by_that_test():
    assert ("sofa", "table_01") in touching(loose_model(make_apartment(0, 0), moved="sofa"))


def test_doors_and_drawers_meet_nothing_on_their_whole_way(apartments):
    for apartment in apartments[::4]:
        model = build_apartment(apartment, visuals=False).compile()
        data = mujoco.MjData(model)
        for share in np.linspace(0.0, 1.0, 9):
            data.qpos = share * model.jnt_range[:, 1]
            mujoco.mj_forward(model, data)
            assert data.ncon == 0, (apartment.name, share)


def test_every_apartment_has_the_receptacles_of_the_benchmark_and_two_chairs(apartments):
    for apartment in apartments:
        count = Counter(receptacle.name for receptacle in apartment.receptacles)
        assert set(count) == OPEN_SET | OTHERS
        assert count["receptacle_aabb_Chr1_Top1_frl_apartment_chair_01"] == 2
        assert sum(count.values()) == len(OPEN_SET | OTHERS) + 1


def test_receptacles_lie_on_something_solid_and_under_nothing(apartments):
    """A ray down from 5 cm above five points of each surface hits it after 5 cm; a ray up is free as far as stated."""
    for apartment in apartments[::7]:
        model = build_apartment(apartment, visuals=False).compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        hit, above = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, 0.05])
        for receptacle in apartment.receptacles:
            corners = np.array([(0, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)]) * receptacle.half
            for point in apartment.surface_to_room(receptacle, corners):
                down, up = (
                    mujoco.mj_ray(model, data, point + above, [0.0, 0.0, sign], None, 1, -1, hit)
                    for sign in (-1.0, 1.0)
                )
                assert down == pytest.approx(0.05, abs=2e-3), receptacle.unique_name
                expected = -1.0 if math.isinf(receptacle.headroom) else receptacle.headroom - 0.05
                assert up == pytest.approx(expected, abs=2e-3), receptacle.unique_name


def test_floor_is_one_island_of_a_living_area(apartments, spaces):
    for apartment, space in zip(apartments, spaces, strict=True):
        areas = space["closed"].areas
        assert areas[0] > 15.0, apartment.name
        assert areas[1:].sum() < 0.02 * areas[0], apartment.name


def test_every_point_where_an_object_may_lie_is_within_reach_of_the_main_island(apartments, spaces):
    """0.95 m: the arm reaches 0.98 m from a shoulder that sits 0.15 m in front of the base's middle."""
    worst = 0.0
    for apartment, space in zip(apartments, spaces, strict=True):
        for receptacle in apartment.receptacles:
            if receptacle.link is None:
                edge = np.array([(u, v) for u in (-1, 0, 1) for v in np.linspace(-1, 1, 7)]) * receptacle.half
                points = apartment.surface_to_room(receptacle, edge)[:, :2]
                state = "wide open" if receptacle.piece == "fridge" else "closed"
                worst = max(worst, float(space[state].nearest(points)[1].max()))
    assert 0.8 < worst <= 0.95


def region(space, frame, low, high):
    """Area of the main island inside a rectangle of a frame, in square meters."""
    local = frame.to_local(space.centers[space.island == 0])
    return ((local >= low) & (local <= high)).all(axis=1).sum() * CELL**2


def test_robot_finds_room_where_m3_starts_its_drawer_skills(apartments, spaces):
    """M3's navigation regions in the handle's frame: opening x [0.80, 0.95], closing x [0.30, 0.45], y within 0.35."""
    for apartment, space in zip(apartments, spaces, strict=True):
        yaw = apartment.piece("kitchen_counter").pose.yaw
        for link in TOP_DRAWERS:
            for state, q, low, high in (("closed", 0.0, 0.80, 0.95), ("wide open", 0.5, 0.30, 0.45)):
                x, y, _ = apartment.handle_to_room(link, q)
                found = region(space[state], Pose(x, y, yaw), (low, -0.35), (high, 0.35))
                assert found > 0.25 * 0.15 * 0.70, (apartment.name, link, state)


def test_robot_finds_room_where_m3_starts_its_fridge_skills(apartments, spaces):
    """M3: 0.933 to 1.833 m before the fridge, y within 0.6 (skills); x [1.0, 1.8], y within 0.5 (navigation)."""
    for apartment, space in zip(apartments, spaces, strict=True):
        frame = apartment.piece("fridge").pose
        for state, share in (("closed", 0.9), ("counts as open", 0.4), ("wide open", 0.9)):
            assert region(space[state], frame, (0.933, -0.6), (1.833, 0.6)) > share * 0.9 * 1.2, (apartment.name, state)
            assert region(space[state], frame, (1.0, -0.5), (1.8, 0.5)) > share * 0.8 * 1.0, (apartment.name, state)


def test_a_bowl_in_a_drawer_is_clear_of_the_counter_once_the_drawer_counts_as_open():
    apartment = make_apartment(0, 0)
    counter = apartment.piece("kitchen_counter")
    front = 0.151  # of the worktop
    for receptacle in (r for r in apartment.receptacles if r.link is not None):
        edge = np.array([[-receptacle.half[0], 0.0]])
        point = counter.pose.to_local(apartment.surface_to_room(receptacle, edge, {receptacle.link: 0.4}))
        assert point[0, 0] - 0.0807 >= front - 1e-3


def test_same_numbers_give_the_same_apartment_and_others_do_not(apartments):
    make_apartment.cache_clear()
    assert make_apartment(2, 7) == apartments[2 * 21 + 7]
    assert len({apartment.fingerprint for apartment in apartments}) == 125
    assert make_apartment(2, 7, seed=1).fingerprint != make_apartment(2, 7).fingerprint


def test_micro_variations_move_furniture_but_leave_the_kitchen_and_the_room(apartments):
    for macro in range(10):
        group = [apartment for apartment in apartments if apartment.macro == macro]
        assert len({apartment.room for apartment in group}) == 1
        assert len({apartment.piece("kitchen_counter").pose for apartment in group}) == 1
        places = {
            name: {apartment.piece(name).pose for apartment in group} for name in ("table_01", "table_02", "sofa")
        }
        assert all(len(poses) == len(group) for poses in places.values())


def test_macro_layouts_differ_in_room_and_kitchen(apartments):
    first = [apartment for apartment in apartments if apartment.micro == 0]
    assert len({apartment.room for apartment in first}) == 10
    assert len({apartment.piece("kitchen_counter").pose for apartment in first}) == 10
    for x, y in (np.transpose(apartment.room) for apartment in first):
        assert 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 40.0, "square meters, corners counter-clockwise"


def test_splits_are_those_of_m3():
    train, val, evaluation, second = (split_apartments(name) for name in ("train", "val", "eval", "eval-2"))
    assert (len(train), len(val), len(evaluation), len(second)) == (64, 20, 20, 20)
    assert {macro for macro, _ in train} == {macro for macro, _ in val} == {0, 1, 2, 3}
    assert {micro for _, micro in val} == {16, 17, 18, 19, 20}
    assert set(evaluation) == {(4, micro) for micro in range(20)}
    assert not set(train) & set(val)
    assert {macro for macro, _ in second} == {5, 6, 7, 8, 9}, "five layouts of no other split"
    assert len(SPLITS) == 4


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: make_apartment(10, 0), "0 to 9, not 10"),
        (lambda: make_apartment(0, 21), "0 to 20, not 21"),
        (lambda: make_apartment(9, 4), "0 to 3, not 4"),
        (lambda: split_apartments("test"), "train, val, eval, eval-2"),
        (lambda: make_apartment(0, 0).piece("bed"), "no piece .* 'bed'.*sofa"),
        (lambda: make_apartment(0, 0).articulation("door"), "top_door"),
        (lambda: make_apartment(0, 0).receptacles_named("shelf"), "receptacle_aabb_Sofa"),
        (lambda: make_apartment(0, 0).receptacle("shelf"), "sofa|receptacle_aabb_Sofa"),
    ],
)
def test_wrong_names_and_numbers_are_refused_with_the_right_ones(call, words):
    with pytest.raises(PerdureError, match=words):
        call()


@pytest.mark.parametrize("macro", range(10))
def test_a_published_apartment_is_the_first_draw_that_passes_all_checks(macro):
    first = []
    for micro in range(len(LAYOUTS[macro].rejected_draws)):
        draws = enumerate(draw_apartments(macro, micro, seed=0))
        first.append(next(number for number, apartment in draws if invalid_because(apartment) is None))
    assert tuple(first) == LAYOUTS[macro].rejected_draws


def test_an_apartment_of_another_seed_passes_the_checks_and_is_another_one():
    other = make_apartment(0, 0, seed=1)
    assert invalid_because(other) is None
    assert other.pieces != make_apartment(0, 0).pieces
