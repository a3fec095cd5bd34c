"""Policies multiply on one thread, whatever the process is set to."""

import os
import subprocess
import sys

import pytest

from perdure.policy.network import _libraries, one_thread

ACTS = """
import hashlib
import numpy as np
from perdure.policy.network import Perceptron

rng = np.random.default_rng(0)
sizes = (50, 256, 256, 11)
weights = {}
for layer, shape in enumerate(zip(sizes, sizes[1:])):
    weights[f"policy.{layer}.weight"] = rng.standard_normal(shape).astype(np.float32)
    weights[f"policy.{layer}.bias"] = rng.standard_normal(shape[1]).astype(np.float32)
rows = rng.standard_normal((48, 50)).astype(np.float32)
plain = (rows.reshape(-1, 16, 50) @ weights["policy.0.weight"]) @ weights["policy.1.weight"]
for result in (Perceptron(weights, "policy", "tanh")(rows), plain):
    print(hashlib.sha256(result.tobytes()).hexdigest())
"""


def acts(threads):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    done = subprocess.run([sys.executable, "-c", ACTS], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core: the library has no second thread to use")
def test_what_a_policy_does_does_not_depend_on_how_many_threads_multiply():
    alone, together = acts(1), acts(2)
    assert alone[0] == together[0]
    if alone[1] == together[1]:
        pytest.skip("on this machine NumPy's own product does not depend on it either: nothing is shown")


def test_the_number_of_threads_is_put_back():
    before = threads_now()
    try:
        with one_thread():
            assert set(threads_now()) == {1}
            raise ZeroDivisionError
    except ZeroDivisionError:
        assert threads_now() == before


def threads_now():
    # Not of libraries that were loaded since the first look, such as SciPy's own: NumPy does not multiply with them.
    return [library.get_num_threads() for library in _libraries()]
