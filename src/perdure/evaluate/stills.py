"""Stills of a failure, for the page of a table.

They replay an episode of the table that Gymnasium ran; disturbed ones mostly are. EnvPool cannot be seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.disturbances import applied_disturbances
from perdure.envs.disturbances import disturbed_task
from perdure.envs.gymnasium import engine_of
from perdure.envs.suites import GYMNASIUM_PREFIX, is_contract
from perdure.evaluate.reference import task_env, with_reference
from perdure.evaluate.replay import Camera, JudgedEpisode, find_render_env, make_camera, replay, step_seconds
from perdure.evaluate.run import read_file
from perdure.evaluate.table import file_note
from perdure.evaluate.watch import BELOW, SUBTITLE
from perdure.film import GRAY, INK, RED, Picture, annotate, save_picture, tile
from perdure.horizon import parse_clock
from perdure.policy.onnx import model_digest
from perdure.report.groups import NO_CLOCK
from perdure.report.outcomes import Falls, outcome, outcomes
from perdure.report.page import STILLS
from perdure.runs import Unit, Work, config_digest, run_missing, versions, write_atomic

if TYPE_CHECKING:
    import polars as pl

STILL_SIZE = (352, 264)
"""Width and height of a still in pixels."""
COLORS = 96
"""Colors of the stills, a fifth of the bytes of all colors."""


def add_stills(
    frame: pl.DataFrame, notes: Mapping[str, str], policies: Sequence[Path], out: Path, on: str = "local"
) -> None:
    """Write stills of the first fall, else of the first other failure, beside the table.

    There are none without a failure, where nothing can be drawn, and of episodes that EnvPool ran: it cannot be seen.

    Args:
        frame: The table of `evaluate_files`.
        notes: The SHA-256 of its policy files, by `file_note`.
        policies: These files.
        out: The folder of the table. A worker draws the stills there, and only once.
        on: Where, see `perdure.runs.make_workers`.
    """
    (out / STILLS).unlink(missing_ok=True)
    files = {model_digest(path): path.resolve() for path in policies}
    shown_words = [each.name for each in outcomes(good=False) if each.still_seconds is not None]
    last = frame.filter((frame["step"] == frame["test_horizon"]) & frame["outcome"].is_in(shown_words))
    found = list[_Filmed]()
    for row in last.iter_rows(named=True):
        filmed = _filmed(row, notes)
        drawable = filmed.task.startswith(GYMNASIUM_PREFIX) or is_contract(filmed.task)
        if drawable and filmed.file in files:
            found.append(filmed)
    if not found:
        return
    first = min(found, key=lambda each: (each.episode.outcome != Falls.name, each.episode.failed_step))
    shown = {"task": first.task, "horizon": first.horizon, "who": first.who}
    made_with = versions("gymnasium", "mujoco", "pillow")
    config = {"policy": first.file, **shown, "episode": f"{first.episode}", **made_with}
    arguments = {"path": files[first.file], "digest": first.file, **shown, "episode": first.episode}
    unit = Unit(f"failure/{config_digest(config)[:16]}", config, f"{__name__}:draw_stills", arguments)
    with suppress(Exception):  # whatever an environment or a driver does: the evaluation is finished
        run_missing([unit], out, on, cores=1)
        write_atomic(out / STILLS, (out / unit.key / STILLS).read_bytes())


@dataclass(frozen=True)
class _Filmed:
    """An episode of a table of which stills can be drawn, if its files are there."""

    episode: JudgedEpisode
    task: str
    """With its disturbances."""
    file: str
    """SHA-256 of the policy's file; "": unknown."""
    who: str
    """The policy, and what disturbs it."""
    horizon: int | None
    """Training horizon in steps; None: not finite."""


def _filmed(row: Mapping[str, Any], notes: Mapping[str, str]) -> _Filmed:
    """Return the episode of the last row that a table has of it."""
    met = applied_disturbances(row["disturbance"], row["not_applied"])
    clock = None if row["clock"] == NO_CLOCK else parse_clock(row["clock"])
    # A fall is shown where it ended the episode, also after a silent failure.
    at = row["end_step"] if outcome(row["outcome"]).by_end else max(1, row["failed_step"])
    episode = JudgedEpisode(clock, row["eval_seed"], row["outcome"], at, row["end_step"], row["return"], met)
    return _Filmed(
        episode,
        disturbed_task(row["task"], met),
        notes.get(file_note(row["policy"], row["train_seed"]), ""),
        row["policy"] + (f" under {row['disturbance']}" if met else ""),
        int(row["train_horizon"]) if math.isfinite(row["train_horizon"]) else None,
    )


def draw_stills(
    work: Work, *, path: Path, digest: str, task: str, horizon: int | None, who: str, episode: JudgedEpisode
) -> None:
    """Draw the stills of an episode into the work folder; the function of a unit."""
    policy = with_reference(read_file(path, digest, task, horizon), task_env(task))
    pictures = list[Picture]()
    render_env = find_render_env(task)
    at = episode.failed_step
    seconds = outcome(episode.outcome).still_seconds
    assert seconds is not None
    with closing(render_env.build()) as env:
        world = f"{render_env.env_id}, {engine_of(env)}"
        apart = max(1, round(seconds / step_seconds(env)))
    captions = {max(1, at - apart): f"{seconds:g} s before", 1: "start", at: episode.outcome}
    captions[at + apart] = f"{seconds:g} s after"
    with ExitStack() as stack:
        take: Camera | None = None
        for instant in replay(policy, episode, render_env, at + apart):
            if instant.step in captions:
                take = take or make_camera(instant.env, STILL_SIZE, stack)
                color = INK if instant.step < at else RED
                said = [(BELOW, [(f"step {instant.step:,}: {captions[instant.step]}", color)])]
                pictures.append(annotate(take(), below=said, edge=None if instant.step < at else RED))
    who += (f", {episode.words[0]}" if episode.clock else "") + f", start state {episode.eval_seed}: {episode.words[1]}"
    above = [(SUBTITLE, [(who, RED)]), (SUBTITLE, [(world, GRAY)])]
    (work.folder / STILLS).unlink(missing_ok=True)  # of an attempt that was interrupted
    save_picture(annotate(tile(pictures, 2), above), work.folder / STILLS, COLORS)
