"""Films of a policy, at its failure or from its first step, and stills of a failure for the page of a table.

EnvPool cannot render, so a film shows the Gymnasium environment of the same name. Robots of one name move alike in
both, up to rounding (`tests/envs/test_gymnasium_parity.py`): the two use different builds of MuJoCo. After some hundred
steps with contacts the trajectories differ. The failure is therefore searched for in the Gymnasium environment. Any
other environment of Gymnasium that renders rgb_array is filmed by itself.

Stills replay an episode of a table that Gymnasium ran; disturbed ones mostly are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from perdure.disturbances import Disturbance, applied_disturbances, check_onsets, labels, parse_disturbances
from perdure.envs import GymnasiumWorld, OpenEnv, World, refuse_import, task_spec
from perdure.envs.disturbances import SIMULATED, DisturbedWorld, disturbed_task
from perdure.envs.envpool import STEP_SECONDS
from perdure.envs.gymnasium import call, engine_of, make_env, read_observation
from perdure.envs.suites import GYMNASIUM_PREFIX, ROBOTS, is_contract
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, EpisodeSpec, evaluate_episodes
from perdure.evaluate.judge import Baseline, judge_table
from perdure.evaluate.reference import idle_baseline, task_env, with_reference
from perdure.evaluate.run import read_file
from perdure.evaluate.table import episode_table, file_note, train_seed
from perdure.evaluate.verdict import ScoreScale
from perdure.film import GRAY, GREEN, INK, RED, Picture, Renderer, annotate, check_film, save_picture, tile, write_film
from perdure.horizon import Clock, parse_clock
from perdure.policy import ClosedLoop, EpisodePolicy, Policy, PolicyLike
from perdure.policy.network import one_thread
from perdure.policy.onnx import model_digest
from perdure.report import wording
from perdure.report.groups import NO_CLOCK
from perdure.report.outcomes import WORKED, Diverges, Falls, failures, outcome, outcomes
from perdure.report.page import STILLS
from perdure.runs import Unit, Work, config_digest, run_missing, versions, write_atomic

if TYPE_CHECKING:
    import polars as pl

Met: TypeAlias = tuple[Disturbance, ...]
BEFORE = 5.0
"""Seconds shown before a failure."""
AFTER = 1.0
"""Seconds shown after a failure."""
MOST_WINDOW = 10.0
"""Most seconds shown of the window of rewards in which a silent failure begins."""
RATE = 25.0
"""Pictures per second, at most."""
SCORE_STEPS = 100
"""Steps over which the score in the picture is taken."""
SIZE = (480, 360)
"""Width and height of a picture of a film in pixels."""
STILL_SIZE = (352, 264)
"""Width and height of a still in pixels."""
COLORS = 96
"""Colors of the stills, a fifth of the bytes of all colors."""
TITLE = 20
"""Font size of the first line above a picture."""
SUBTITLE = 14
"""Font size of the other lines above a picture."""
BELOW = 15
"""Font size of the line below a picture."""
BODY = 1
"""The camera follows the first body after the world, the robot's torso, unless the environment says otherwise."""
AZIMUTH = 90.0
"""Of the camera in degrees: Gymnasium's robots run to the right."""
ELEVATION = -15.0
"""Of the camera in degrees: seen from above."""

VERSIONS = {"v2": "v4", "v3": "v4", "v4": "v4", "v5": "v5"}
"""EnvPool's version to Gymnasium's, whose v2 and v3 need mujoco-py; v4 has the same dynamics and rewards."""


@dataclass(frozen=True, eq=False)
class JudgedEpisode:
    """One episode and its outcome."""

    clock: Clock | None
    eval_seed: int
    outcome: str
    """As in the table: "holds", "falls", ..."""
    failed_step: int
    """Steps completed before the failure began; without a failure, all steps of the episode."""
    end_step: int
    total: float
    """Its return."""
    disturbances: Met = ()
    """What it meets."""

    @property
    def failed(self) -> bool:
        """Whether it falls, diverges, decays or fails silently."""
        return self.outcome in failures()

    @property
    def words(self) -> tuple[str, str]:
        """Clock and disturbances, and outcome, in words."""
        told = [] if self.clock is None else [wording.clock(self.clock.name, f"{self.clock.steps:,.0f}")]
        told += [f"under {labels(self.disturbances)}"] if self.disturbances else []
        kind = outcome(self.outcome)
        when = ""
        if kind.by_end:
            when = f" at step {self.end_step:,}"
        elif self.failed:
            when = f" from step {self.failed_step:,}"
        elif kind.good:
            when = f" for {self.end_step:,} steps"
        return ", ".join(told) or "calm", self.outcome + when


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
        words = [(*episode.words, episode.eval_seed) for episode in self.episodes]
        return [f"{clock}, start state {seed}: {ending}" for clock, ending, seed in words]


