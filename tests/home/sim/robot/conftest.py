import mujoco
import numpy as np
import pytest
from fetch_scenes import make_spec

from perdure.home.sim.robot import add_fetch


@pytest.fixture(scope="session")
def model():
    """The robot alone, with visuals."""
    spec = make_spec()
    add_fetch(spec)
    return spec.compile()


@pytest.fixture
def data(model):
    return mujoco.MjData(model)


@pytest.fixture(scope="session")
def random_arms():
    """Two hundred arms within the limits, shape (200, 7)."""
    low = [-1.6056, -1.221, -np.pi, -2.251, -np.pi, -2.16, -np.pi]
    high = [1.6056, 1.518, np.pi, 2.251, np.pi, 2.16, np.pi]
    return np.random.default_rng(7).uniform(low, high, (200, 7))
