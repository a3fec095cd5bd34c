"""Check what no change of the code may move: shipped policies, models of the home benchmark, 50 steps of evaluation.

The values are in `goldens/*.json`. To change them on purpose, run `python tests/test_goldens.py`.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perdure import extrapolate, load_policy
from perdure.home import get_task, load_episodes
from perdure.home.sim.scene import SceneOptions
from perdure.home.sim.simulator import Simulator
from perdure.home.tasks.episodes import episode_scene
from perdure.policy import shipped_policies

FOLDER = Path(__file__).parent / "goldens"
EVALUATED = {
    "Hopper-v3/geometric": "constant:500",
    "Hopper-v3/linear-random": "periodic:300",
    "Walker2d-v3/geometric": "countdown:1000",
    "Hopper-v3/ppo": None,
}
SCENES: dict[str, dict[str, Any]] = {
    "tidy_house": {},
    "prepare_groceries": {"clutter": False},
    "set_table": {},
    "set_table, drag": {"rolling": 0.0},
    "set_table, hull": {"apple": "hull"},
}
SIZES = ("nq", "nv", "nu", "nbody", "ngeom", "njnt", "neq", "nsite", "nmeshvert")
ARRAYS = (
    *("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "dof_damping", "dof_armature", "jnt_range"),
    *("jnt_pos", "jnt_axis", "geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_solref", "geom_margin"),
    *("geom_contype", "geom_conaffinity", "geom_condim", "eq_data", "eq_solref", "actuator_gainprm"),
    *("actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange", "site_pos", "qpos0"),
)


def actor_digests() -> dict[str, str]:
    """Return a digest of each shipped policy's actor and normalizer, whatever the names of its arrays."""
    return {name: _actor_digest(name) for name in shipped_policies()}


def _actor_digest(name: str) -> str:
    policy = load_policy(name)
    actor = [array for key, array in sorted(policy.weights.items()) if not key.startswith("value.")]
    digest = hashlib.sha256()
    for array in (*actor, policy.normalizer.mean, policy.normalizer.var):
        digest.update(f"{array.dtype.str} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:12]


def scene_numbers(name: str) -> dict[str, float]:
    """Return sizes of a scene's model, and a sum of each array in which every value has a weight of its own."""
    episode = load_episodes(get_task(name.partition(",")[0]).name, "val")[0]
    model = Simulator(episode_scene(episode, SceneOptions(**SCENES[name]))).model
    numbers = {each: int(getattr(model, each)) for each in SIZES}
    return numbers | {each: float(f"{_weighted(getattr(model, each)):.9g}") for each in ARRAYS}


def _weighted(array: Any) -> float:
    """Return a sum that changes with order and signs of the values, but in which nothing cancels."""
    values = np.asarray(array, dtype=float).ravel()
    return float((np.abs(values) + values / 2) @ (1.0 + np.arange(values.size) % 101 / 100))


def returns(name: str) -> list[float]:
    """Return what a policy earns in its first 50 steps from the start states 0 and 1."""
    result = extrapolate(name, steps=50, clocks=EVALUATED[name], eval_seeds=2, disturb="none", on="here")
    return [float(f"{value:.9g}") for value in result.final.sort("eval_seed")["return"]]


def _golden(name: str) -> Any:
    return json.loads((FOLDER / f"{name}.json").read_text())


def test_the_shipped_policies_have_the_same_weights():
    """Bit for bit: they are files."""
    assert actor_digests() == _golden("actors")


@pytest.mark.parametrize("name", SCENES)
def test_a_home_scene_compiles_to_the_same_model(name):
    """Up to the rounding of another processor."""
    assert scene_numbers(name) == pytest.approx(_golden("scenes")[name], rel=1e-6)


@pytest.mark.parametrize("name", EVALUATED)
def test_a_shipped_policy_earns_the_same(name):
    """For 50 steps; later, rounding errors of another processor have grown."""
    assert returns(name) == pytest.approx(_golden("returns")[name], rel=1e-6)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    made = {
        "actors": actor_digests(),
        "scenes": {each: scene_numbers(each) for each in SCENES},
        "returns": {each: returns(each) for each in EVALUATED},
    }
    for stem, content in made.items():
        (FOLDER / f"{stem}.json").write_text(json.dumps(content, indent=1) + "\n")
