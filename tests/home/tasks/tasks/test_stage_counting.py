"""Both ways of counting on stories, step by step."""

import numpy as np
import pytest

from perdure.home.tasks.tasks import (
    NOTHING,
    SOMETHING_ELSE,
    TASKS,
    WorldFacts,
)

TIDY_HOUSE, PREPARE_GROCERIES, SET_TABLE = TASKS.values()

HOME, AWAY = 0.0, 1.0  # distance of an object from its goal
HANDLE = SOMETHING_ELSE


def story(*steps, targets=2):
    """Facts from rows (distances of the targets, held, drawer, fridge)."""
    distance = np.array([row[0] for row in steps], dtype=float)
    objects = np.zeros((len(steps), targets, 3))
    objects[..., 0] = distance
    held = np.array([row[1] for row in steps])
    containers = {name: np.array([row[k] for row in steps], dtype=float) for k, name in ((2, "drawer"), (3, "fridge"))}
    return WorldFacts(objects, np.zeros((targets, 3)), held, containers)


SET_TABLE_STORY = (
    ((AWAY, AWAY), NOTHING, 0.0, 0.0),
    ((AWAY, AWAY), HANDLE, 0.45, 0.0),  # open_0
    ((AWAY, AWAY), 0, 0.45, 0.0),  # pick_0
    ((HOME, AWAY), 0, 0.45, 0.0),
    ((HOME, AWAY), NOTHING, 0.45, 0.0),  # place_0
    ((HOME, AWAY), HANDLE, 0.05, 0.0),  # close_0
    ((HOME, AWAY), HANDLE, 0.05, 1.5),  # open_1
    ((HOME, AWAY), 1, 0.05, 1.5),  # pick_1
    ((HOME, HOME), NOTHING, 0.05, 1.5),  # place_1
    ((HOME, HOME), HANDLE, 0.05, 0.1),  # close_1
)
REACHED_AT = {
    "open_0": 1,
    "pick_0": 2,
    "place_0": 4,
    "close_0": 5,
    "open_1": 6,
    "pick_1": 7,
    "place_1": 8,
    "close_1": 9,
}


def latch(task, reached, facts):
    """Stages in order, no one left out, each kept once reached."""
    met = np.stack([stage.met(facts) for stage in task.stages], axis=-1)
    return np.logical_and.accumulate(reached | met, axis=-1)


def latched_stages(task, facts):
    """Which stages are reached after each step. Shape (steps, *, stages)."""
    met = np.stack([stage.met(facts) for stage in task.stages], axis=-1)
    reached, history = np.zeros(met.shape[1:], dtype=bool), []
    for now in met:
        reached = np.logical_and.accumulate(reached | now, axis=-1)
        history.append(reached)
    return np.array(history)


def first_steps(task, facts):
    """The step at which each stage is first reached, None for never."""
    history = latched_stages(task, facts)
    return {s.name: int(np.argmax(h)) if h.any() else None for s, h in zip(task.stages, history.T, strict=True)}


def test_a_set_table_episode_reaches_its_stages_one_by_one():
    assert first_steps(SET_TABLE, story(*SET_TABLE_STORY)) == REACHED_AT


# one thing goes wrong at one step; the stages from the named one on are never reached
MISHAPS = {
    "drawer not out far enough": (1, ((AWAY, AWAY), HANDLE, 0.39, 0.0), None),  # out at the next step, with the bowl
    "bowl never in the hand": (slice(2, 4), ((AWAY, AWAY), HANDLE, 0.45, 0.0), "pick_0"),
    "bowl put beside the goal": (slice(4, 10), ((0.16, HOME), NOTHING, 0.05, 1.5), "place_0"),
    "bowl not let go": (slice(4, 10), ((HOME, HOME), 0, 0.05, 1.5), "place_0"),
    "drawer left open": (slice(5, 10), ((HOME, HOME), NOTHING, 0.11, 0.1), "close_0"),
    "bowl rolls off before the drawer is closed": (slice(5, 10), ((0.16, HOME), NOTHING, 0.05, 0.1), "close_0"),
    "fridge not open enough": (slice(6, 9), ((HOME, AWAY), 1, 0.05, 1.41), "open_1"),
    "apple never in the hand": (7, ((HOME, AWAY), HANDLE, 0.05, 1.5), "pick_1"),
    "apple put beside the goal": (slice(8, 10), ((HOME, 0.16), NOTHING, 0.05, 0.1), "place_1"),
    "fridge left ajar": (9, ((HOME, HOME), NOTHING, 0.05, 0.16), "close_1"),
    "bowl knocked off at the end": (9, ((0.16, HOME), NOTHING, 0.05, 0.1), "close_1"),
    "apple rolls off at the end": (9, ((HOME, 0.16), NOTHING, 0.05, 0.1), "close_1"),
}


