"""Embeddings against numbers worked out by hand, at their edges, and NumPy against JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Geometric, Linear, Periodic, TimeFeature, geometric_size

INF = np.inf
SHARES = [Linear(), Geometric(5), Geometric(10), Geometric(4, low=0.0, high=1.0)]
EMBEDDINGS = [*SHARES, TimeFeature(1000)]
steps = st.integers(0, 200_000)


def phi(embedding, elapsed, horizon):
    return embedding(np.asarray(elapsed, float), np.asarray(horizon, float))


def test_linear_is_the_share_that_is_left():
    share = phi(Linear(), [0, 250, 999, 1000], [1000, 1000, 1000, 1000])
    np.testing.assert_allclose(share, [[1.0], [0.75], [0.001], [0.0]], atol=1e-15)


def test_geometric_counts_halvings():
    coins = Geometric(2, low=0.5, high=1.0)
    assert phi(coins, [0, 1, 2, 3], [3, 3, 3, 3]).tolist() == [[1 / 8, 1], [1 / 4, 1], [1 / 2, 1], [1, 1]]


def test_the_smallest_factor_of_the_thesis_shrinks_by_1_percent_a_step():
    # 0.99^100 = 0.366032341273 and 0.99^1000 = 4.3171247410658e-05, from tables.
    first = phi(Geometric(10), [900, 0], [1000, 1000])[:, 0]
    np.testing.assert_allclose(first, [0.366032341273, 4.3171247410658e-05], rtol=1e-11)


def test_factors_are_evenly_spaced_with_both_ends():
    thousandths = [0.990, 0.991, 0.992, 0.993, 0.994, 0.995, 0.996, 0.997, 0.998, 0.999, 1.0]
    np.testing.assert_allclose(Geometric(11).factors, thousandths, atol=1e-15)


@pytest.mark.parametrize(("elapsed", "horizon"), [(0, 0), (7, 7), (8, 7), (5, 0), (100_000, 1000)])
def test_nothing_left_is_0_for_linear_and_all_ones_for_geometric(elapsed, horizon):
    assert phi(Linear(), [elapsed], [horizon]).tolist() == [[0.0]]
    assert phi(Geometric(3), [elapsed], [horizon]).tolist() == [[1.0, 1.0, 1.0]]


@pytest.mark.parametrize("elapsed", [0, 1, 100_000])
def test_an_infinite_horizon_is_1_for_linear_and_leaves_geometric_its_constant(elapsed):
    assert phi(Linear(), [elapsed], [INF]).tolist() == [[1.0]]
    assert phi(Geometric(3), [elapsed], [INF]).tolist() == [[0.0, 0.0, 1.0]]
    assert phi(Geometric(2, high=0.999), [elapsed], [INF]).tolist() == [[0.0, 0.0]]


def test_a_factor_of_zero_is_one_only_at_the_end():
    assert phi(Geometric(2, low=0.0), [0, 3, 4], [4, 4, 4]).tolist() == [[0.0, 1.0], [0.0, 1.0], [1.0, 1.0]]


@given(steps, steps, steps)
def test_geometric_depends_on_the_time_to_go_only(elapsed, to_go, later):
    embedding = Geometric(10)
    now = phi(embedding, [elapsed], [elapsed + to_go])
    assert np.array_equal(now, phi(embedding, [elapsed + later], [elapsed + later + to_go]))


@given(st.integers(0, 1000), st.integers(1, 1000), st.integers(1, 100))
def test_linear_depends_on_the_ratio_only(elapsed, horizon, times):
    now = phi(Linear(), [elapsed], [horizon])
    np.testing.assert_allclose(phi(Linear(), [elapsed * times], [horizon * times]), now, atol=1e-15)


def test_at_the_start_geometric_tells_horizons_apart_and_linear_does_not():
    starts, horizons = [0, 0], [200, 1000]
    linear, geometric = phi(Linear(), starts, horizons), phi(Geometric(10), starts, horizons)
    assert linear[0] == linear[1]
    assert np.abs(geometric[0] - geometric[1]).max() > 0.3


@pytest.mark.parametrize("size", [1, 2, 5, 10])
@pytest.mark.parametrize("rows", [2, 3, 8, 17])
def test_small_whole_steps_to_go_give_the_same_bits_alone_and_in_company(size, rows):
    """NumPy squares by another way than it raises to the power of 2, depending on the shapes that meet."""
    for left in range(6):
        together = Geometric(size)(np.zeros(rows), np.full(rows, float(left)))
        np.testing.assert_array_equal(together, np.tile(Geometric(size)(0.0, float(left)), (rows, 1)))


@pytest.mark.parametrize("embedding", SHARES, ids=str)
@given(elapsed=steps, horizon=st.one_of(steps, st.just(INF)))
def test_every_component_lies_between_0_and_1(embedding, elapsed, horizon):
    values = phi(embedding, [elapsed], [horizon])
    assert values.shape == (1, embedding.size)
    assert np.all((values >= 0) & (values <= 1))


@pytest.mark.parametrize("embedding", EMBEDDINGS, ids=str)
def test_a_row_does_not_depend_on_its_neighbors(embedding):
    random = np.random.default_rng(1)
    elapsed, horizon = random.integers(0, 3000, 257).astype(float), random.integers(0, 3000, 257).astype(float)
    whole = phi(embedding, elapsed, horizon)
    for size in (1, 2, 3, 31, 200):
        rows = random.choice(257, size, replace=False)
        assert np.array_equal(phi(embedding, elapsed[rows], horizon[rows]), whole[rows])


@pytest.mark.parametrize("embedding", EMBEDDINGS, ids=str)
def test_python_numbers_integers_and_batches_of_any_shape_are_served(embedding):
    expected = phi(embedding, [3.0], [8.0])[0]
    assert np.array_equal(embedding(3, 8), expected)
    assert np.array_equal(embedding(np.int64(3), np.float64(8)), expected)
    grid = embedding(np.full((2, 4), 3), np.full((2, 4), 8))
    assert grid.shape == (2, 4, embedding.size)
    assert np.array_equal(grid[1, 2], expected)


@pytest.mark.parametrize("embedding", EMBEDDINGS, ids=str)
@pytest.mark.parametrize(("x64", "tolerance"), [(False, 1e-5), (True, 1e-12)])
def test_jax_agrees_with_numpy_under_jit(embedding, x64, tolerance):
    random = np.random.default_rng(2)
    elapsed = np.concatenate([random.integers(0, 2000, 300), [0, 0, 5, 9, 100_000]]).astype(float)
    horizon = np.concatenate([random.integers(0, 2000, 300), [0, INF, INF, 9, 1000]]).astype(float)
    with jax.enable_x64(x64):
        dtype = jnp.float64 if x64 else jnp.float32
        traced = jax.jit(embedding)(jnp.asarray(elapsed, dtype), jnp.asarray(horizon, dtype))
    assert traced.dtype == dtype
    np.testing.assert_allclose(np.asarray(traced, np.float64), phi(embedding, elapsed, horizon), rtol=0, atol=tolerance)


def test_one_embedding_serves_programs_of_both_precisions_in_one_process():
    embedding = Geometric(3)
    for x64 in (False, True, False):
        with jax.enable_x64(x64):
            traced = jax.jit(embedding)(jnp.zeros(2), jnp.full(2, 100.0))
        np.testing.assert_allclose(np.asarray(traced)[:, 0], 0.366032341273, atol=1e-6)


@pytest.mark.parametrize(
    ("task", "observation_size", "size"),
    [
        ("Hopper-v3", 11, 5),
        ("HalfCheetah-v3", 17, 10),
        ("Walker2d-v3", 17, 10),
        ("Ant-v3", 111, 10),
        ("Humanoid-v3", 376, 10),
        ("Swimmer-v3", 8, 10),  # the text of the thesis, against its own rule
        ("gymnasium:Swimmer-v5", 8, 10),
        (None, 8, 5),
        (None, 15, 5),  # 10 < 2 * 15 / 3 is false
        (None, 16, 10),
    ],
)
def test_the_sizes_are_those_of_the_thesis(task, observation_size, size):
    assert geometric_size(observation_size, task) == size


@pytest.mark.parametrize("size", [0, -1, 2.5, "ten"])
def test_a_geometric_embedding_without_whole_components_is_refused(size):
    with pytest.raises(PerdureError, match=f"got {size!r}"):
        Geometric(size)


@pytest.mark.parametrize(("low", "high"), [(-0.1, 1.0), (0.99, 1.01), (1.0, 0.99), (float("nan"), 1.0)])
def test_factors_outside_0_and_1_are_refused(low, high):
    with pytest.raises(PerdureError, match="low <= high"):
        Geometric(3, low, high)


TIME_FEATURES = {
    Countdown(1000): [1.0, 0.75, 0.0, -1.0, -99.0],
    Constant(1000): [1.0, 1.0, 1.0, 1.0, 1.0],
    Constant(250): [0.25, 0.25, 0.25, 0.25, 0.25],
    Constant(0): [0.0, 0.0, 0.0, 0.0, 0.0],
    Constant(5000): [1.0, 1.0, 1.0, 1.0, 1.0],
    Periodic(1000): [1.0, 0.75, 1.0, 1.0, 1.0],
    Periodic(500): [0.5, 0.25, 0.5, 0.5, 0.5],
    Countdown(100_000): [1.0, 1.0, 1.0, 1.0, 0.0],
    Countdown(INF): [1.0, 1.0, 1.0, 1.0, 1.0],
}


@pytest.mark.parametrize("clock", TIME_FEATURES, ids=lambda clock: clock.label)
def test_the_time_feature_of_1000_steps_under_every_clock(clock):
    elapsed = np.array([0.0, 250.0, 1000.0, 2000.0, 100_000.0])
    assert TimeFeature(1000)(*clock.time(elapsed))[:, 0].tolist() == TIME_FEATURES[clock]


@given(st.integers(1, 3000), st.integers(0, 10_000))
def test_the_time_feature_is_that_of_the_wrapper_to_the_last_bit(horizon, elapsed):
    """`1 - (self._current_step / self._max_steps)` in sb3-contrib 2.9."""
    assert phi(TimeFeature(horizon), [elapsed], [horizon])[0, 0] == 1 - elapsed / horizon


@pytest.mark.parametrize("bad", [0, -1, 2.5])
def test_a_time_feature_of_no_steps_is_refused(bad):
    with pytest.raises(PerdureError, match=f"got {bad}"):
        TimeFeature(bad)
