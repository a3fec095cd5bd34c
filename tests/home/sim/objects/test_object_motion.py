"""How the objects tip, roll and hold each other, against angles and distances worked out by hand."""

import math

import numpy as np
import pytest
from object_scene import ELLIPTIC, rotation, run, scene, turned, uprightness

from perdure.home.sim.objects import KINDS

# atan(half short side / half height) in degrees, from the sizes; the axis is the one about which it tips
TIPS = {
    "002_master_chef_can": (36.2, (1, 0, 0)),
    "003_cracker_box": (18.6, (0, 1, 0)),
    "004_sugar_box": (15.7, (0, 1, 0)),
    "005_tomato_soup_can": (33.6, (1, 0, 0)),
    "007_tuna_fish_can": (68.6, (1, 0, 0)),
    "010_potted_meat_can": (35.8, (1, 0, 0)),
}


def on_its_edge(kind, degrees, axis):
    """Height and attitude of an object that balances on the table, tilted about an axis of its own."""
    quaternion = turned(math.radians(degrees), axis)
    x, y, z = KINDS[kind].half
    lever = (x if axis == (0, 1, 0) else y) * math.sin(math.radians(degrees))
    return (0.0, 0.0, lever + z * math.cos(math.radians(degrees))), quaternion


@pytest.mark.parametrize("timestep", [1 / 120, 1 / 240])
@pytest.mark.parametrize("kind", sorted(TIPS))
def test_let_go_on_its_edge_it_returns_below_the_tip_angle_and_falls_above(kind, timestep):
    angle, axis = TIPS[kind]
    ends = []
    for degrees in (angle - 2.0, angle + 2.0):
        model, data = scene({"it": (kind, *on_its_edge(kind, degrees, axis))}, timestep)
        run(model, data, 3.0)
        ends.append(uprightness(data, "it"))
    assert ends[0] == pytest.approx(1.0, abs=1e-3)
    assert ends[1] < 0.5


def roll(kind, heading, timestep=1 / 240, cone=ELLIPTIC, speed=0.3, rolling=None):
    """Distance in [m] that a round object lying on its side goes at a speed in [m/s], and whether it sleeps then."""
    radius = KINDS[kind].half[0]
    lying = (1.0, 0.0, 0.0, 0.0) if KINDS[kind].shape == "sphere" else turned(math.pi / 2, (1, 0, 0))
    half = heading / 2
    a, b, c, d = lying
    cos, sin = math.cos(half), math.sin(half)
    quaternion = (cos * a - sin * d, cos * b - sin * c, cos * c + sin * b, cos * d + sin * a)
    model, data = scene({"it": (kind, (0.0, 0.0, radius), quaternion)}, timestep, cone=cone)
    if rolling is not None:
        model.geom_friction[:, 2] = rolling
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    data.qvel[:3] = speed * ahead
    data.qvel[3:] = rotation(quaternion).T @ np.cross((0.0, 0.0, 1.0), ahead) * speed / radius
    run(model, data, 10.0)
    return float(data.qpos[:3] @ ahead), data.ntree_awake == 0


@pytest.mark.parametrize("timestep", [1 / 120, 1 / 240])
@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_apple_at_0_3_meters_a_second_rolls_as_far_as_its_energy_carries_it(heading, timestep):
    """7/10 m v^2 = friction x weight x distance / radius: 0.3 m/s and 1.2 mm carry a 75 mm apple 0.20 m."""
    distance, asleep = roll("013_apple", heading, timestep)
    assert distance == pytest.approx(0.201, rel=0.03)
    assert asleep
    assert roll("013_apple", heading, timestep, speed=0.6)[0] == pytest.approx(0.803, rel=0.03)


@pytest.mark.parametrize(("kind", "expected"), [("002_master_chef_can", 0.294), ("005_tomato_soup_can", 0.195)])
def test_a_can_on_its_side_rolls_as_far_as_its_energy_carries_it(kind, expected):
    """3/4 m v^2 = friction x weight x distance / radius."""
    distance, asleep = roll(kind, 0.7)
    assert distance == pytest.approx(expected, rel=0.05)
    assert asleep


