"""`StayAtGoal` against sequences of successes written out by hand."""

import gymnasium
import pytest

from perdure.errors import PerdureError
from perdure.wrappers import StayAtGoal


class Sequence(gymnasium.Env):
    """Reports these successes, one a step; ends at a step if one is named."""

    observation_space = action_space = gymnasium.spaces.Discrete(1)

    def __init__(self, said, key="is_success", ends_at=None):
        self.said, self.key, self.ends_at = said, key, ends_at

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return 0, {}

    def step(self, action):
        self.steps += 1
        return 0, 0.0, self.steps == self.ends_at, False, {self.key: self.said[self.steps - 1], "other": 7}


SAID = [0, 1, 1, 0, 1, 1, 1, 1, 0]
EXPECTED = {
    "is_success": [0, 0, 0, 0, 0, 0, 1, 1, 0],
    "success_once": [0, 1, 1, 1, 1, 1, 1, 1, 1],
    "success_at_end": SAID,
    "longest_stay": [0, 1, 2, 2, 2, 2, 3, 4, 4],
}
"""After each step, with Delta = 3."""


@pytest.mark.parametrize("key", [None, "success", "solved"])
def test_a_success_counts_once_it_has_lasted(key):
    env = StayAtGoal(Sequence(SAID, key or "is_success"), 3, key=key)
    for _ in range(2):
        env.reset()
        infos = [env.step(0)[4] for _ in SAID]
        assert {name: [info[name] for info in infos] for name in EXPECTED} == EXPECTED, "also in a second episode"
    assert infos[0]["other"] == 7


def test_an_end_away_from_the_goal_or_after_the_stay_is_allowed():
    for said, ends_at in (([1, 1, 0], 3), ([0, 1, 1], 3)):
        env = StayAtGoal(Sequence(said, ends_at=ends_at), 2)
        env.reset()
        assert [env.step(0)[2] for _ in said] == [False, False, True]


def test_an_episode_that_ends_before_anything_could_stay_is_refused():
    env = StayAtGoal(Sequence([0, 1], ends_at=2), 2)
    env.reset()
    env.step(0)
    with pytest.raises(PerdureError, match="1 of 2"):
        env.step(0)


@pytest.mark.parametrize(
    ("env", "options", "message"),
    [
        (Sequence([1]), {"steps": 0}, "steps must be at least 1, got 0"),
        (Sequence([1], "solved"), {"steps": 1}, "no is_success nor success: name its entry with key"),
        (Sequence([1]), {"steps": 1, "key": "solved"}, r"info\['solved'\].*is missing; there are is_success, other"),
    ],
)
def test_what_it_cannot_read_is_refused(env, options, message):
    def step():
        wrapped = StayAtGoal(env, **options)
        wrapped.reset()
        wrapped.step(0)

    with pytest.raises(PerdureError, match=message):
        step()
