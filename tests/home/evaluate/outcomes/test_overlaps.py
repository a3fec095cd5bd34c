"""How deep objects lie inside each other, against closed forms, and which pairs the check lists."""

from dataclasses import replace

import numpy as np
import pytest
from home_stories import good

from perdure.home.evaluate.log import FinalObject
from perdure.home.evaluate.outcomes import find_overlaps, overlap_depth
from perdure.home.sim.objects import KINDS

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
APPLE, BOX, POTTED_MEAT, TUNA = "013_apple", "003_cracker_box", "010_potted_meat_can", "007_tuna_fish_can"


def at(kind, *position, speed=0.0, held=False, quaternion=UPRIGHT):
    return FinalObject(kind, position, quaternion, speed, held)


@pytest.mark.parametrize("depth", [0.001, 0.02, 0.06, -0.01])
def test_two_spheres(depth):
    apart = KINDS[APPLE].size[0] - depth
    toward = np.array([0.48, 0.6, 0.64]) * apart
    found = overlap_depth(at(APPLE, 1.0, 2.0, 3.0), at(APPLE, *(np.array([1.0, 2.0, 3.0]) + toward)))
    assert found == pytest.approx(max(depth, 0.0), abs=1e-5)


@pytest.mark.parametrize("depth", [0.001, 0.01, 0.03, -0.01])
def test_a_box_on_a_box(depth):
    height = KINDS[BOX].size[2]
    found = overlap_depth(at(BOX, 0.0, 0.0, 0.0), at(BOX, 0.004, -0.003, height - depth))
    assert found == pytest.approx(max(depth, 0.0), abs=1e-4)


def test_a_box_on_its_side_reaches_as_far_as_it_is_tall():
    lying = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    apart = 0.5 * (KINDS[BOX].size[2] + KINDS[BOX].size[0])
    pair = at(BOX, 0.0, 0.0, 0.0, quaternion=lying), at(BOX, apart - 0.01, 0.0, 0.0)
    assert overlap_depth(*pair) == pytest.approx(0.01, abs=1e-4)
    assert overlap_depth(replace(pair[0], quaternion=UPRIGHT), pair[1]) == 0.0


def test_a_can_inside_a_can_is_found_whatever_the_simulation_let_collide():
    """The error that this check was made for: one object stood inside another that had also been held."""
    assert overlap_depth(at(POTTED_MEAT, 0.0, 0.0, 0.042), at(TUNA, 0.01, 0.0, 0.017)) > 0.015


@pytest.mark.parametrize(
    ("change", "listed"),
    [({}, True), ({"speed": 0.02}, False), ({"held": True}, False)],
    ids=["at rest", "moving", "in the hand"],
)
def test_only_objects_at_rest_and_out_of_the_hand_are_listed(change, listed):
    record = good()
    assert not list(find_overlaps([record])), "the control: an episode as it was drawn has none"
    first = record.final_objects[0]
    inside = replace(record.final_objects[1], position=first.position, quaternion=first.quaternion, **change)
    wrong = replace(record, final_objects=(first, inside, *record.final_objects[2:]))
    found = list(find_overlaps([wrong]))
    assert [(each.first, each.second) for each in found] == ([(0, 1)] if listed else [])
    if listed:
        assert found[0].log is wrong
        assert not list(find_overlaps([replace(wrong, diverged=True)]))
        assert not list(find_overlaps([wrong], deeper_than=found[0].depth + 1e-6))
