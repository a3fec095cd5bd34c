"""Start poses: drawn by the evaluation seed, free on the floor, free around the arm."""

import math

import numpy as np
import pytest
from test_episode_files import episode

from perdure.errors import PerdureError
from perdure.home.sim import occupancy
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.occupancy import apartment_footprints, free_space
from perdure.home.tasks.episodes import start_pose


@pytest.fixture(scope="module")
def poses():
    home = make_apartment(2, 17)
    return [start_pose(home, episode(), seed) for seed in range(400)]


def test_pose_depends_on_the_episode_and_the_seed_and_on_nothing_else():
    home = make_apartment(2, 17)
    drawn = {(k, seed): start_pose(home, episode(k), seed) for k in (0, 1) for seed in (100, 101, 102)}
    assert len(set(drawn.values())) == 6
    assert start_pose(home, episode(1), 101) == drawn[1, 101]


def test_robot_fits_where_it_starts_and_can_get_everywhere(poses):
    space = free_space(make_apartment(2, 17), episode().opened)
    points = np.array([(pose.x, pose.y) for pose in poses])
    assert space.is_free(points).all()
    assert (space.nearest(points)[1] <= 0.05).all()


def test_arm_at_rest_is_clear_of_tall_furniture(poses):
    """The gripper rests 0.5 m before the base at 1 m height: with 0.15 m around it nothing taller than 0.6 m."""
    tall = apartment_footprints(make_apartment(2, 17), episode().opened, low=0.6)
    gripper = np.array([pose.to_room(np.array([0.45, 0.0])) for pose in poses])
    assert occupancy.clearance(gripper, tall).min() >= 0.2 - 1e-9
    freely_turned = np.array([pose.to_room(np.array([-0.45, 0.0])) for pose in poses])  # behind it there may be a wall
    assert occupancy.clearance(freely_turned, tall).min() < 0.2


def test_poses_spread_over_the_floor_and_all_headings(poses):
    low, high = np.min(make_apartment(2, 17).room, axis=0), np.max(make_apartment(2, 17).room, axis=0)
    share = np.array([((pose.x, pose.y) - low) / (high - low) for pose in poses])
    quarters = np.histogram2d(share[:, 0], share[:, 1], bins=2, range=[[0, 1], [0, 1]])[0]
    assert quarters.min() > 0.15 * len(poses)
    headings = np.histogram([pose.yaw for pose in poses], bins=4, range=(0, math.tau))[0]
    assert headings.min() > 0.15 * len(poses)


def test_an_apartment_the_episode_does_not_play_in_is_refused():
    with pytest.raises(PerdureError, match="set_table/val/000 does not play in macro2_micro18"):
        start_pose(make_apartment(2, 18), episode(), 100)