def watch(
    policy: PolicyLike,
    out: str | Path,
    *,
    clock: Clock | None = None,
    beside: Clock | None = None,
    disturb: Sequence[str] = (),
    until_failure: bool = False,
    steps: int = 10_000,
    eval_seeds: int = 10,
    first_eval_seed: int = 0,
    size: tuple[int, int] = SIZE,
    modules: Sequence[str] = (),
) -> Film:
    """Film a policy; the left panel shows an episode that holds, if there is one.

    Args:
        policy: The policy.
        out: The film, .mp4, .gif or .webp.
        clock: Clock of the policy; None: its own clock.
        beside: A second clock, from the same start state, over the same steps.
        disturb: What the episode meets, such as push:0.5. A calm episode is shown beside it, unless there is `beside`.
        until_failure: Search for the first start state from which the policy fails under ``clock``, and film 5 s before
            the failure and 1 s after it. Otherwise film the first 6 s from the first start state.
        steps: Steps of each episode, unless it ends earlier.
        eval_seeds: Start states among which a failure is searched for.
        first_eval_seed: The first of them.
        size: Width and height of a panel's picture in pixels, even; environments without MuJoCo have their own.
        modules: Python modules that the policy's task may import.

    Raises:
        PerdureError: If Gymnasium lacks the environment, no episode fails, rendering fails, the policy takes no clock,
            or the file cannot be written.
    """
    out = Path(out)
    check_film(out)
    if steps < 1 or eval_seeds < 1:
        raise PerdureError(f"steps and eval_seeds must be at least 1, got {steps} and {eval_seeds}")
    if first_eval_seed < 0:
        raise PerdureError(f"first_eval_seed must be at least 0, got {first_eval_seed}")
    clock = clock or getattr(policy, "clock", None)
    met = parse_disturbances(disturb)
    check_onsets(met, steps)
    if not policy.has_clock and (clock or beside) is not None:
        raise PerdureError(f"this {policy.task.name} policy has no time-to-go input, so it takes no clock")
    refuse_import(policy.task.name, modules, "the policy")
    render_env = find_render_env(policy.task.name)
    judge = Judge(policy, render_env.open(), steps)
    seeds = range(first_eval_seed, first_eval_seed + eval_seeds)
    judged = judge.judge(clock, seeds if until_failure else seeds[:1], met)
    if (episode := next((each for each in judged if each.failed or not until_failure), None)) is None:
        raise PerdureError(
            f"none of {eval_seeds} episodes of {steps:,} steps fails under "
            f"{'no clock' if clock is None else clock.label}; ask for more --steps or --eval-seeds, another --clock or "
            "--disturb"
        )
    episodes = [episode]
    if beside is not None or met:
        episodes += judge.judge(beside or clock, [episode.eval_seed], () if beside is None else met)
    episodes.sort(key=lambda each: (not outcome(each.outcome).good, bool(each.disturbances)))
    with closing(render_env.build()) as env:
        shown, rate = _shown_steps(env, judge.scale, episode if until_failure else None)
        world = f"{render_env.env_id}, {engine_of(env)}"

    panels = [_panel(judge, each, render_env, shown, size, world) for each in episodes]
    pictures = (tile(row, len(row)) for row in zip(*panels, strict=True))
    return Film(out, tuple(episodes), world, write_film(pictures, out, rate))


@dataclass(frozen=True)
class RenderEnv:
    """An environment of Gymnasium: one of its MuJoCo robots, any other that renders rgb_array, or a contract."""

    env_id: str

    def build(self) -> Any:
        """Return a new environment without a step limit."""
        if is_contract(self.env_id):
            return make_env(f"{ROBOTS}:perdure/VelocityCommand-v0", robot=self.env_id, render_mode="rgb_array")
        env = make_env(self.env_id)
        if not hasattr(env.unwrapped, "mujoco_renderer"):
            modes = env.metadata.get("render_modes", [])
            env.close()
            if "rgb_array" not in modes:
                raise PerdureError(f"{self.env_id} cannot be filmed: it renders {modes}, and not rgb_array")
            env = make_env(self.env_id, render_mode="rgb_array")
        return env

    def open(self) -> OpenEnv:
        """Return a source of worlds of this environment."""
        name = self.env_id if is_contract(self.env_id) else f"{GYMNASIUM_PREFIX}{self.env_id}"
        spec = task_spec(name)
        limit = spec.default_horizon if spec.has_step_limit else None
        return OpenEnv(lambda seeds: GymnasiumWorld([self.build] * len(seeds), seeds, name, default_horizon=limit))


