"""Vectorized environments with one interface (`World`): no autoreset, separate `terminated` and `truncated`."""

from perdure.envs.envpool import EnvPoolWorld
from perdure.envs.gymnasium import GymnasiumWorld, batch_of
from perdure.envs.opening import OpenEnv, open_env
from perdure.envs.suites import (
    TaskListing,
    is_task,
    list_tasks,
    make_world,
    module_of,
    refuse_import,
    task_of_environment,
    task_spec,
    with_model,
)
from perdure.envs.vector_env import VectorEnvWorld
from perdure.envs.world import BoolArray, FloatArray, IntArray, Step, TaskSpec, World, report_success

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
    "report_success",
    "task_of_environment",
    "task_spec",
    "with_model",
]
