"""Gymnasium wrappers: random horizons and the time-to-go observation, for any learner. Imports gymnasium.

| file | what it holds |
|---|---|
| `horizon_limit.py` | `HorizonLimit`: draws T for each episode and ends the episode there |
| `time_to_go.py` | `TimeToGoObservation`: appends phi, of the training horizon or of a clock |
| `vector_horizon_limit.py`, `vector_time_to_go.py` | the same above a `gymnasium.vector.VectorEnv` |
| `limit.py` | what both limits share: T's own random numbers, the environment's own limit |
| `appended.py` | how phi joins an observation and its space |
| `step_counter.py` | elapsed steps of each lane in the three autoreset modes |
| `any_vector_wrapper.py` | Gymnasium's `VectorWrapper` under every supported version |
| `lane_infos.py` | the info dictionaries of single lanes of a vector environment |
"""

from perdure.horizon.wrappers.horizon_limit import HorizonLimit
from perdure.horizon.wrappers.time_to_go import TimeToGoObservation
from perdure.horizon.wrappers.vector_horizon_limit import VectorHorizonLimit
from perdure.horizon.wrappers.vector_time_to_go import VectorTimeToGoObservation

__all__ = ["HorizonLimit", "TimeToGoObservation", "VectorHorizonLimit", "VectorTimeToGoObservation"]
