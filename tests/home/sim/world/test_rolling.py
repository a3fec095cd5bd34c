"""Worlds: what stops an object that rolls, what shape an apple has."""

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.scene import HABITAT_DRAG, SceneOptions, build_scene
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator

RADIUS, SPEED, SECONDS = 0.0375, 0.3, 2.0


def rolled(empty_room, at=SPEED, impratio=None, **options):
    """How far an apple rolls that is sent off at a speed over the floor of an empty room."""
    bare, middle, _ = empty_room
    x, y = map(float, middle)
    apple = Placement("013_apple", (x, y, RADIUS), (1.0, 0.0, 0.0, 0.0), "floor")
    world = VectorSimulator(1)
    world.reset(0, build_scene(bare, [apple], options=SceneOptions(**options)), Pose(x - 1.5, y, np.pi))
    lane = world.simulator(0)
    lane.model.opt.impratio = impratio or lane.model.opt.impratio
    speed = lane.scene.object_qvel[0]
    lane.qvel[speed], lane.qvel[speed + 4] = at, at / RADIUS
    for _ in range(int(30 * SECONDS)):
        world.step(np.zeros((1, 11)))
    return float(lane.object(0)[0][0]) - x


def test_with_a_drag_alone_speed_decays_as_its_equation_says(empty_room):
    """Linear and angular damping at one rate slow a rolling ball at that rate: v(t) = v(0) exp(-c t)."""
    wanted = SPEED / HABITAT_DRAG * (1.0 - np.exp(-HABITAT_DRAG * SECONDS))
    assert rolled(empty_room, rolling=0.0) == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize(("speed", "lever"), [(0.3, 1.2e-3), (0.3, 8e-4), (0.1, 1.2e-3), (0.05, 4e-4), (0.03, 1e-4)])
def test_with_friction_it_stops_after_its_lever_arm_says(empty_room, speed, lever):
    """0.7 v^2 r / (lever arm x g), the kinetic energy over the friction; the negative control of the drag."""
    wanted = 0.7 * speed**2 * RADIUS / (lever * 9.81)
    assert rolled(empty_room, speed, rolling=lever) == pytest.approx(wanted, rel=0.1)


def test_with_mujocos_usual_impratio_a_slow_apple_would_hardly_stop(empty_room):
    assert rolled(empty_room, 0.03, impratio=1.0, rolling=1e-4) > 2 * rolled(empty_room, 0.03, rolling=1e-4)


def test_a_simulator_changes_its_rolling_resistance_alone_and_back(empty_room):
    bare, middle, _ = empty_room
    lying = [Placement("013_apple", (*map(float, middle), RADIUS), (1.0, 0.0, 0.0, 0.0), "floor")]
    scene = build_scene(bare, lying)
    drag = Simulator(build_scene(bare, lying, options=SceneOptions(rolling=0.0))).model
    simulator, names = Simulator(scene), ("geom_condim", "geom_friction", "dof_damping")
    for lever, wanted in ((0.0, drag), (0.0004, None), (1.2e-3, scene.model)):
        simulator.set_rolling(lever)
        if wanted is not None:
            assert all(np.array_equal(getattr(simulator.model, each)[-1], getattr(wanted, each)[-1]) for each in names)
    assert all(np.array_equal(getattr(scene.model, each), getattr(simulator.model, each)) for each in names)
    assert not all(np.array_equal(getattr(scene.model, each), getattr(drag, each)) for each in names)


def test_the_drag_takes_a_fifth_of_the_speed_in_a_second():
    """Bullet applies a damping of 0.2 as v <- v (1 - 0.2)^dt."""
    assert np.exp(-HABITAT_DRAG) == pytest.approx(0.8)


def test_a_hull_comes_to_rest_on_a_face_where_a_sphere_rolls_on(empty_room):
    sphere, hull = (rolled(empty_room, rolling=0.0, apple=apple) for apple in ("sphere", "hull"))
    assert hull < 0.9 * sphere


@pytest.mark.parametrize(
    ("option", "value", "valid"),
    [("rolling", "drag", "a lever arm from 0 to 0.01 m"), ("rolling", 1.2, "0.01 m"), ("apple", "ice", "sphere, hull")],
)
def test_an_unknown_world_is_refused(option, value, valid):
    with pytest.raises(PerdureError, match=f"{option} must be .*{valid}, not {value!r}"):
        SceneOptions(**{option: value})
