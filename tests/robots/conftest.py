"""Gymnasium's Ant with a contract, and a linear ONNX policy that trots: feet follow the phases of the gait."""

from pathlib import Path

import numpy as np
import pytest

from perdure.robots import read_contract

ANT = Path(__file__).parents[2] / "examples" / "robots" / "ant.yaml"
HISTORY = 6
"""Steps of 50 ms: the oldest one is a quarter of the gait ago."""


@pytest.fixture(scope="session")
def ant():
    return read_contract(ANT)


def trot():
    """Weights (observations, actions) of a trot along x.

    Legs 1 and 3, and 2 and 4, move together. A hip sweeps with -cos; its ankle pushes down a quarter of the gait later,
    which is the oldest phase in the history.
    """
    weights = np.zeros((33 + 2 * HISTORY, 8), np.float32)
    for leg in range(4):
        side, down = (1 if leg < 2 else -1), (1 if leg in (0, 3) else -1)
        oldest, newest = 33 + leg % 2, 33 + 2 * (HISTORY - 1) + leg % 2
        weights[newest, 2 * leg] = -2.0 * side
        weights[oldest, 2 * leg + 1] = 2.0 * down
    return weights


@pytest.fixture(scope="session")
def policy_file(tmp_path_factory):
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper, numpy_helper

    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], ["actions"])],
        "trot",
        [value("obs", TensorProto.FLOAT, [1, 33 + 2 * HISTORY])],
        [value("actions", TensorProto.FLOAT, [1, 8])],
        [numpy_helper.from_array(trot(), "w")],
    )
    path = tmp_path_factory.mktemp("policy") / "trot.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def act(observations):
    """The same policy without onnxruntime."""
    return observations @ trot()
