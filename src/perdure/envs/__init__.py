"""Vectorized environments with one interface (`World`): no autoreset, separate `terminated` and `truncated`.

| file | what it holds |
|---|---|
| `world.py` | the interface `World`; the result of a step (`Step`); the description of a task (`TaskSpec`) |
| `lane_tracker.py`, `checks.py` | lane states; validation of arguments |
| `envpool_world.py`, `envpool_channel.py` | EnvPool's compiled tasks, and direct calls that bypass its Python wrapper |
| `gymnasium_world.py`, `spaces.py` | one Gymnasium environment per lane; their spaces as vectors |
| `third_party.py` | validation of what third-party environments return |
| `divergence.py` | detection of invalid MuJoCo simulations |
| `vector_env_world.py` | any Gymnasium `VectorEnv` |
| `suites.py`, `registry.py` | task suites; `make_world`, `list_tasks` |
| `opening.py` | `open_env`: build worlds from a name, a factory or a VectorEnv |
| `environment_id.py` | find the task of an environment name such as "Hopper-v5" |
| `traced.py` | a world inside a compiled JAX program; not imported here, because it imports JAX |
| `errors.py` | `PerdureError` |
"""

from perdure.envs.envpool import EnvPoolWorld
from perdure.envs.gymnasium import GymnasiumWorld, VectorEnvWorld
from perdure.envs.opening import OpenEnv, open_env
from perdure.envs.suites import (
    TaskListing,
    is_task,
    list_tasks,
    make_world,
    module_of,
    refuse_import,
    task_of_environment,
)
from perdure.envs.world import BoolArray, FloatArray, IntArray, Step, TaskSpec, World, batch_of

__all__ = [
    "BoolArray",
    "EnvPoolWorld",
    "FloatArray",
    "GymnasiumWorld",
    "IntArray",
    "OpenEnv",
    "Step",
    "TaskListing",
    "TaskSpec",
    "VectorEnvWorld",
    "World",
    "batch_of",
    "is_task",
    "list_tasks",
    "make_world",
    "module_of",
    "open_env",
    "refuse_import",
    "task_of_environment",
]
