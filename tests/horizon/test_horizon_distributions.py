"""Laws of the training horizon against known values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonDistribution, Infinite, Uniform


def test_each_horizon_of_a_uniform_law_owns_an_equal_share_of_the_unit_interval():
    # 801 horizons: the middle of the k-th of 801 equal parts must give 200 + k.
    middles = (np.arange(801) + 0.5) / 801
    assert np.array_equal(Uniform(200, 1000).from_uniform(middles), np.arange(200, 1001))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("low", "high"), [(1, 1), (1, 2), (200, 1000), (1, 65_536), (3, 99_999)])
def test_a_uniform_law_reaches_both_ends_and_never_beyond(low, high, dtype):
    distribution = Uniform(low, high)
    ends = np.array([0, np.nextafter(dtype(1), dtype(0))], dtype)
    assert distribution.from_uniform(ends).tolist() == [low, high]


def test_uniform_draws_have_the_moments_of_the_discrete_uniform_distribution():
    horizons = Uniform(200, 1000).from_uniform(np.random.default_rng(3).random(400_000))
    variance = (801**2 - 1) / 12
    assert abs(horizons.mean() - 600) < 4 * np.sqrt(variance / 400_000)
    assert horizons.var() == pytest.approx(variance, rel=0.01)
    for end in (200, 1000):  # 400,000 / 801 = 499 of each, standard deviation 22
        assert 400 < (horizons == end).sum() < 600


def test_a_fixed_law_is_always_the_same_and_an_infinite_one_never_ends():
    u = np.random.default_rng(4).random((2, 3))
    assert np.array_equal(Fixed(7).from_uniform(u), np.full((2, 3), 7.0))
    assert np.array_equal(Infinite().from_uniform(u), np.full((2, 3), np.inf))


@pytest.mark.parametrize("distribution", [Fixed(1000), Uniform(200, 1000), Infinite()], ids=str)
@pytest.mark.parametrize("x64", [False, True])
def test_jax_draws_what_numpy_draws_under_jit(distribution, x64):
    with jax.enable_x64(x64):
        u = jax.random.uniform(jax.random.key(5), (2000,), jnp.float64 if x64 else jnp.float32)
        traced = np.asarray(jax.jit(distribution.from_uniform)(u))
        assert traced.dtype == u.dtype
        assert np.array_equal(traced, distribution.from_uniform(np.asarray(u)))


def test_the_longest_horizon_is_known():
    assert [distribution.longest for distribution in (Fixed(30), Uniform(2, 9), Infinite())] == [30, 9, np.inf]


def test_a_shortest_horizon_above_the_longest_is_refused():
    with pytest.raises(PerdureError, match=r"1000.*200"):
        Uniform(1000, 200)


@pytest.mark.parametrize("steps", [0, -3, 1.5, 1e3, float("nan"), float("inf")])
def test_horizons_that_are_no_whole_steps_are_refused(steps):
    with pytest.raises(PerdureError, match=f"got {steps}"):
        Fixed(steps)
    with pytest.raises(PerdureError, match="whole number"):
        Uniform(steps, 1000)
    with pytest.raises(PerdureError, match="whole number"):
        Uniform(1, steps)


@pytest.mark.parametrize("distribution", [Fixed(1000), Uniform(200, 1000), Infinite()], ids=str)
def test_a_law_survives_json(distribution):
    assert HorizonDistribution.from_json(distribution.to_json()) == distribution
