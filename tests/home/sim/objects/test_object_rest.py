"""Coming to rest: each kind settles, falls asleep on furniture, and wakes when something happens to it."""

import numpy as np
import pytest
from object_scene import ELLIPTIC, box_clearance, run, scene, turned, uprightness

from perdure.home.sim.objects import KINDS

AXIS = (0.8, 0.6, 0.0)


def dropped(kind, tilt, height=0.08, **options):
    quaternion = turned(tilt, AXIS)
    return scene({"it": (kind, (0.0, 0.0, box_clearance(kind, quaternion) + height), quaternion)}, **options)


@pytest.mark.parametrize("cone", [0, ELLIPTIC])
@pytest.mark.parametrize("timestep", [1 / 120, 1 / 240])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_dropped_from_8_centimeters_and_a_little_tilted_it_stands_and_sleeps(kind, timestep, cone):
    model, data = dropped(kind, 0.15, timestep=timestep, cone=cone)
    run(model, data, 6.0)
    assert data.ntree_awake == 0
    assert np.linalg.norm(data.qpos[:2]) < 0.05
    assert data.qpos[2] == pytest.approx(KINDS[kind].half[2], abs=1e-3)
    if kind != "013_apple":
        assert uprightness(data, "it") == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("tilt", [0.6, 1.2, 2.0, 2.9])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_whichever_way_it_falls_it_sleeps_in_the_end(kind, tilt):
    model, data = dropped(kind, tilt, cone=ELLIPTIC)
    run(model, data, 6.0)
    assert data.ntree_awake == 0
    assert 0.0 < data.qpos[2] < max(KINDS[kind].half) + 1e-3


@pytest.mark.parametrize("timestep", [1 / 120, 1 / 240, 1 / 480])
@pytest.mark.parametrize(("kind", "safe"), [("003_cracker_box", 0.30), ("004_sugar_box", 0.25)])
def test_a_tall_box_dropped_from_10_centimeters_falls_beyond_its_tip_angle_only(kind, safe, timestep):
    """Tilted about its short side, where it tips from rest at 0.325 and 0.274 rad, at every physics step alike."""
    ends = []
    for tilt in (safe, 0.45):
        quaternion = turned(tilt, (0, 1, 0))
        model, data = scene({"it": (kind, (0, 0, box_clearance(kind, quaternion) + 0.1), quaternion)}, timestep)
        run(model, data, 4.0)
        ends.append(abs(uprightness(data, "it")))
    assert ends == pytest.approx([1.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_sleeper_wakes_when_it_is_put_elsewhere_and_falls(kind):
    model, data = dropped(kind, 0.0, height=0.0)
    run(model, data, 2.0)
    assert data.ntree_awake == 0
    data.qpos[:3] += (0.3, 0.1, 0.2)
    run(model, data, 0.05)
    assert data.ntree_awake == 1
    assert data.qpos[2] < KINDS[kind].half[2] + 0.195
    run(model, data, 3.0)
    assert data.qpos[2] == pytest.approx(KINDS[kind].half[2], abs=1e-3)
    assert data.ntree_awake == 0


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_sleeper_wakes_and_moves_when_it_is_hit(kind):
    half = KINDS[kind].half
    apart = half[0] + 0.0425 + 0.05
    level = (1.0, 0.0, 0.0, 0.0)
    placed = {
        "it": (kind, (0.0, 0.0, half[2]), level),
        "hitter": ("009_gelatin_box", (-apart, 0.0, 0.014), level),
    }
    model, data = scene(placed)
    run(model, data, 2.0)
    assert data.ntree_awake == 0
    data.joint("hitter/free").qvel[0] = 2.0
    run(model, data, 1 / 240)
    assert data.ntree_awake == 1  # only the one that was pushed
    run(model, data, 0.1)
    assert data.ntree_awake == 2
    run(model, data, 3.0)
    assert data.body("it").xpos[0] > 2e-3


def test_nothing_sleeps_unless_the_model_asks_for_it():
    model, data = dropped("009_gelatin_box", 0.0, sleep=False)
    run(model, data, 2.0)
    assert data.ntree_awake == 1
    assert data.ncon > 0