def find_render_env(task: str) -> RenderEnv:
    """Return the environment that is rendered in place of a task such as "Hopper-v3"; PerdureError if there is none."""
    import_module("perdure.envs.copies")  # registers them
    if task.startswith(GYMNASIUM_PREFIX) or is_contract(task):
        return RenderEnv(task.removeprefix(GYMNASIUM_PREFIX))
    robot, _, version = task.partition("-")
    if robot not in STEP_SECONDS or version not in VERSIONS:
        raise PerdureError(
            f"{task} cannot be filmed; films exist for {', '.join(STEP_SECONDS)}, and for environments of Gymnasium "
            "that render rgb_array (gymnasium:ID); for the home benchmark, see perdure home video"
        )
    name = SIMULATED.get(f"{robot}-{version}".replace("v2", "v3"), f"{robot}-{VERSIONS[version]}")
    return RenderEnv(name.removeprefix(GYMNASIUM_PREFIX))


class Judge:
    """Judges one policy's episodes, `steps` long if nothing ends them; measures it within the training horizon too."""

    def __init__(self, policy: PolicyLike, source: OpenEnv, steps: int) -> None:
        # The stored reference may have been measured with another engine.
        measured = with_reference(replace(policy, reference=None) if isinstance(policy, Policy) else policy, source)
        assert measured.reference is not None
        self.policy = measured
        self._source = source
        self._steps = steps
        baseline = Baseline(measured.reference, idle_baseline(source))
        self.scale: ScoreScale = baseline.scale(policy.task.name)

    def judge(self, clock: Clock | None, eval_seeds: Sequence[int], met: Met = ()) -> list[JudgedEpisode]:
        """Run one episode from each start state."""
        episodes = [EpisodeSpec(0, clock, seed, met, self._steps) for seed in eval_seeds]
        with closing(self._source.make([FIRST_EVAL_SEED + seed for seed in eval_seeds])) as world:
            records = evaluate_episodes([self.policy], episodes, world=world)
        raw = episode_table(["policy"], [self.policy], episodes, records)
        frame = judge_table(raw, {("policy", train_seed(self.policy)): self.scale})
        last = frame.filter(frame["step"] == self._steps)
        rows = last.select("eval_seed", "outcome", "failed_step", "end_step", "return").iter_rows()
        return [JudgedEpisode(clock, seed, word, at, end, total, met) for seed, word, at, end, total in rows]


@dataclass(frozen=True, eq=False)
class Instant:
    """The episode after a step."""

    step: int
    reward: float
    total: float
    """Return so far; steps after the end do not count."""
    env: Any
    """The environment in the state after this step."""


def replay(policy: PolicyLike, episode: JudgedEpisode, render_env: RenderEnv, stop: int) -> Iterator[Instant]:
    """Yield each step of a judged episode, and of what the robot does after its end, up to step ``stop``.

    Raises:
        PerdureError: If the episode is not the one that was judged.
    """
    env = render_env.build()
    seeds = [FIRST_EVAL_SEED + episode.eval_seed]
    kind = outcome(episode.outcome)
    world: World = GymnasiumWorld([lambda: env], seeds)
    if episode.disturbances:
        world = DisturbedWorld(world, episode.disturbances, seeds, policy.observation_std[None])
    try:
        with one_thread():
            loop = ClosedLoop(world, [EpisodePolicy(policy, episode.clock)])
            total = 0.0
            for step in range(1, min(stop, episode.end_step) + 1):
                result = loop.advance().step
                total += float(result.rewards[0])
                ended = result.ended if kind.by_goal else result.terminated
                if bool(ended[0]) != (step == episode.end_step and (kind.by_goal or episode.outcome == Falls.name)):
                    raise PerdureError(f"the episode of start state {episode.eval_seed} is not the one that was judged")
                yield Instant(step, float(result.rewards[0]), total, env)
            if stop >= episode.end_step and episode.outcome != Diverges.name and not math.isclose(total, episode.total):
                raise PerdureError(
                    f"the episode returned {total:.6g} when it was filmed and {episode.total:.6g} when judged"
                )
            observations = result.observations
            space = env.action_space
            acting = policy.start([episode.clock])
            for step in range(episode.end_step + 1, stop + 1):
                action = acting.act(observations, step - 1)[0]
                observation, reward, *_ = env.step(action.reshape(space.shape).astype(space.dtype))
                observations = read_observation(render_env.env_id, "step", env.observation_space, observation)[None]
                yield Instant(step, float(reward), total, env)
    finally:
        world.close()


