"""Units of a protocol in a process of its own (`perdure.processes.serve`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from perdure.home.evaluate.protocol.job import Job
from perdure.processes import serve


def work(settings: dict[str, Any], tell: Callable[[Any], None]) -> None:
    """Runs the unit of a job; tells 1 whenever an episode has ended."""
    Job.from_json(settings).run(tell)


if __name__ == "__main__":
    serve(work)
