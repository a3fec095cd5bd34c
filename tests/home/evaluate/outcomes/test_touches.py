"""Touches of what was released, written by hand: by kind, and only while the hand withdraws."""

from dataclasses import replace

import pytest
from home_stories import Story

from perdure.home.evaluate.touches import touch_table
from perdure.stats import clopper_pearson

STEPS = 60
"""Control steps in two seconds."""


def obstructed(index, push):
    """An episode in which the hand touches target 0 for 4 steps after its release and pushes it by `push`."""
    story = Story(index=index).go(0)
    story.touched[0] = True
    for _ in range(4):
        story.objects[0] = story.objects[0] + [push / 4.0, 0.0, 0.0]
        story.wait()
    story.touched[0] = False
    return story


def test_touches_and_pushes_are_counted_by_kind():
    late = Story(index=2).go(0).wait(STEPS)
    late.touched[0] = True
    late.objects[0] = late.objects[0] + [0.05, 0.0, 0.0]
    late.wait()
    late.touched[0] = False
    logs = [
        obstructed(0, push=0.06).rest((1, 2)).log(),
        obstructed(1, push=0.004).rest((1, 2)).log(),
        late.rest((1, 2)).log(),
    ]
    first = logs[0].releases[0]
    assert (first.touches, first.pushed) == (4, pytest.approx(0.06))
    rows = touch_table(logs).to_dicts()
    assert sum(row["placements"] for row in rows) == 9
    assert sum(row["touched"] for row in rows) == 2
    assert sum(row["pushed"] for row in rows) == 1
    kinds = [log.targets[0].kind for log in logs[:2]]
    for row in rows:
        assert row["touched"] == kinds.count(row["kind"])
        assert row["cylinder"] == row["kind"].endswith(("master_chef_can", "soup_can", "fish_can"))
        lower, upper = clopper_pearson(row["touched"] / row["placements"], row["placements"])
        assert (row["touched lower"], row["touched upper"]) == (lower, upper)


def test_what_a_log_does_not_tell_is_not_counted():
    log = Story().rest(range(3)).log()
    unknown = replace(log, releases=replace(log.history, touched=None).releases)
    assert {release.touches for release in unknown.releases} == {-1}
    assert touch_table([unknown]).is_empty()
