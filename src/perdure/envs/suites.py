"""Task suites: each lists its tasks and builds one.

EnvPool keeps its own registry; a suite is a rule that picks tasks out of it, so a task that a newer EnvPool adds to a
suite appears here by itself.
"""

from __future__ import annotations

import sys
from ast import literal_eval
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

from perdure.envs.checks import checked_seeds
from perdure.envs.errors import UnknownTask, WorldError
from perdure.envs.world import World

GYMNASIUM_PREFIX = "gymnasium:"


@dataclass(frozen=True)
class TaskListing:
    """A task, as listed by `list_tasks`."""

    name: str
    """Name for `make_world`."""
    suite: str
    """The suite."""
    default_horizon: int | None
    """Steps per episode in the suite itself; None if it is known only after building the environment."""


class TaskSuite(Protocol):
    """A suite of tasks."""

    @property
    def name(self) -> str:
        """What the suite is called in lists and in a `TaskSpec`."""

    def owns(self, task: str) -> bool:
        """Return whether the name is one of this suite's."""

    def listings(self) -> list[TaskListing]:
        """Return its tasks for `list_tasks`."""

    def make(self, task: str, seeds: Sequence[int], threads: int) -> World:
        """Build a world for one of its tasks."""


@dataclass(frozen=True)
class EnvPoolSuite:
    """The EnvPool tasks that one module registers."""

    name: str
    """See `TaskSuite.name`."""
    module: str
    """EnvPool's module, e.g. "envpool.mujoco.gym"."""
    prefix: str = ""
    """Only tasks whose name begins like this."""

    def owns(self, task: str) -> bool:
        """See `TaskSuite.owns`."""
        registered = _envpool_registry().get(task)
        return registered is not None and registered[0] == self.module and task.startswith(self.prefix)

    def listings(self) -> list[TaskListing]:
        """See `TaskSuite.listings`; in alphabetical order."""
        tasks = sorted(task for task in _envpool_registry() if self.owns(task))
        return [TaskListing(task, self.name, _envpool_registry()[task][2].get("max_episode_steps")) for task in tasks]

    def make(self, task: str, seeds: Sequence[int], threads: int) -> World:
        """See `TaskSuite.make`."""
        from perdure.envs.envpool_world import EnvPoolWorld

        return EnvPoolWorld(task, self.name, seeds, threads)


@dataclass(frozen=True)
class GymnasiumSuite:
    """Every environment that Gymnasium can make by its id, written `gymnasium:<id>`."""

    name: str = "Gymnasium"
    """See `TaskSuite.name`."""

    def owns(self, task: str) -> bool:
        """See `TaskSuite.owns`."""
        return task.startswith(GYMNASIUM_PREFIX)

    def listings(self) -> list[TaskListing]:
        """See `TaskSuite.listings`: one line, since most of Gymnasium's registry needs extra packages to build."""
        return [TaskListing(f"{GYMNASIUM_PREFIX}<id>", self.name, None)]

    def make(self, task: str, seeds: Sequence[int], threads: int) -> World:
        """See `TaskSuite.make`; `threads` is not used, the environments are stepped one after the other."""
        from perdure.envs.gymnasium_world import GymnasiumWorld

        return GymnasiumWorld.from_id(task.removeprefix(GYMNASIUM_PREFIX), seeds)


