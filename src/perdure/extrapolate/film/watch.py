"""Make a video of a policy, at its failure or from its first step."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from perdure.envs import refuse_import
from perdure.extrapolate.film.camera import Camera, Picture
from perdure.extrapolate.film.captions import Caption, compose
from perdure.extrapolate.film.errors import FilmError
from perdure.extrapolate.film.judge import Judge, JudgedLane
from perdure.extrapolate.film.mp4 import check_film, write_film
from perdure.extrapolate.film.render_env import RenderEnv, find_render_env
from perdure.extrapolate.film.replay import Instant, replay
from perdure.horizon import Clock
from perdure.policy import Policy
from perdure.report import wording

BEFORE, AFTER = 5.0, 1.0
"""Seconds shown before a failure and after it."""
MOST_WINDOW = 10.0
"""Most seconds shown of the window of rewards in which a silent failure begins."""
RATE = 25.0
"""Pictures per second, at most."""
SCORE_STEPS = 100
"""Steps over which the score in the picture is taken."""
SIZE = (480, 360)


@dataclass(frozen=True)
class Film:
    """A finished video and its facts."""

    path: Path
    lanes: tuple[JudgedLane, ...]
    """The panels from left to right."""
    world: str
    """Environment and engine that were filmed."""
    pictures: int

    @property
    def sentences(self) -> list[str]:
        """Description of the video."""
        return [f"{_clock(lane)}, start state {lane.eval_seed}: {_outcome(lane)}" for lane in self.lanes]


def watch(
    policy: Policy,
    out: str | Path,
    *,
    clock: Clock | None = None,
    beside: Clock | None = None,
    until_failure: bool = False,
    steps: int = 10_000,
    eval_seeds: int = 10,
    first_eval_seed: int = 0,
    size: tuple[int, int] = SIZE,
) -> Film:
    """Film a policy; the left panel shows an episode that holds, if there is one.

    Args:
        policy: The policy.
        out: The film, an .mp4.
        clock: Clock of the policy; None: its own clock.
        beside: A second clock, from the same start state, over the same steps.
        until_failure: Search for the first start state from which the policy fails under ``clock``, and film 5 s before
            the failure and 1 s after it. Otherwise film the first 6 s from the first start state.
        steps: Steps of each episode, unless it ends earlier.
        eval_seeds: Start states among which a failure is searched for.
        first_eval_seed: The first of them.
        size: Width and height of a panel's picture in pixels, even.

    Raises:
        FilmError: If Gymnasium lacks the environment, no episode fails, rendering fails, or the file cannot be written.
        PolicyError: If the policy takes no clock.
    """
    out = Path(out)
    check_film(out)
    if steps < 1 or eval_seeds < 1:
        raise FilmError(f"steps and eval_seeds must be at least 1, got {steps} and {eval_seeds}")
    if first_eval_seed < 0:
        raise FilmError(f"first_eval_seed must be at least 0, got {first_eval_seed}")
    if beside is not None and not policy.has_clock:
        raise FilmError(
            f"this {policy.task.name} policy has no time-to-go input, so there is no clock to set beside it"
        )
    clock = clock or policy.clock
    if clock is not None and not policy.has_clock:
        raise FilmError(f"this {policy.task.name} policy has no time-to-go input, so it takes no clock")
    refuse_import(policy.task.name, (), "the policy")
    render_env = find_render_env(policy.task.name, policy.task.observation_size)
    judge = Judge(policy, render_env.open(), steps)
    seeds = range(first_eval_seed, first_eval_seed + eval_seeds)
    lane = judge.first_failure(clock, seeds) if until_failure else judge.judge(clock, seeds[:1])[0]
    lanes = [lane] if beside is None else [lane, *judge.judge(beside, [lane.eval_seed])]
    lanes.sort(key=lambda each: each.outcome != "holds")
    scene = _Scene(judge, render_env, size, lane if until_failure else None)
    count = write_film(scene.pictures(lanes), out, scene.rate)
    return Film(out, tuple(lanes), scene.world, count)


class _Scene:
    """Steps and camera of one part of the video."""

    def __init__(self, judge: Judge, render_env: RenderEnv, size: tuple[int, int], failing: JudgedLane | None) -> None:
        env = render_env.build()
        seconds_per_step = float(env.unwrapped.dt)
        env.close()
        self._judge, self._render_env, self._size = judge, render_env, size
        self.world = _world(render_env)
        self._stride = max(1, round(1.0 / (RATE * seconds_per_step)))
        self.rate = 1.0 / (self._stride * seconds_per_step)
        before, after = (round(seconds / seconds_per_step) for seconds in (BEFORE, AFTER))
        if failing is None:
            self._first, self._last = 1, before + after
            return
        if failing.outcome in ("fails silently", "decays"):
            after += min(judge.scale.window, round(MOST_WINDOW / seconds_per_step))
        self._first, self._last = max(1, failing.failed_step - before), failing.failed_step + after

    def pictures(self, lanes: Sequence[JudgedLane]) -> Iterator[Picture]:
        with ExitStack() as stack:
            panels = [self._panel(lane, stack) for lane in lanes]
            for step_of_each in zip(*panels, strict=True):
                yield compose(step_of_each)

    def _panel(self, lane: JudgedLane, stack: ExitStack) -> Iterator[tuple[Picture, Caption]]:
        camera: Camera | None = None
        recent: deque[float] = deque(maxlen=SCORE_STEPS)
        for instant in replay(self._judge.policy, lane, self._render_env, self._last):
            recent.append(instant.reward)
            if instant.step < self._first or (instant.step - self._first) % self._stride:
                continue
            camera = camera or stack.enter_context(Camera(instant.env, self._size))
            yield camera.take(), self._caption(lane, instant, list(recent))

    def _caption(self, lane: JudgedLane, instant: Instant, recent: Sequence[float]) -> Caption:
        scale = self._judge.scale
        now = f"step {instant.step:,}"
        if instant.step > lane.end_step:
            now += f"   ended at step {lane.end_step:,}"
        elif scale.state == "worked":
            score = (sum(recent) / len(recent) - scale.idle) / (scale.reference - scale.idle)
            now += f"   hold score {round(score, 2) + 0.0:.2f} (last {len(recent)} steps)"
        failed = lane.failed and instant.step >= lane.failed_step
        return Caption(f"{_clock(lane)}: {_outcome(lane)}", self.world, now, lane.outcome, failed)


def _clock(lane: JudgedLane) -> str:
    if lane.clock is None:
        return "no time-to-go input"
    return wording.clock(lane.clock.name, f"{lane.clock.steps:,.0f}")


def _outcome(lane: JudgedLane) -> str:
    if lane.outcome in ("falls", "diverges"):
        return f"{lane.outcome} at step {lane.end_step:,}"
    if lane.failed:
        return f"{lane.outcome} from step {lane.failed_step:,}"
    return f"{lane.outcome} for {lane.end_step:,} steps" if lane.outcome == "holds" else lane.outcome


def _world(render_env: RenderEnv) -> str:
    import gymnasium
    import mujoco

    return f"{render_env.env_id}, Gymnasium {gymnasium.__version__}, MuJoCo {mujoco.__version__}"
