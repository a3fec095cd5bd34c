"""Success as a person means it, on logs whose answer is known because they were made so."""

import math
from dataclasses import replace

import pytest
from home_stories import Story

from perdure.home.evaluate.counts import axis_tilt, counts_table, four_counts
from perdure.home.tasks.episodes import load_episodes

TASKS = ("set_table", "tidy_house", "prepare_groceries")


def turned(degrees):
    """The attitude of an object that was turned about its x axis."""
    half = math.radians(degrees) / 2.0
    return math.cos(half), math.sin(half), 0.0, 0.0


def final(log, number, **changes):
    """The log with another end of one object."""
    objects = list(log.final_objects)
    objects[number] = replace(objects[number], **changes)
    return replace(log, final_objects=tuple(objects))


def moved(log, number, by):
    x, y, z = log.final_objects[number].position
    return final(log, number, position=(x + by[0], y + by[1], z + by[2]))


def force(log, skill, newton):
    """The log with another force in the first run of a skill."""
    number = next(k for k, run in enumerate(log.runs) if run.skill == skill)
    runs = list(log.runs)
    runs[number] = replace(runs[number], force=newton)
    return replace(log, runs=tuple(runs))


def target(log, kind):
    return next(k for k, each in enumerate(log.targets) if each.kind == kind)


@pytest.fixture(scope="module")
def groceries():
    """Everything is brought, nothing tips, moves or is hit: three targets, then the clutter."""
    return Story("prepare_groceries").rest(range(3)).log()


@pytest.fixture(scope="module")
def table():
    """A bowl from the drawer and an apple from the fridge, at their starts at the end: only the plan is undone."""
    story = Story("set_table")
    with story.run("close_drawer", 0):
        story.wait(2)
    return story.log()


def test_a_perfect_episode_has_all_four(groceries):
    counts = four_counts(groceries)
    assert (counts.stays, counts.upright, counts.undisturbed, counts.soft) == (True, True, True, True)
    assert counts.all_four is True


@pytest.mark.parametrize(
    ("degrees", "upright"), [(0, True), (44, True), (46, False), (90, False), (117, False), (180, False)]
)
def test_a_bowl_is_upright_only_with_its_opening_up(table, degrees, upright):
    log = final(table, target(table, "024_bowl"), quaternion=turned(degrees))
    assert four_counts(log).upright is upright


@pytest.mark.parametrize(("degrees", "upright"), [(44, True), (46, False), (90, False), (134, False), (136, True)])
def test_a_can_stands_either_way_up_and_does_not_lie(degrees, upright):
    tilt = axis_tilt("005_tomato_soup_can", turned(degrees))
    assert (tilt < 45.0) is upright


def test_an_apple_has_no_side_to_stand_on(table):
    log = final(table, target(table, "013_apple"), quaternion=turned(90))
    assert four_counts(log).upright is True


def test_every_kind_of_the_published_episodes_starts_upright():
    for task in TASKS:
        for episode in load_episodes(task, "eval").episodes[:5]:
            assert all(axis_tilt(each.kind, each.quaternion) < 1.0 for each in episode.objects)


@pytest.mark.parametrize(("by", "undisturbed"), [(0.04, True), (0.06, False)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_neighbor_may_move_by_five_centimeters(groceries, by, undisturbed, axis):
    way = [0.0, 0.0, 0.0]
    way[axis] = -by
    assert four_counts(moved(groceries, 5, way)).undisturbed is undisturbed


def test_a_neighbor_must_not_tip(groceries):
    clutter = [each.kind for each in load_episodes("prepare_groceries", "val")[0].objects]
    number = next(k for k in range(3, len(clutter)) if clutter[k] != "013_apple")
    counts = four_counts(final(groceries, number, quaternion=turned(90)))
    assert (counts.undisturbed, counts.upright) == (False, True)


def test_targets_may_move_and_are_not_neighbors(groceries):
    assert four_counts(moved(groceries, 0, (1.0, 0.0, 0.0))).undisturbed is True


@pytest.mark.parametrize(("newton", "soft"), [(0.0, True), (499.0, True), (501.0, False), (math.nan, None)])
def test_a_contact_is_soft_below_500_newton(groceries, newton, soft):
    assert four_counts(force(groceries, "place", newton)).soft is soft


@pytest.mark.parametrize(("newton", "soft"), [(501.0, True), (999.0, True), (1001.0, False)])
def test_skills_that_push_a_door_have_a_limit_of_their_own(table, newton, soft):
    assert four_counts(force(table, "close_drawer", newton)).soft is soft


def test_what_does_not_stay_fails_although_the_other_counts_hold(table):
    counts = four_counts(table)
    assert (counts.stays, counts.upright, counts.undisturbed, counts.soft) == (False, True, True, True)
    assert counts.all_four is False


def test_what_a_log_does_not_tell_is_unknown(groceries):
    blind = four_counts(replace(groceries, final_objects=()))
    assert (blind.upright, blind.undisturbed, blind.all_four) == (None, None, None)
    other = four_counts(replace(groceries, episode_hash="another simulator's"))
    assert (other.upright, other.undisturbed) == (True, None)
    strange = final(groceries, 0, kind="a fork")
    assert four_counts(strange).upright is None


def test_nothing_counts_after_a_divergence(groceries):
    counts = four_counts(replace(groceries, diverged=True, final_objects=()))
    assert (counts.stays, counts.upright, counts.undisturbed, counts.soft) == (False, False, False, False)


def test_the_table_counts_shares_and_who_was_taken_over(groceries):
    tipped = replace(final(groceries, 0, quaternion=turned(90)), index=1)
    helped = replace(groceries, index=2, runs=(replace(groceries.runs[0], scripted=True), *groceries.runs[1:]))
    hard = replace(force(groceries, "pick", 600.0), index=3)
    (row,) = counts_table([groceries, tipped, helped, hard]).to_dicts()
    assert (row["task"], row["place"], row["episodes"], row["taken_over"]) == ("prepare_groceries", "story", 4, 1)
    assert (row["stays mean"], row["upright mean"], row["soft mean"]) == (1.0, 0.75, 0.75)
    # The others belong to other starts than their log says, so what moved is unknown.
    assert row["undisturbed mean"] is None
    assert row["all_four mean"] is None
    again = [replace(each, index=0, train_seed=k) for k, each in enumerate((groceries, tipped, helped, hard))]
    (row,) = counts_table(again).to_dicts()
    assert (row["train_seeds"], row["undisturbed mean"], row["all_four mean"]) == (4, 1.0, 0.5)
    # Student's t of 0, 0, 1, 1 over four trainings: 0.5 +- 3.182 x 0.577 / 2, cut at 0 and 1.
    assert (row["all_four lower"], row["all_four upper"]) == (0.0, 1.0)