@dataclass(frozen=True)
class VectorSuite:
    """Gymnasium ids that a module registers together with its vector environment.

    A name may go on with options of the environment: `perdure/HomePlace-v0,task=set_table,delta=30`.
    """

    name: str
    """See `TaskSuite.name`."""
    module: str
    """Importing it registers the ids; it is imported when one of them is asked for."""
    prefix: str
    """How its ids begin."""

    def owns(self, task: str) -> bool:
        """See `TaskSuite.owns`."""
        import gymnasium

        if not task.startswith(self.prefix):
            return False
        import_module(self.module)
        return task.partition(",")[0] in gymnasium.registry

    def listings(self) -> list[TaskListing]:
        """See `TaskSuite.listings`; in alphabetical order."""
        import gymnasium

        import_module(self.module)
        specs = [gymnasium.spec(each) for each in sorted(gymnasium.registry) if each.startswith(self.prefix)]
        return [TaskListing(spec.id, self.name, spec.max_episode_steps) for spec in specs]

    def make(self, task: str, seeds: Sequence[int], threads: int) -> World:
        """See `TaskSuite.make`."""
        import gymnasium

        from perdure.envs.vector_env_world import VectorEnvWorld

        registered, _, text = task.partition(",")
        given: dict[str, Any] = {
            "num_envs": len(checked_seeds(seeds)),
            "max_episode_steps": None,
            "threads": threads,
        }
        options = _options(text)
        for name in given.keys() & options.keys():
            raise WorldError(f"{task}: {name} is not an option in a task's name; perdure sets it.")
        env = gymnasium.make_vec(registered, **given, **options)
        return VectorEnvWorld(env, seeds, task, self.name, gymnasium.spec(registered).max_episode_steps)


ENTRY_POINTS = "perdure.suites"
"""Entry-point group through which a package adds a suite: each names a `TaskSuite`."""

BUILT_IN: tuple[TaskSuite, ...] = (
    EnvPoolSuite("EnvPool MuJoCo", "envpool.mujoco.gym"),
    EnvPoolSuite("EnvPool dm_control", "envpool.mujoco.dmc"),
    EnvPoolSuite("EnvPool Shadow hand", "envpool.mujoco.robotics", prefix="Hand"),
    GymnasiumSuite(),
)


def suites() -> Iterator[TaskSuite]:
    """Yield every suite, the built-in ones first; an installed one is imported only when it is reached."""
    yield from BUILT_IN
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        yield entry.load()


def module_of(task: str) -> str | None:
    """Return the module that a world of this name would import, as in `gymnasium:MODULE:Id`; None for any other."""
    if not task.startswith(GYMNASIUM_PREFIX):
        return None
    return task.removeprefix(GYMNASIUM_PREFIX).rpartition(":")[0] or None


def refuse_import(task: str, allowed: Collection[str], where: str) -> None:
    """Refuse a task name found in a file if it would import a module that the user has not named.

    Args:
        task: As the file has it.
        allowed: Modules that the user has named. Those that are imported already need not be.
        where: Which file, for the message.

    Raises:
        WorldError: If the task would import another module.
    """
    module = module_of(task)
    if module is not None and module not in allowed and module not in sys.modules:
        raise WorldError(
            f"{where} is for the task {task}, which imports the Python module {module}; if you trust that module, "
            f"name it: --modules {module}"
        )


def suite_of(task: str) -> TaskSuite:
    """Return the suite a task name belongs to.

    Args:
        task: A name as `list_tasks` shows it.

    Returns:
        Its suite.

    Raises:
        UnknownTask: If no suite owns the name.
    """
    for suite in suites():
        if suite.owns(task):
            return suite
    meant = (f"{GYMNASIUM_PREFIX}{task}",) if gymnasium_makes(task) else ()
    raise UnknownTask(task, (listing.name for suite in suites() for listing in suite.listings()), meant)


def gymnasium_makes(env_id: str) -> bool:
    """Return whether an id is registered in Gymnasium and still part of it."""
    import gymnasium

    spec = gymnasium.registry.get(env_id)
    # Names that moved to other packages are registered with a function that says so when it is called.
    return spec is not None and not getattr(spec.entry_point, "__name__", "").startswith("_raise_")


def _options(text: str) -> dict[str, Any]:
    """Parse options of an environment from `name=value,name=value`; values are Python literals, or else words."""
    options: dict[str, Any] = {}
    for name, equals, value in (part.partition("=") for part in text.split(",") if part):
        if not equals:
            raise WorldError(f"An option of a task is written name=value, not {name!r}.")
        try:
            options[name] = literal_eval(value)
        except (ValueError, SyntaxError):
            options[name] = value
    return options


def _envpool_registry() -> dict[str, tuple[str, str, dict[str, Any]]]:
    """Return EnvPool's tasks: name to (module, class name of the specification, its arguments)."""
    import envpool.registration

    registered: dict[str, tuple[str, str, dict[str, Any]]] = envpool.registration.registry.specs
    return registered
