"""Policies as ONNX models, and ONNX models as policies. Needs the extra `perdure[onnx]`.

| file | what it holds |
|---|---|
| `graph.py` | an ONNX graph that is built by NumPy's operators |
| `export.py` | `export_onnx`: a policy as a model, checked with onnxruntime |
| `model.py` | `OnnxModel`: a model of any origin as a function of observations; `is_onnx`: is this the name of one? |
"""

from perdure.policy.onnx.export import export_onnx
from perdure.policy.onnx.model import OnnxModel, is_onnx

__all__ = ["OnnxModel", "export_onnx", "is_onnx"]
