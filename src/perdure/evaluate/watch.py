"""Films of policies: the failure, or the first disturbed seconds, with every push marked.

Episodes are judged first, in an environment that renders (`perdure.evaluate.replay`), and then repeated for the film.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from perdure.disturbances import CALM, Disturbance
from perdure.envs import OpenEnv, World, refuse_import
from perdure.envs.gymnasium import engine_of
from perdure.envs.world import FloatArray
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, EpisodeSpec, evaluate_episodes
from perdure.evaluate.judge import Baseline, judge_table
from perdure.evaluate.options import Condition, Extrapolation
from perdure.evaluate.reference import Idle, idle_baseline, with_reference
from perdure.evaluate.replay import (
    RATE,
    Camera,
    Instant,
    JudgedEpisode,
    RenderEnv,
    find_render_env,
    make_camera,
    replay,
    step_seconds,
)
from perdure.evaluate.table import episode_table, train_seed
from perdure.evaluate.verdict import ScoreScale
from perdure.film import (
    GRAY,
    GREEN,
    INK,
    RED,
    Picture,
    annotate,
    check_film,
    tile,
    write_film,
)
from perdure.horizon import Clock
from perdure.policy import PolicyLike
from perdure.report.outcomes import WORKED, outcome

Met: TypeAlias = Sequence[Disturbance]
SECONDS = 6.0
"""Seconds shown where nothing fails."""
BEFORE_PUSH = 1.0
"""Seconds shown before the first push, if it comes late."""
PUSH_SECONDS = 0.4
"""How long a push is marked in seconds."""
BEFORE = 5.0
"""Seconds shown before a failure."""
AFTER = 1.0
"""Seconds shown after a failure."""
MOST_WINDOW = 10.0
"""Most seconds shown of the window of rewards in which a silent failure begins."""
SCORE_STEPS = 100
"""Steps over which the score in the picture is taken."""
SIZE = (400, 300)
"""Width and height of a picture of a film in pixels."""
TITLE = 20
"""Font size of the first line above a picture."""
SUBTITLE = 14
"""Font size of the other lines above a picture."""
BELOW = 15
"""Font size of the line below a picture."""


@dataclass(frozen=True)
class Film:
    """A finished video and its facts."""

    path: Path
    episodes: tuple[JudgedEpisode, ...]
    """The panels from left to right."""
    world: str
    """Environment and engine that were filmed."""
    pictures: int

    @property
    def sentences(self) -> list[str]:
        """Description of the video."""
        found = []
        for episode in self.episodes:
            who, ending = episode.words
            named = f"{episode.policy}, {who}" if episode.policy else who
            found.append(f"{named}, start state {episode.eval_seed}: {ending}")
        return found


def watch(
    policies: PolicyLike | Mapping[str, PolicyLike],
    out: str | Path,
    *,
    clock: Clock | None = None,
    beside: Clock | None = None,
    disturb: Sequence[str] | None = None,
    until_failure: bool = False,
    steps: int = 10_000,
    eval_seeds: int = 10,
    first_eval_seed: int = 0,
    size: tuple[int, int] = SIZE,
    modules: Sequence[str] = (),
) -> Film:
    """Film the failure of a policy: 5 s before it and 1 s after it. Without a failure, film 6 s from the first push on.

    The left panel shows an episode that holds, if there is one. Pushes are marked by an arrow.

    Args:
        policies: A policy, beside itself when calm; or policies of one task by name, side by side.
        out: The film, .mp4, .gif or .webp.
        clock: Clock of the policies; None: their own clocks.
        beside: A second clock, from the same start state, over the same steps; shown in place of the calm episode.
        disturb: What the episodes meet, such as push:0.5; None: standard-1, as far as the environment can do it;
            ("none",): nothing.
        until_failure: Search for the first start state from which a policy fails under ``clock``. Otherwise the first
            start state is filmed.
        steps: Steps of each episode, unless it ends earlier.
        eval_seeds: Start states among which a failure is searched for.
        first_eval_seed: The first of them.
        size: Width and height of a panel's picture in pixels, even; environments without MuJoCo have their own.
        modules: Python modules that the policies' task may import.

    Raises:
        PerdureError: If Gymnasium lacks the environment, no episode fails, rendering fails, no policy takes the clock,
            the policies are for several tasks, or the file cannot be written.
    """
    out = Path(out)
    check_film(out)
    if steps < 1 or eval_seeds < 1:
        raise PerdureError(f"steps and eval_seeds must be at least 1, got {steps} and {eval_seeds}")
    if first_eval_seed < 0:
        raise PerdureError(f"first_eval_seed must be at least 0, got {first_eval_seed}")
    named = policies if isinstance(policies, Mapping) else {"": policies}
    task = _one_task(named)
    if (clock or beside) is not None and not any(policy.has_clock for policy in named.values()):
        raise PerdureError(f"this {task} policy has no time-to-go input, so it takes no clock")
    if beside is not None and len(named) > 1:
        raise PerdureError("a second clock is shown beside one policy, not beside several")
    refuse_import(task, modules, "the policy")
    render_env = find_render_env(task)
    source = render_env.open()
    condition = _condition(disturb, steps, source)
    idle = idle_baseline(source)
    judges = {name: Judge(policy, source, steps, idle, name) for name, policy in named.items()}

    # The start state, and an episode of each policy from there.
    seeds = range(first_eval_seed, first_eval_seed + (eval_seeds if until_failure else 1))
    episodes = _first_failing(judges, clock, condition, seeds)
    failed = [each for each in episodes if each.failed]
    if until_failure and not failed:
        label = "no clock" if clock is None else clock.label
        raise PerdureError(
            f"none of {eval_seeds} episodes of {steps:,} steps fails under {label} ({condition.label}); ask for more "
            "--steps or --eval-seeds, another --clock or --disturb"
        )
    # What is shown beside it.
    seed = episodes[0].eval_seed
    calm = replace(condition, label=CALM, disturbances=())
    if beside is not None:
        episodes += [judge.judge(beside, seed, condition) for judge in judges.values()]
    elif condition.disturbances and len(judges) == 1:
        episodes += [judge.judge(clock, seed, calm) for judge in judges.values()]
    with closing(render_env.build()) as env:
        scale = judges[failed[0].policy].scale if failed else None
        shown, rate = _shown_steps(env, scale, failed, condition.disturbances)
        world = f"{render_env.env_id}, {engine_of(env)}"

    episodes.sort(key=lambda each: (not outcome(each.outcome).good, bool(each.disturbances)))
    panels = [_panel(judges[each.policy], each, render_env, shown, size, world) for each in episodes]
    pictures = (tile(row, len(row)) for row in zip(*panels, strict=True))
    return Film(out, tuple(episodes), world, write_film(pictures, out, rate))


def _one_task(policies: Mapping[str, PolicyLike]) -> str:
    """Return the task of all policies; PerdureError if they have several."""
    tasks = sorted({policy.task.name for policy in policies.values()})
    if len(tasks) != 1:
        raise PerdureError(f"policies that are filmed side by side must be for one task, not for {', '.join(tasks)}")
    return tasks[0]


def _condition(disturb: Sequence[str] | None, steps: int, source: OpenEnv) -> Condition:
    """Return what the episodes meet: of several levels and of calm and disturbed, the last."""
    asked = Extrapolation(steps=steps, disturb=None if disturb is None else tuple(disturb))

    def make(met: Met) -> World:
        return source.make([FIRST_EVAL_SEED])

    with closing(make(())) as world:
        spec = world.spec
    conditions = asked.conditions(spec, make)
    if disturb is not None and len(conditions) > 1:
        raise PerdureError(f"a film shows one condition, not {', '.join(each.label for each in conditions)}")
    return conditions[-1]


def _first_failing(
    judges: Mapping[str, Judge], clock: Clock | None, condition: Condition, seeds: Sequence[int]
) -> list[JudgedEpisode]:
    """Return an episode of each policy from the first start state from which one fails, else from the last."""
    episodes = []
    for seed in seeds:
        episodes = [judge.judge(clock, seed, condition) for judge in judges.values()]
        if any(each.failed for each in episodes):
            break
    return episodes


class Judge:
    """Judges one policy's episodes, `steps` long if nothing ends them; measures it within the training horizon too."""

    def __init__(self, policy: PolicyLike, source: OpenEnv, steps: int, idle: Idle, name: str = "") -> None:
        measured = with_reference(policy, source)
        assert measured.reference is not None
        self.policy = measured
        self._source = source
        self._steps = steps
        self._name = name
        self.scale: ScoreScale = Baseline(measured.reference, idle).scale(policy.task.name)

    def judge(self, clock: Clock | None, eval_seed: int, condition: Condition) -> JudgedEpisode:
        """Run one episode; None: under the policy's own clock."""
        own: Clock | None = getattr(self.policy, "clock", None)
        used = (clock or own) if self.policy.has_clock else None
        met = condition.disturbances
        episode = EpisodeSpec(0, used, eval_seed, met, self._steps, condition.label)
        with closing(self._source.make([FIRST_EVAL_SEED + eval_seed])) as world:
            records = evaluate_episodes([self.policy], [episode], world=world)
        raw = episode_table(["policy"], [self.policy], [episode], records)
        frame = judge_table(raw, {("policy", train_seed(self.policy)): self.scale})
        last = frame.filter(frame["step"] == self._steps)
        word, at, end, total = last.select("outcome", "failed_step", "end_step", "return").row(0)
        return JudgedEpisode(used, eval_seed, word, at, end, total, met, condition.label, self._name)