@pytest.mark.parametrize("kind", ["013_apple", "002_master_chef_can", "005_tomato_soup_can"])
def test_with_pyramidal_friction_cones_round_things_roll_no_more_than_half_as_far_again(kind):
    """MuJoCo's default cones resist less across their corners; the distances stay what a home would call rolling."""
    distances = [roll(kind, heading, cone=0)[0] for heading in (0.0, 0.7)]
    straight = roll(kind, 0.0)[0]
    assert straight * 0.95 < min(distances)
    assert max(distances) < 1.6 * straight
    assert max(distances) < 1.1


def test_without_rolling_friction_the_apple_would_roll_on():
    distance, asleep = roll("013_apple", 0.0, rolling=0.0)
    assert distance > 1.5
    assert not asleep


def test_a_soup_can_let_go_while_moving_tips_and_rolls_and_comes_to_rest():
    """Put down on its edge beyond 33.6 degrees and pushed, it falls on its side; nobody else moves it."""
    position, quaternion = on_its_edge("005_tomato_soup_can", 40.0, (1, 0, 0))
    model, data = scene({"it": ("005_tomato_soup_can", position, quaternion)}, cone=ELLIPTIC)
    data.qvel[:2] = (0.2, -0.2)
    run(model, data, 8.0)
    assert uprightness(data, "it") == pytest.approx(0.0, abs=0.02)
    assert 0.03 < np.linalg.norm(data.qpos[:2]) < 2.0
    assert data.ntree_awake == 0


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_a_bowl_holds_an_apple_dropped_into_it(offset):
    bowl, apple = KINDS["024_bowl"].half[2], KINDS["013_apple"].half[2]
    level = (1.0, 0.0, 0.0, 0.0)
    placed = {
        "bowl": ("024_bowl", (0.0, 0.0, bowl), level),
        "apple": ("013_apple", (offset, 0.0, 2 * bowl + apple + 0.05), level),
        "other": ("013_apple", (0.0, 0.3, 2 * bowl + apple + 0.05), level),
    }
    model, data = scene(placed)
    run(model, data, 4.0)
    apart = data.body("apple").xpos - data.body("bowl").xpos
    assert np.linalg.norm(apart[:2]) < 0.02
    assert apart[2] == pytest.approx(0.006 + apple - bowl, abs=0.003)  # on the bowl's floor, which is 6 mm thick
    assert data.body("other").xpos[2] == pytest.approx(apple, abs=1e-3)
    assert data.ntree_awake == 0


@pytest.mark.parametrize("degrees", [20.0, 50.0, 75.0])
def test_a_tilted_bowl_rights_itself_and_one_upside_down_stays_so(degrees):
    """The center of mass of a spherical cap is below the middle of its sphere."""
    ends = []
    for tilt in (degrees, 180.0 - degrees / 4):
        quaternion = turned(math.radians(tilt), (0.8, 0.6, 0.0))
        model, data = scene({"it": ("024_bowl", (0.0, 0.0, 0.12), quaternion)})
        run(model, data, 3.0)
        ends.append(uprightness(data, "it"))
        assert data.ntree_awake == 0
    assert ends == pytest.approx([1.0, -1.0], abs=1e-3)


def test_the_object_decides_how_it_slides():
    """Sliding friction 0.3 stops 1 m/s after v^2 / (2 mu g) = 0.170 m; furniture has 0.2, which would be 0.255 m."""
    model, data = scene({"it": ("008_pudding_box", (0.0, 0.0, 0.0175), (1, 0, 0, 0))}, cone=ELLIPTIC)
    data.qvel[0] = 1.0
    run(model, data, 2.0)
    assert data.qpos[0] == pytest.approx(0.170, rel=0.05)
