"""What stands around a target, against what the grasp then takes."""

import numpy as np
from test_world import begin

from perdure.home.sim.hand import GRASP_RADIUS
from perdure.home.sim.sensors import NEIGHBORHOOD, look_around
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import load_episodes


def found_around(lane, target, gripper):
    """In the middle of three lanes, the others being elsewhere: what is found must not depend on them."""
    targets, grippers = np.array([0, target, -1]), np.stack([0 * gripper, gripper, 0 * gripper])
    all_of_them = [row[1] for row in look_around([lane] * 3, targets, grippers, np.ones(3, dtype=bool))]
    alone = [row[1] for row in look_around([lane] * 3, targets, grippers, np.array([False, True, False]))]
    assert all(np.array_equal(*pair) for pair in zip(all_of_them, alone, strict=True))
    return alone


def test_the_distances_foretell_what_the_grasp_takes():
    """Gripper points strewn around the objects of cluttered rooms: the grasp itself says who was nearest."""
    world, rng, outcomes = VectorSimulator(1), np.random.default_rng(0), set()
    for episode in load_episodes("prepare_groceries", "val").episodes[:6]:
        scene = begin(world, 0, episode)
        lane = world.simulator(0)
        for _ in range(60):
            target = int(rng.integers(len(scene.placements)))
            near = lane.handles
            around = near[rng.integers(len(near))] if rng.random() < 0.3 else lane.middles[target]
            point = around + rng.normal(0.0, 0.08, 3)
            _, other, handle = found_around(lane, target, point)
            mine = float(np.linalg.norm(lane.middles[target] - point))
            lane.hand.grasp(point, np.eye(3), near, lane.middles)
            took_link, took = lane.held_link >= 0, lane.held
            world.reset(0, scene, world._starts[0][0])
            assert took_link == (handle <= GRASP_RADIUS)
            if not took_link:
                wins = mine <= GRASP_RADIUS and mine < other
                assert (took == target) == wins
                assert (took < 0) == (min(mine, other) > GRASP_RADIUS)
            outcomes.add("link" if took_link else "nothing" if took < 0 else "target" if took == target else "other")
    assert outcomes == {"link", "nothing", "target", "other"}


def test_neighbors_are_the_nearest_ones_and_only_near_ones():
    world = VectorSimulator(1)
    begin(world, 0, load_episodes("tidy_house", "val").episodes[0])
    lane = world.simulator(0)
    middles = lane.middles
    for target in range(len(middles)):
        found, _, _ = found_around(lane, target, np.zeros(3))
        away = sorted(
            (float(np.linalg.norm(each - middles[target])), k) for k, each in enumerate(middles) if k != target
        )
        for (distance, number), vector in zip(away[:2], found, strict=True):
            wanted = middles[number] - middles[target] if distance <= NEIGHBORHOOD else np.zeros(3)
            np.testing.assert_allclose(vector, wanted, atol=1e-12)
