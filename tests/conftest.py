"""What tests of several folders use."""

import pytest


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
