"""Build a world from a task's name, and list the names."""

from __future__ import annotations

from collections.abc import Sequence

from perdure.envs.errors import WorldError
from perdure.envs.suites import TaskListing, suite_of, suites
from perdure.envs.world import World


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
        UnknownTask: If there is no such task.
        WorldError: If seeds or threads are not legal, or the task's actions are not one box.
    """
    if threads < 1:
        raise WorldError(f"threads must be at least 1, got {threads}.")
    return suite_of(task).make(task, seeds, threads)


def is_task(name: str) -> bool:
    """Return whether a suite owns the name."""
    return any(suite.owns(name) for suite in suites())


def list_tasks(suite: str | None = None) -> list[TaskListing]:
    """Return every task that can be simulated, as in `perdure list tasks`.

    Args:
        suite: Only this suite, e.g. "EnvPool MuJoCo"; None for all.

    Returns:
        Listings, suite by suite, alphabetical inside one.

    Raises:
        WorldError: If there is no such suite.
    """
    names = [one.name for one in suites()]
    if suite is not None and suite not in names:
        raise WorldError(f"There is no task suite named {suite!r}; the suites are {', '.join(names)}.")
    return [listing for one in suites() if suite in (None, one.name) for listing in one.listings()]
