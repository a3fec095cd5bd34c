"""Tasks by name: `make_world` and `list_tasks` over task suites, and what the name of an environment means.

EnvPool keeps its own registry; a suite is a rule that picks tasks out of it, so a task that a newer EnvPool adds to a
suite appears here by itself.
"""

from __future__ import annotations

import hashlib
import re
import sys
from ast import literal_eval
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from perdure.envs.world import TaskSpec, World, checked_seeds
from perdure.errors import PerdureError, did_you_mean

GYMNASIUM_PREFIX = "gymnasium:"
ENVPOOL_PREFIX = "envpool:"
ROBOTS = "perdure.robots.world"
"""Imported when a task is the contract of a robot."""
READERS = "perdure.robots.readers"
"""Knows how the names of contracts end."""


def make_world(task: str, seeds: Sequence[int], threads: int = 1) -> World:
    """Build a world with one lane per seed.

    A lane's start states depend on its seed only: the same seed in two lanes, two worlds or two batches of different
    size gives the same episodes under the same actions.

    Args:
        task: A name from `list_tasks`, or `gymnasium:<id>`.
        seeds: One whole number in [0, 2^31) per lane.
        threads: Threads that simulate; more than one helps where there are many lanes. Results do not depend on it.

    Returns:
        The world; every lane must be reset before it is stepped.

    Raises:
        PerdureError: If there is no such task, seeds or threads are not legal, or the task's actions are not one box.
    """
    if threads < 1:
        raise PerdureError(f"threads must be at least 1, got {threads}.")
    for suite in suites():
        if suite.owns(task):
            return suite.make(task, seeds, threads)
    meant: tuple[str, ...] = ()
    if gymnasium_makes(task):
        meant = (f"{GYMNASIUM_PREFIX}{task}",)
    raise unknown_task(task, [listing.name for listing in list_tasks()], meant)


def task_spec(task: str) -> TaskSpec:
    """Return the description of a task: builds a world of one lane and closes it. Raises as `make_world`."""
    world = make_world(task, [0])
    spec = world.spec
    world.close()
    return spec


def list_tasks(suite: str | None = None) -> list[TaskListing]:
    """Return every task that can be simulated, suite by suite, alphabetical inside one (`perdure list tasks`).

    Args:
        suite: Only this suite, e.g. "EnvPool MuJoCo"; None for all.

    Raises:
        PerdureError: If there is no such suite.
    """
    names = [one.name for one in suites()]
    if suite is not None and suite not in names:
        raise PerdureError(f"There is no task suite named {suite!r}; the suites are {', '.join(names)}.")
    return [listing for one in suites() if suite in (None, one.name) for listing in one.listings()]


def is_contract(task: str) -> bool:
    """Return whether a task is named by the contract of a robot, see `perdure.robots`."""
    if re.search(r"\.[a-z]\w*,", task):  # options after the name of a file
        task = str(import_module(READERS).split_name(task)[0])
    if task.endswith((".yaml", ".yml")):
        return True
    # Other formats are asked for only where a name has an ending: it means an import.
    return re.search(r"\.[a-z]\w*$", task) is not None and task.endswith(import_module(READERS).suffixes())


def with_model(env: str, model: str | None) -> str:
    """Return the name of an environment whose robot has this MJCF; PerdureError if the environment takes none."""
    if model is None:
        return env
    if not is_contract(env):
        raise PerdureError(f"--model is for an --env that is a file, such as deploy.yaml, not for {env}")
    return str(import_module(READERS).with_model(env, model))


def is_task(name: str) -> bool:
    """Return whether a suite owns the name."""
    return any(suite.owns(name) for suite in suites())


def task_of_environment(name: str) -> str:
    """Return the task that an environment's name means.

    | name | task |
    |---|---|
    | `gymnasium:Id`, `Module:Id` | that environment of Gymnasium |
    | `envpool:Id` | EnvPool's environment of that name, which is faster |
    | `robot.yaml` | the robot of that contract, see `perdure.robots` |
    | `deploy.yaml,model=robot.xml` | the same, for files that name no model |
    | `Id` | Gymnasium's environment if Gymnasium can make it, else the task of that name in `perdure list tasks` |

    The same name may mean slightly different physics in Gymnasium and in EnvPool. A policy of another library was
    trained in Gymnasium, hence its precedence. Gymnasium's `Hopper-v3` and its like can only be made with mujoco-py, so
    these names mean EnvPool's.

    Raises:
        PerdureError: If there is no such environment, or the name is empty.
    """
    if not name.strip():
        raise PerdureError("the environment's name is empty; write for example Hopper-v5")
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
        raise unknown_task(name, [env_id for env_id in gymnasium.registry if gymnasium_makes(env_id)])
    return name


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
        from perdure.envs.envpool import EnvPoolWorld

        return EnvPoolWorld(task, self.name, seeds, threads)


def _envpool_registry() -> dict[str, tuple[str, str, dict[str, Any]]]:
    """Return EnvPool's tasks: name to (module, class name of the specification, its arguments)."""
    import envpool.registration

    registered: dict[str, tuple[str, str, dict[str, Any]]] = envpool.registration.registry.specs
    return registered


