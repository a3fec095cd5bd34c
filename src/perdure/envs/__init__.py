"""Worlds behind one vector contract.

| file | what it holds |
|---|---|
| `world.py` | the contract: `World`, what a step returns (`Step`), what a task is (`TaskSpec`) |
| `lanes.py`, `checks.py` | which lanes run and how long they may; the checks every world makes at its door |
| `envpool_world.py`, `envpool_channel.py` | EnvPool's compiled tasks, and the short way past its Python wrapper |
| `gymnasium_world.py`, `spaces.py` | single Gymnasium environments side by side; their spaces as vectors |
| `foreign.py` | reading what other people's environments return, and naming them when they break |
| `blow_up.py` | asking MuJoCo whether a simulation blew up |
| `vector_env_world.py` | any Gymnasium `VectorEnv` |
| `suites.py`, `registry.py` | the suites task names come from; `make_world`, `list_tasks` |
| `opening.py` | from a name, a factory or a VectorEnv to worlds |
| `environment_id.py` | which task an environment's name, such as "Hopper-v5", means |
| `traced.py` | a world inside a compiled JAX program; not imported from here, so that importing stays light |
| `errors.py` | `WorldError`, `UnknownTask` |
"""

from perdure.envs.environment_id import task_of_environment
from perdure.envs.envpool_world import EnvPoolWorld
from perdure.envs.errors import UnknownTask, WorldError
from perdure.envs.gymnasium_world import GymnasiumWorld
from perdure.envs.opening import OpenEnv, open_env
from perdure.envs.registry import is_task, list_tasks, make_world
from perdure.envs.spaces import batch_of
from perdure.envs.suites import TaskListing, module_of, refuse_import
from perdure.envs.vector_env_world import VectorEnvWorld
from perdure.envs.world import BoolArray, FloatArray, IntArray, Step, TaskSpec, World

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
    "UnknownTask",
    "VectorEnvWorld",
    "World",
    "WorldError",
    "batch_of",
    "is_task",
    "list_tasks",
    "make_world",
    "module_of",
    "open_env",
    "refuse_import",
    "task_of_environment",
]
