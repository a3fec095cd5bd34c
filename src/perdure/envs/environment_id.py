"""Find the task of an environment name such as "Hopper-v5"."""

from __future__ import annotations

from perdure.envs.errors import UnknownTask, WorldError
from perdure.envs.registry import is_task
from perdure.envs.suites import GYMNASIUM_PREFIX, gymnasium_makes

ENVPOOL_PREFIX = "envpool:"


def task_of_environment(name: str) -> str:
    """Return the task that an environment's name means.

    | name | task |
    |---|---|
    | `gymnasium:Id`, `Module:Id` | that environment of Gymnasium |
    | `envpool:Id` | EnvPool's environment of that name, which is faster |
    | `Id` | Gymnasium's environment if Gymnasium can make it, else the task of that name in `perdure list tasks` |

    The same name may mean slightly different physics in Gymnasium and in EnvPool. A policy of another library was
    trained in Gymnasium, hence its precedence. Gymnasium's `Hopper-v3` and its like can only be made with mujoco-py, so
    these names mean EnvPool's.

    Raises:
        UnknownTask: If there is no such environment.
        WorldError: If the name is empty.
    """
    if not name.strip():
        raise WorldError("the environment's name is empty; write for example Hopper-v5")
    if name.startswith(GYMNASIUM_PREFIX):
        return name
    if name.startswith(ENVPOOL_PREFIX):
        return _task(name.removeprefix(ENVPOOL_PREFIX))
    if "/" in name and ":" not in name and is_task(name):  # suites of other packages, such as perdure/HomePlace-v0
        return name
    if ":" in name or gymnasium_makes(name):
        return f"{GYMNASIUM_PREFIX}{name}"
    return _task(name)


def _task(name: str) -> str:
    import gymnasium

    if not is_task(name):
        raise UnknownTask(name, [env_id for env_id in gymnasium.registry if gymnasium_makes(env_id)])
    return name