@dataclass(frozen=True)
class GymnasiumSuite:
    """Every environment that Gymnasium can make by its id, written `gymnasium:<id>`, and contracts of robots."""

    name: str = "Gymnasium"
    """See `TaskSuite.name`."""

    def owns(self, task: str) -> bool:
        """See `TaskSuite.owns`."""
        return task.startswith(GYMNASIUM_PREFIX) or is_contract(task)

    def listings(self) -> list[TaskListing]:
        """See `TaskSuite.listings`: one line, since most of Gymnasium's registry needs extra packages to build."""
        return [TaskListing(f"{GYMNASIUM_PREFIX}<id>", self.name, None)]

    def make(self, task: str, seeds: Sequence[int], threads: int) -> World:
        """See `TaskSuite.make`; `threads` is not used, the environments are stepped one after the other."""
        from perdure.envs.gymnasium import GymnasiumWorld

        if is_contract(task):
            return GymnasiumWorld.from_id(f"{ROBOTS}:perdure/VelocityCommand-v0", seeds, task, robot=task)
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

        from perdure.envs.vector_env import VectorEnvWorld

        registered, _, text = task.partition(",")
        given: dict[str, Any] = {"num_envs": len(checked_seeds(seeds)), "max_episode_steps": None, "threads": threads}
        options = parse_options(text)
        for name in given.keys() & options.keys():
            raise PerdureError(f"{task}: {name} is not an option in a task's name; perdure sets it.")
        env = gymnasium.make_vec(registered, **given, **options)
        return VectorEnvWorld(env, seeds, task, self.name, gymnasium.spec(registered).max_episode_steps)


def parse_options(text: str) -> dict[str, Any]:
    """Parse options of an environment from `name=value,name=value`; values are Python literals, or else words."""
    options: dict[str, Any] = {}
    for name, equals, value in (part.partition("=") for part in text.split(",") if part):
        if not equals:
            raise PerdureError(f"An option of a task is written name=value, not {name!r}.")
        try:
            options[name] = literal_eval(value)
        except (ValueError, SyntaxError):
            options[name] = value
    return options


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


def unknown_task(task: str, known: Iterable[str], meant: tuple[str, ...] = ()) -> PerdureError:
    """Return the error that no suite knows a task, with the nearest names among the `known`, after those `meant`."""
    return PerdureError(
        f"there is no task named {task!r}: `perdure list tasks` shows them, any Gymnasium environment works as "
        "gymnasium:<id>, and one that a package or your own module registers as gymnasium:<module>:<id>, such as "
        "gymnasium:gymnasium_robotics:FetchReach-v4"
        f"{did_you_mean(task, known, 3, meant)}"
    )


def gymnasium_makes(env_id: str) -> bool:
    """Return whether an id is registered in Gymnasium and still part of it."""
    import gymnasium

    spec = gymnasium.registry.get(env_id)
    # Names that moved to other packages are registered with a function that says so when it is called.
    return spec is not None and not getattr(spec.entry_point, "__name__", "").startswith("_raise_")


def module_of(task: str) -> str | None:
    """Return the module that a world of this name would import, as in `gymnasium:MODULE:Id`; None for any other."""
    if not task.startswith(GYMNASIUM_PREFIX):
        return None
    return task.removeprefix(GYMNASIUM_PREFIX).rpartition(":")[0] or None


def refuse_import(task: str, allowed: Collection[str], where: str) -> None:
    """Raise PerdureError if a task that a file names would import a module neither `allowed` nor imported yet.

    The message begins with `where` the name was found.
    """
    module = module_of(task)
    if module is not None and module not in allowed and module not in sys.modules:
        raise PerdureError(
            f"{where} is for the task {task}, which imports the Python module {module}; if you trust that module, "
            f"name it: --modules {module}"
        )


def task_source_digest(task: str) -> dict[str, str]:
    """Return {module: SHA-256} of the module that "gymnasium:MODULE:Id" imports, or of a contract; {} for other tasks.

    For a module inside a package, all Python files and MuJoCo models (.xml) of the top-level package are included. Code
    that it imports from other packages is not.
    """
    if is_contract(task):
        return dict(import_module(ROBOTS).sources(task))
    top = (module_of(task) or "").partition(".")[0]
    files = _source_files(top)
    if not files:
        return {}
    digest = hashlib.sha256()
    for file, folder in files.items():
        name = file.relative_to(folder).as_posix()
        data = file.read_bytes()
        digest.update(f"{name}\0{len(data)}\0".encode() + data)
    return {top: digest.hexdigest()}


def _source_files(top: str) -> dict[Path, Path]:
    """Return the source files of a top-level module or package, each with its folder; {} without a source."""
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return {}
    if spec is None:
        return {}
    files = {}
    for location in spec.submodule_search_locations or []:
        folder = Path(location)
        for pattern in ("*.py", "*.xml"):
            for file in sorted(folder.rglob(pattern)):
                files[file] = folder
    if not spec.submodule_search_locations and spec.origin is not None and Path(spec.origin).is_file():
        file = Path(spec.origin)
        files[file] = file.parent
    return files
