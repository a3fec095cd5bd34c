"""What tests of several folders use."""

import os
import tempfile
from pathlib import Path

import pytest

COMPILED = "JAX_COMPILATION_CACHE_DIR"
TESTS = Path(__file__).parent
FIRST = (
    "test_types.py",
    "evaluate/test_autoreset_parity.py",
    "evaluate/test_in_process.py",
    "learn/test_segments.py",
    "cli/test_interrupts.py",
    "studies/horizon/test_kills.py",
    "cli/test_sb3_models.py",
    "learn/test_average_reward.py",
    "home/evaluate/execute/test_executor.py",
    "evaluate/test_verdict.py",
    "evaluate/test_goals.py",
    "learn/test_probes.py",
    "cli/test_commands.py",
    "evaluate/test_watch.py",
    "envs/test_world_contract.py",
    "evaluate/test_extrapolate.py",
    "home/skills/training/test_training.py",
    "test_own_environment.py",
    "envs/test_third_party.py",
    "cli/test_terminal.py",
    "cli/test_home_commands.py",
    "home/test_home_film.py",
    "home/test_failure_sheets.py",
    "studies/horizon/test_committed_results.py",
    "test_snippets.py",
    "fuzz/test_fuzz_readers.py",
)
"""The longest files. They come first, so that test processes which take file after file end at the same time.

Files that fork come before those that train, because JAX then has threads.
"""


def pytest_configure(config):
    """Compile each program of JAX once for all test processes and the commands that they start."""
    if COMPILED not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="perdure-compiled-", ignore_cleanup_errors=True)
        config.add_cleanup(folder.cleanup)
        os.environ[COMPILED] = folder.name
    # Programs here run for a few steps only, so LLVM does not optimize them. Set XLA_FLAGS to compile them as users do.
    os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")


def pytest_collection_modifyitems(items):
    """Put the longest files first."""
    place = {TESTS / name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(FIRST)))


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
