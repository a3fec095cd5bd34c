"""Run units as tasks on a Ray cluster. Needs the extra ``perdure[ray]``.

Every node must see the store's folder under the same path (a shared file system), with perdure installed. A task on a
node that dies is started again on another one and resumes from the unit's checkpoint.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Self

from perdure.runs.errors import RunError
from perdure.runs.unit import Unit
from perdure.runs.workers import ONE_THREAD, Ended, answer


class RayWorkers:
    """Tasks on a Ray cluster, as many at once as it has cores for."""

    def __init__(self, address: str | None = None, cores: int = 1) -> None:
        """Keep the address; the connection is made on entry.

        Args:
            address: Of a running cluster, such as "auto" or "host:6379"; None starts Ray on this machine.
            cores: Cores of each task.

        Raises:
            RunError: If Ray is not installed.
        """
        try:
            import ray
        except ImportError:
            raise RunError("running on Ray needs it installed: pip install 'perdure[ray]'") from None
        self._ray: Any = ray
        self._address, self._cores = address, cores
        self._keys: dict[Any, str] = {}
        self._mine = False

    @property
    def free(self) -> int:
        """See `Workers.free`."""
        total = int(self._ray.cluster_resources().get("CPU", 1)) // self._cores
        return max(0, max(1, total) - len(self._keys))

    def __enter__(self) -> Self:
        """Connect to the cluster."""
        if not self._ray.is_initialized():
            environment = {"env_vars": {**ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}}
            self._ray.init(address=self._address, runtime_env=environment, log_to_driver=False, configure_logging=False)
            self._mine = True
        # What the largest node has: a task that asks for more would never start.
        nodes = [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]
        self._cores = max(1, min(self._cores, max(nodes, default=1)))
        # Any number of retries: they are for nodes that die. An error of the unit itself is an answer.
        self._task = self._ray.remote(num_cpus=self._cores, max_retries=-1)(answer)
        return self

    def start(self, root: Path, unit: Unit) -> None:
        """See `Workers.start`."""
        self._keys[self._task.remote(str(root), unit, self._cores)] = unit.key

    def wait(self, seconds: float) -> list[Ended]:
        """See `Workers.wait`."""
        ready, _ = self._ray.wait(list(self._keys), num_returns=len(self._keys), timeout=seconds)
        ended = []
        for reference in ready:
            key = self._keys.pop(reference)
            try:
                found = self._ray.get(reference)
                ended.append(Ended(key, found.get("result"), found.get("error", "")))
            except self._ray.exceptions.RayError as error:
                ended.append(Ended(key, None, " ".join(str(error).split())[:500]))
        return ended

    def __exit__(self, *exception: object) -> None:
        """Cancel what still runs, and leave the cluster."""
        for reference in self._keys:
            self._ray.cancel(reference, force=True)
        self._keys.clear()
        if self._mine:
            self._ray.shutdown()