def _shown_steps(env: Any, scale: ScoreScale | None, failed: Sequence[JudgedEpisode], met: Met) -> tuple[range, float]:
    """Return the steps to show, around the first failure or from the first push on, and the pictures per second."""
    seconds_per_step = step_seconds(env)
    stride = max(1, round(1.0 / (RATE * seconds_per_step)))
    rate = 1.0 / (stride * seconds_per_step)
    if not failed:
        length = round(SECONDS / seconds_per_step)
        pushed = max((each.first_step for each in met), default=0)
        first = 1
        if pushed > 0.5 * length:
            first = pushed - round(BEFORE_PUSH / seconds_per_step)
        return range(first, first + length, stride), rate
    failing = min(failed, key=lambda each: each.failed_step)
    before = round(BEFORE / seconds_per_step)
    after = round(AFTER / seconds_per_step)
    if scale is not None and not outcome(failing.outcome).by_end:  # a failure that no single step shows
        after += min(scale.window, round(MOST_WINDOW / seconds_per_step))
    return range(max(1, failing.failed_step - before), failing.failed_step + after + 1, stride), rate


def _panel(
    judge: Judge, episode: JudgedEpisode, render_env: RenderEnv, shown: range, size: tuple[int, int], world: str
) -> Iterator[Picture]:
    """Yield the pictures of one episode at some steps."""
    recent: deque[float] = deque(maxlen=SCORE_STEPS)
    who, ending = episode.words
    color = RED if episode.failed else INK
    if outcome(episode.outcome).good:
        color = GREEN
    title = f"{who}: {ending}"
    below_title = world
    if episode.policy:
        title = f"{episode.policy}: {ending}"
        below_title = who
    above = [(TITLE, [(title, color)]), (SUBTITLE, [(below_title, GRAY)])]
    with ExitStack() as stack:
        take: Camera | None = None
        pushed = -math.inf
        push: FloatArray | None = None
        for instant in replay(judge.policy, episode, render_env, shown.stop - 1):
            recent.append(instant.reward)
            if instant.push is not None:
                push = instant.push
                pushed = instant.step
            if instant.step > pushed + PUSH_SECONDS / step_seconds(instant.env):
                push = None
            if instant.step not in shown:
                continue
            take = take or make_camera(instant.env, size, stack)
            failed = episode.failed and instant.step >= episode.failed_step
            edge = RED if failed else None
            below = [(BELOW, [(_caption(judge, episode, instant, recent, push), INK)])]
            yield annotate(take(push), above, below, edge)


def _caption(
    judge: Judge, episode: JudgedEpisode, instant: Instant, recent: Sequence[float], push: FloatArray | None
) -> str:
    """Return the line under a picture: the step, a push, and the score of the last steps."""
    parts = [f"step {instant.step:,}"]
    if push is not None:
        parts.append(f"push {np.linalg.norm(push):.2f} m/s")
    if instant.step > episode.end_step:
        parts.append(f"ended at step {episode.end_step:,}")
    elif judge.scale.policy_state == WORKED:
        score = float(judge.scale.score(np.array(sum(recent) / len(recent))))
        parts.append(f"score {round(score, 2) + 0.0:.2f} (last {len(recent)} steps)")
    return "   ".join(parts)
