"""What tests of several folders use."""

import os
import tempfile

import pytest

COMPILED = "JAX_COMPILATION_CACHE_DIR"


def pytest_configure(config):
    """Compile each program of JAX once for all test processes and the commands that they start."""
    if COMPILED not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="perdure-compiled-", ignore_cleanup_errors=True)
        config.add_cleanup(folder.cleanup)
        os.environ[COMPILED] = folder.name
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")


@pytest.fixture
def cluster():
    """A Ray cluster of two nodes on this machine. Its head has no cores: every unit runs on a node that can die."""
    pytest.importorskip("ray", reason="make verify installs it")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    cluster.add_node(num_cpus=1)
    cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()
