"""Seeds in a process of its own (`perdure.processes.serve`): each job carries one seed on by a segment."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from perdure.ppo.chain import carry_on
from perdure.ppo.config import PPOConfig
from perdure.ppo.segment import SegmentRunner
from perdure.processes import serve


def work(job: dict[str, Any], tell: Callable[[Any], None]) -> None:
    """Carries the seed of a job on by a segment; tells (step, mean return) after every iteration."""
    runner = _runner(job["task"], PPOConfig.from_json(job["config"]), job["threads"])
    carry_on(runner, job["seed"], Path(job["folder"]), lambda step, mean: tell([step, mean]))


@lru_cache(maxsize=1)
def _runner(task: str, config: PPOConfig, threads: int) -> SegmentRunner:
    """Kept from job to job, and with it what was compiled."""
    return SegmentRunner(task, config, threads)


if __name__ == "__main__":
    serve(work)
