"""The published episodes: all of them by counting and geometry."""

from collections import Counter

import numpy as np
import pytest

from perdure.home.sim.apartments import split_apartments
from perdure.home.sim.occupancy import free_space
from perdure.home.tasks.episodes import load_episodes, start_pose
from perdure.home.tasks.tasks import TASKS


@pytest.fixture(
    scope="module", params=[(task, split) for task in TASKS for split in ("val", "eval", "eval-2")], ids="-".join
)
def episodes(request):
    return load_episodes(*request.param)


def test_there_are_five_in_each_of_the_twenty_apartments_of_the_split(episodes):
    assert [episode.index for episode in episodes.episodes] == list(range(100))
    count = Counter((episode.macro, episode.micro) for episode in episodes.episodes)
    assert count == dict.fromkeys(split_apartments(episodes.split), 5)


def test_each_plays_in_the_apartment_this_version_builds_and_starts_as_its_task_says(episodes):
    for episode in episodes.episodes:
        assert episode.apartment().name == f"macro{episode.macro}_micro{episode.micro:02d}"
        assert episode.opened == TASKS[episodes.task].opened


def test_objects_and_goals_are_where_the_rules_allow(episodes):
    task = TASKS[episodes.task]
    starts = [target.start for target in task.targets] + [rule for n, rule in task.clutter for _ in range(n)]
    rules = starts + [target.goal for target in task.targets]
    for episode in episodes.episodes:
        apartment = episode.apartment()
        for placement, rule in zip((*episode.objects, *episode.goals), rules, strict=True):
            receptacle = apartment.receptacle(placement.receptacle)
            assert receptacle.name in rule.receptacles
            assert placement.kind in rule.objects
            offset = apartment.piece(receptacle.piece).pose.to_local(np.array(placement.position)) - receptacle.center
            allowed = rule.ratio.get(receptacle.name, 1.0) * np.array(receptacle.half)
            assert (np.abs(offset[:2]) <= allowed + 0.1).all()  # settling may move an object by 0.1 m
            assert 0.0 < offset[2] < 0.15


def test_goals_are_far_enough_from_the_starts_and_near_enough_to_the_robot(episodes):
    for episode in episodes.episodes:
        space = free_space(episode.apartment(), episode.opened)
        starts = np.array([placement.position for placement in episode.objects[: len(episode.goals)]])
        assert (np.linalg.norm(starts - episode.goal_positions, axis=1) >= 0.5 - 1e-3).all()
        for points in (starts, episode.goal_positions):
            assert space.nearest(points[:, :2])[1].max() < 1.5


def test_no_two_goals_of_an_episode_are_in_each_other(episodes):
    for episode in episodes.episodes:
        goals = episode.goal_positions
        gaps = np.linalg.norm(goals[:, None] - goals[None], axis=-1)[np.triu_indices(len(goals), 1)]
        assert gaps.min() > 0.05


def test_every_episode_has_a_start_pose_for_each_of_three_evaluation_seeds(episodes):
    for episode in episodes.episodes[::10]:
        poses = {start_pose(episode.apartment(), episode, seed) for seed in (100, 101, 102)}
        assert len(poses) == 3
