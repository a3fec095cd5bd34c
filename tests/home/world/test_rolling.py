"""What stops an object that rolls: friction, or a drag alone as in Habitat."""

import numpy as np
import pytest

from perdure.home.episodes import Placement
from perdure.home.errors import HomeError
from perdure.home.layouts import Pose
from perdure.home.world import SceneOptions, World, build_scene
from perdure.home.world.scene import HABITAT_DRAG

RADIUS, SPEED, SECONDS = 0.0375, 0.3, 2.0


def rolled(empty_room, **options):
    """How far an apple rolls that is sent off over the floor of an empty room."""
    bare, middle, _ = empty_room
    x, y = map(float, middle)
    apple = Placement("013_apple", (x, y, RADIUS), (1.0, 0.0, 0.0, 0.0), "floor")
    world = World(1)
    world.reset(0, build_scene(bare, [apple], options=SceneOptions(**options)), Pose(x - 1.5, y, np.pi))
    lane = world.lane(0)
    speed = lane.scene.object_qvel[0]
    lane.qvel[speed], lane.qvel[speed + 4] = SPEED, SPEED / RADIUS
    for _ in range(int(30 * SECONDS)):
        world.step(np.zeros((1, 11)))
    return float(lane.object(0)[0][0]) - x


def test_with_a_drag_alone_speed_decays_as_its_equation_says(empty_room):
    """Linear and angular damping at one rate slow a rolling ball at that rate: v(t) = v(0) exp(-c t)."""
    wanted = SPEED / HABITAT_DRAG * (1.0 - np.exp(-HABITAT_DRAG * SECONDS))
    assert rolled(empty_room, rolling="drag") == pytest.approx(wanted, rel=0.01)


def test_with_friction_it_stops_after_a_hand(empty_room):
    """0.7 v^2 r / (mu g), the kinetic energy over the friction; the negative control of the drag."""
    assert rolled(empty_room) == pytest.approx(0.7 * SPEED**2 * RADIUS / (1.2e-3 * 9.81), rel=0.05)


def test_an_unknown_way_of_rolling_is_refused():
    with pytest.raises(HomeError, match="rolling must be one of friction, drag, not 'ice'"):
        SceneOptions(rolling="ice")
