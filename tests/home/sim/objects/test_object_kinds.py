"""The objects against the YCB table, and the bodies MuJoCo makes of them."""

import subprocess
import sys

import numpy as np
import pytest
from object_scene import colliding_corners, run, scene, turned

from perdure.errors import PerdureError
from perdure.home.sim.geoms import OBJECT_BIT
from perdure.home.sim.objects import KINDS, get_kind
from perdure.home.tasks.tasks import TASKS

TABLE = {  # full sizes in millimeters (YCB models' bounding boxes; 008, 009 and 013 as measured), mass in grams
    "002_master_chef_can": (102.4, 102.4, 140.1, 414),
    "003_cracker_box": (71.7, 164.0, 213.5, 411),
    "004_sugar_box": (49.5, 94.0, 176.0, 514),
    "005_tomato_soup_can": (67.9, 67.9, 102.0, 349),
    "007_tuna_fish_can": (85.6, 85.6, 33.5, 171),
    "008_pudding_box": (110, 89, 35, 187),
    "009_gelatin_box": (85, 73, 28, 97),
    "010_potted_meat_can": (102.1, 60.3, 83.6, 370),
    "024_bowl": (161.4, 161.4, 55.0, 147),
    "013_apple": (75, 75, 75, 68),
}


@pytest.fixture(scope="module", params=sorted(TABLE))
def kind(request):
    return request.param


def compiled(kind, visuals=True, quaternion=(0.6, 0.0, 0.8, 0.0)):
    return scene({"it": (kind, (0.3, -0.2, 0.5), quaternion)}, visuals=visuals)


def test_there_are_the_ten_kinds_the_tasks_ask_for():
    rules = [r for t in TASKS.values() for r in (*(x.start for x in t.targets), *(rule for _, rule in t.clutter))]
    assert {kind for rule in rules for kind in rule.objects} == set(KINDS) == set(TABLE)
    assert {name for name, kind in KINDS.items() if kind.cylinder} == {
        n for n in TABLE if n[:3] in ("002", "005", "007")
    }


def test_sizes_and_masses_are_those_of_the_ycb_table(kind):
    *size, mass = TABLE[kind]
    record = get_kind(kind)
    np.testing.assert_allclose(np.array(record.size) * 1e3, size, atol=1e-9)
    model, _ = compiled(kind)
    assert model.body("it").mass[0] * 1e3 == pytest.approx(mass)
    assert record.source


def test_what_collides_fills_the_bounding_box_and_no_more(kind):
    low, high = colliding_corners(compiled(kind)[0], "it")
    half = np.array(KINDS[kind].half)
    np.testing.assert_allclose(low, -half, atol=2e-6)
    np.testing.assert_allclose(high, half, atol=2e-6)


def test_frame_is_where_it_was_asked_for_and_the_mass_is_at_its_middle(kind):
    """MuJoCo puts an inertia whose frame is left open at the body's own pose, far from the object."""
    import mujoco

    model, data = compiled(kind)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("it").xpos, (0.3, -0.2, 0.5))
    np.testing.assert_allclose(data.body("it").xquat, (0.6, 0.0, 0.8, 0.0))
    np.testing.assert_allclose(data.body("it").xipos, data.body("it").xpos, atol=1e-12)
    np.testing.assert_allclose(data.body("it").ximat, data.body("it").xmat, atol=1e-9)
    assert model.joint("it/free").type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert model.geom("it/0").bodyid[0] == model.body("it").id


def test_moments_of_inertia_are_those_of_a_full_body(kind):
    """As MuJoCo finds them for one geom of the object's outer shape (010's box: its edges hold little mass)."""
    import mujoco

    if kind == "024_bowl":
        pytest.skip("a bowl is not full")
    x, y, z = (size / 2e3 for size in TABLE[kind][:3])
    types = mujoco.mjtGeom
    shape, size = types.mjGEOM_BOX, (x, y, z)
    if kind[:3] in ("002", "005", "007"):
        shape, size = types.mjGEOM_CYLINDER, (x, z, 0.0)
    elif kind == "013_apple":
        shape, size = types.mjGEOM_SPHERE, (x, 0.0, 0.0)
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="full").add_geom(type=shape, size=size, mass=TABLE[kind][3] / 1e3)
    expected = np.sort(spec.compile().body("full").inertia)
    np.testing.assert_allclose(np.sort(compiled(kind)[0].body("it").inertia), expected, rtol=1e-9)


def test_moments_of_the_bowl_are_those_of_points_spread_over_a_spherical_cap():
    height = 0.055
    radius = (0.0807**2 + height**2) / (2 * height)
    assert np.hypot(radius - height, 0.0807) == pytest.approx(radius)  # the rim lies on the sphere
    rng = np.random.default_rng(0)
    points = rng.normal(size=(400_000, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points[:, 2] < height - radius]
    assert points[:, 2].mean() + radius == pytest.approx(height / 2, rel=0.01)  # the center of mass is half way up
    x, y, z = (points - points.mean(axis=0)).T
    expected = 0.147 * np.array([(y**2 + z**2).mean(), (x**2 + z**2).mean(), (x**2 + y**2).mean()])
    np.testing.assert_allclose(compiled("024_bowl")[0].body("it").inertia, expected, rtol=0.02)


def test_visuals_change_no_physics(kind):
    quaternion = turned(0.3, (0.6, 0.8, 0.0))
    paths = []
    for visuals in (False, True):
        model, data = scene({"it": (kind, (0.0, 0.0, 0.25), quaternion)}, visuals=visuals)
        body = model.body("it")
        geoms = [model.geom(body.geomadr[0] + k) for k in range(body.geomnum[0])]
        assert [geom.name for geom in geoms] == [f"it/{k}" for k in range(len(geoms))]
        for geom in geoms:
            collides = (geom.contype[0], geom.conaffinity[0])
            assert collides == ((0, 0) if geom.group[0] == 2 else (1 | OBJECT_BIT,) * 2)
            assert geom.group[0] in ((0, 2, 3) if visuals else (0,))
        run(model, data, 0.8)
        paths.append(data.qpos.copy())
        assert len(geoms) > 1 or not visuals
    np.testing.assert_allclose(*paths, atol=1e-4)  # the solver stops where it is near enough, not at the same number


def test_the_same_kind_can_be_added_many_times():
    once = {kind: (kind, (0.3 * k - 1.5, 0.0, 0.2), (1, 0, 0, 0)) for k, kind in enumerate(KINDS)}
    twice = once | {f"another_{kind}": once[kind] for kind in KINDS}
    first, second = scene(once, visuals=True)[0], scene(twice, visuals=True)[0]
    assert (first.nbody, second.nbody) == (11, 21)
    assert first.nmesh == second.nmesh


def test_an_unknown_kind_is_refused_with_the_known_ones():
    with pytest.raises(PerdureError, match="no object is named '011_banana'; there are 002_master_chef_can, 003"):
        get_kind("011_banana")


def test_importing_the_objects_does_not_import_mujoco():
    code = "import sys, perdure.home.sim.objects; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
