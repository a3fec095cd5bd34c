"""A seed's run as a chain of segments, carried on one at a time from the checkpoint in its folder."""

from __future__ import annotations

from pathlib import Path

from perdure.ppo.checkpoint import load_checkpoint, save_checkpoint
from perdure.ppo.segment import Progress, SegmentRunner
from perdure.ppo.state import SeedState, start_state

CHECKPOINT = "checkpoint.safetensors"


def reached(folder: Path) -> int:
    """How many segments the run in a folder has behind it."""
    checkpoint = folder / CHECKPOINT
    return load_checkpoint(checkpoint).segment if checkpoint.exists() else 0


def carry_on(runner: SegmentRunner, seed: int, folder: Path, progress: Progress) -> SeedState:
    """One more segment; the checkpoint in the folder is the only thing that it leaves."""
    checkpoint = folder / CHECKPOINT
    state = load_checkpoint(checkpoint) if checkpoint.exists() else start_state(seed, runner.spec, runner.config)
    state = runner.run(state, progress)
    save_checkpoint(state, checkpoint)
    return state