@pytest.mark.parametrize("mishap", MISHAPS)
def test_one_mishap_keeps_a_set_table_episode_from_the_stage_it_belongs_to(mishap):
    where, row, missed = MISHAPS[mishap]
    rows = list(SET_TABLE_STORY)
    for k in range(*where.indices(len(rows))) if isinstance(where, slice) else [where]:
        rows[k] = row
    steps = first_steps(SET_TABLE, story(*rows))
    names = list(REACHED_AT)
    expected = names[: names.index(missed)] if missed else names
    assert [name for name, step in steps.items() if step is not None] == expected


def test_latched_counting_keeps_a_placement_that_rolls_away_at_once():
    rows = [((AWAY,) * 3, 0, 0, 0), ((0.149, AWAY, AWAY), NOTHING, 0, 0), ((AWAY,) * 3, NOTHING, 0, 0)]
    history = latched_stages(PREPARE_GROCERIES, story(*rows, targets=3))
    assert history[:, 1].tolist() == [False, True, True]


def test_drift_of_an_earlier_object_shows_in_the_next_stage_only():
    rows = [
        ((AWAY,) * 3, 0, 0, 0),
        ((HOME, AWAY, AWAY), NOTHING, 0, 0),
        ((0.2, AWAY, AWAY), 1, 0, 0),  # the second object is picked while the first one lies outside
        ((0.2, HOME, AWAY), NOTHING, 0, 0),
        ((HOME, HOME, AWAY), 1, 0, 0),  # ... and is back: the pick counts now
    ]
    steps = first_steps(PREPARE_GROCERIES, story(*rows, targets=3))
    assert (steps["pick_0"], steps["place_0"], steps["pick_1"], steps["place_1"]) == (0, 1, 4, None)


def test_one_step_may_reach_several_stages_but_never_leaves_one_out():
    both = story(((HOME, AWAY, AWAY, AWAY, AWAY), 1, 0, 0), targets=5)
    reached = np.zeros((1, 10), dtype=bool)
    assert not latch(TIDY_HOUSE, reached, both).any()  # pick_1 holds, but pick_0 was never reached
    reached[0, :2] = True
    assert latch(TIDY_HOUSE, reached, both)[0].tolist() == [True] * 3 + [False] * 7
    opened_and_held = story(((AWAY, AWAY), 0, 0.45, 0.0))
    assert latch(SET_TABLE, np.zeros(8, dtype=bool), opened_and_held)[0].tolist() == [True, True] + [False] * 6


def test_many_lanes_at_once_count_as_each_by_itself():
    rows = list(SET_TABLE_STORY)
    other = [*rows[:4], *([rows[3]] * 6)]  # never lets go
    first, second = story(*rows), story(*other)
    both = WorldFacts(
        np.stack([first.object_positions, second.object_positions], axis=1),
        np.zeros((2, 3)),
        np.stack([first.held, second.held], axis=1),
        {name: np.stack([first.containers[name], second.containers[name]], axis=1) for name in first.containers},
    )
    together = latched_stages(SET_TABLE, both)
    assert (together[:, 0] == latched_stages(SET_TABLE, first)).all()
    assert (together[:, 1] == latched_stages(SET_TABLE, second)).all()
    assert together[-1, 0].all()
    assert together[-1, 1].sum() == 2
