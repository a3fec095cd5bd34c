"""Embeddings of the time-to-go, clocks for deployment, and distributions of the training horizon.

| file | what it holds |
|---|---|
| `embedding.py` | base class of embeddings phi(t, T); `linear.py`, `geometric.py`, `time_feature.py` |
| `clock.py` | base class of clocks, `parse_clock`; `countdown.py`, `constant.py`, `periodic.py`, `lane_clocks.py` |
| `distribution.py` | base class of horizon distributions; `fixed.py`, `uniform.py`, `infinite.py` |
| `protocol.py` | `HorizonProtocol`: embedding, horizon, end and gamma in one record |
| `registered.py` | base class: look up embeddings, clocks and distributions by name; to JSON and back |
| `wrappers/` | random horizons and the time-to-go as Gymnasium wrappers, for any library |
| `errors.py` | `HorizonError` |
"""

from perdure.horizon.clock import Clock, clock_from_json, parse_clock
from perdure.horizon.constant import Constant
from perdure.horizon.countdown import Countdown
from perdure.horizon.distribution import HorizonDistribution, distribution_from_json
from perdure.horizon.embedding import Embedding, embedding_from_json
from perdure.horizon.errors import HorizonError
from perdure.horizon.fixed import Fixed
from perdure.horizon.geometric import Geometric, geometric_size
from perdure.horizon.infinite import Infinite
from perdure.horizon.lane_clocks import LaneClocks
from perdure.horizon.linear import Linear
from perdure.horizon.periodic import Periodic
from perdure.horizon.protocol import End, HorizonProtocol
from perdure.horizon.time_feature import TimeFeature
from perdure.horizon.uniform import Uniform

__all__ = [
    "Clock",
    "Constant",
    "Countdown",
    "Embedding",
    "End",
    "Fixed",
    "Geometric",
    "HorizonDistribution",
    "HorizonError",
    "HorizonProtocol",
    "Infinite",
    "LaneClocks",
    "Linear",
    "Periodic",
    "TimeFeature",
    "Uniform",
    "clock_from_json",
    "distribution_from_json",
    "embedding_from_json",
    "geometric_size",
    "parse_clock",
]