class RobotCamera(Renderer):
    """A camera that follows the robot of one MuJoCo environment of Gymnasium."""

    def __init__(self, env: Any, size: tuple[int, int]) -> None:
        import mujoco

        model = copy(env.unwrapped.model)
        self._data = env.unwrapped.data
        # Floors are drawn without an edge, as in the simulation: robots run far. Their texture repeats every meter.
        floors = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
        model.geom_size[floors, :2] = 0.0
        materials = model.geom_matid[floors]
        model.mat_texuniform[materials[materials >= 0]] = 1
        model.mat_texrepeat[materials[materials >= 0]] = 1.0
        super().__init__(model, size)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION.value] = 0  # half of the time on a processor
        config = getattr(env.unwrapped.mujoco_renderer, "default_cam_config", None) or {}
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING.value
        self._camera.trackbodyid = int(config.get("trackbodyid", BODY))
        self._camera.distance = float(config.get("distance", 1.5 * model.stat.extent))
        self._camera.azimuth = AZIMUTH
        self._camera.elevation = ELEVATION

    def take(self) -> Picture:
        """Return a picture of the simulation as it is now."""
        return self.draw(self._data, self._camera)


def _own_picture(env: Any) -> Picture:
    """Return the picture that an environment renders itself, cut to an even width and height."""
    picture = np.asarray(call(str(env.spec.id), "render", env.render))
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise PerdureError(f"{env.spec.id}: render must return bytes of shape (height, width, 3), not {picture.shape}")
    return picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]


def _camera(env: Any, size: tuple[int, int], stack: ExitStack) -> Callable[[], Picture]:
    """Return a function that takes a picture of an environment."""
    if hasattr(env.unwrapped, "mujoco_renderer"):
        return stack.enter_context(RobotCamera(env, size)).take
    return partial(_own_picture, env)


def _step_seconds(env: Any) -> float:
    return float(getattr(env.unwrapped, "dt", 0.0) or 1.0 / (env.metadata.get("render_fps") or RATE))


def _shown_steps(env: Any, scale: ScoreScale, failing: JudgedEpisode | None) -> tuple[range, float]:
    """Return the steps to show, around a failure or from the first one, and the pictures per second."""
    seconds_per_step = _step_seconds(env)
    stride = max(1, round(1.0 / (RATE * seconds_per_step)))
    before, after = (round(seconds / seconds_per_step) for seconds in (BEFORE, AFTER))
    middle = before if failing is None else failing.failed_step
    if failing is not None and not outcome(failing.outcome).by_end:  # a failure that no single step shows
        after += min(scale.window, round(MOST_WINDOW / seconds_per_step))
    return range(max(1, middle - before), middle + after + 1, stride), 1.0 / (stride * seconds_per_step)


def _panel(
    judge: Judge, episode: JudgedEpisode, render_env: RenderEnv, shown: range, size: tuple[int, int], world: str
) -> Iterator[Picture]:
    """Yield the pictures of one episode at some steps."""
    recent: deque[float] = deque(maxlen=SCORE_STEPS)
    clock, ending = episode.words
    color = RED if episode.failed else INK
    if outcome(episode.outcome).good:
        color = GREEN
    above = [(TITLE, [(f"{clock}: {ending}", color)]), (SUBTITLE, [(world, GRAY)])]
    with ExitStack() as stack:
        take: Callable[[], Picture] | None = None
        for instant in replay(judge.policy, episode, render_env, shown.stop - 1):
            recent.append(instant.reward)
            if instant.step not in shown:
                continue
            now = f"step {instant.step:,}"
            if instant.step > episode.end_step:
                now += f"   ended at step {episode.end_step:,}"
            elif judge.scale.policy_state == WORKED:
                score = float(judge.scale.score(np.array(sum(recent) / len(recent))))
                now += f"   score against its own training {round(score, 2) + 0.0:.2f} (last {len(recent)} steps)"
            take = take or _camera(instant.env, size, stack)
            failed = episode.failed and instant.step >= episode.failed_step
            yield annotate(take(), above, [(BELOW, [(now, INK)])], RED if failed else None)


# Stills


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
        apart = max(1, round(seconds / _step_seconds(env)))
    captions = {max(1, at - apart): f"{seconds:g} s before", 1: "start", at: episode.outcome}
    captions[at + apart] = f"{seconds:g} s after"
    with ExitStack() as stack:
        take: Callable[[], Picture] | None = None
        for instant in replay(policy, episode, render_env, at + apart):
            if instant.step in captions:
                take = take or _camera(instant.env, STILL_SIZE, stack)
                color = INK if instant.step < at else RED
                said = [(BELOW, [(f"step {instant.step:,}: {captions[instant.step]}", color)])]
                pictures.append(annotate(take(), below=said, edge=None if instant.step < at else RED))
    clock = replace(episode, disturbances=()).words[0]
    who += (f", {clock}" if episode.clock else "") + f", start state {episode.eval_seed}: {episode.words[1]}"
    above = [(SUBTITLE, [(who, RED)]), (SUBTITLE, [(world, GRAY)])]
    (work.folder / STILLS).unlink(missing_ok=True)  # of an attempt that was interrupted
    save_picture(annotate(tile(pictures, 2), above), work.folder / STILLS, COLORS)
