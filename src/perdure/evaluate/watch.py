"""Films of policies: the failure, or the first disturbed seconds, with every push marked.

EnvPool cannot render, so a film shows the Gymnasium environment of the same name. Robots of one name move alike in
both, up to rounding (`tests/envs/test_gymnasium_parity.py`): the two use different builds of MuJoCo. After some hundred
steps with contacts the trajectories differ. The failure is therefore searched for in the Gymnasium environment. Any
other environment of Gymnasium that renders rgb_array is filmed by itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from perdure.disturbances import CALM, Disturbance, root_velocity
from perdure.envs import GymnasiumWorld, OpenEnv, World, refuse_import, task_spec
from perdure.envs.disturbances import SIMULATED, DisturbedWorld
from perdure.envs.envpool import STEP_SECONDS
from perdure.envs.gymnasium import call, engine_of, make_env, read_observation
from perdure.envs.suites import GYMNASIUM_PREFIX, ROBOTS, is_contract
from perdure.envs.world import FloatArray, IntArray, Step
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED, EpisodeSpec, evaluate_episodes
from perdure.evaluate.judge import Baseline, judge_table
from perdure.evaluate.options import Condition, Extrapolation
from perdure.evaluate.reference import Idle, idle_baseline, with_reference
from perdure.evaluate.table import episode_table, train_seed
from perdure.evaluate.verdict import ScoreScale
from perdure.film import (
    AMBER,
    GRAY,
    GREEN,
    INK,
    RED,
    SUPERSAMPLING,
    Picture,
    Renderer,
    annotate,
    check_film,
    tile,
    write_film,
)
from perdure.horizon import Clock
from perdure.policy import ClosedLoop, EpisodePolicy, PolicyLike
from perdure.policy.network import one_thread
from perdure.report import wording
from perdure.report.outcomes import WORKED, Diverges, Falls, failures, outcome

Met: TypeAlias = Sequence[Disturbance]
Camera: TypeAlias = Callable[..., Picture]
"""Takes a picture of an environment; it may be given a push (see `Instant`)."""
SECONDS = 6.0
"""Seconds shown where nothing fails."""
BEFORE_PUSH = 1.0
"""Seconds shown before the first push, if it comes late."""
PUSH_SECONDS = 0.4
"""How long a push is marked in seconds."""
ARROW = 0.2
"""Length of the arrow that marks a push, of the camera's distance."""
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
SIZE = (400, 300)
"""Width and height of a picture of a film in pixels."""
MOST_SHARP = 100_000
"""Pictures of at most so many pixels are averaged from larger ones; for others that takes too long."""
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
    condition: str = CALM
    """The same, as tables name it."""
    policy: str = ""
    """Name of its policy; "": the film shows one policy."""

    @property
    def failed(self) -> bool:
        """Whether it falls, diverges, decays or fails silently."""
        return self.outcome in failures()

    @property
    def words(self) -> tuple[str, str]:
        """Clock and disturbances, and outcome, in words."""
        told = []
        if self.clock is not None:
            told.append(wording.clock(self.clock.name, f"{self.clock.steps:,.0f}"))
        if self.condition != CALM:
            told.append(f"under {self.condition}")
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


@dataclass(frozen=True, eq=False)
class Instant:
    """The episode after a step."""

    step: int
    reward: float
    total: float
    """Return so far; steps after the end do not count."""
    env: Any
    """The environment in the state after this step."""
    push: FloatArray | None = None
    """Change of the root's velocity by a push before this step [m/s], shape (3,)."""


class _PushedWorld(GymnasiumWorld):
    """A world of one robot that notices pushes: its velocity changes between two steps."""

    push: FloatArray | None = None
    """See `Instant`; of the last step."""
    _velocities: FloatArray | None = None

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        env = self.environments[0].unwrapped
        self.push = None
        if self._velocities is not None and not np.array_equal(self._velocities, env.data.qvel):
            self.push = root_velocity(env.model, env.data.qvel - self._velocities)
        step = super().step(actions, lanes)
        if hasattr(env, "mujoco_renderer"):
            self._velocities = env.data.qvel.copy()
        return step


def replay(policy: PolicyLike, episode: JudgedEpisode, render_env: RenderEnv, stop: int) -> Iterator[Instant]:
    """Yield each step of a judged episode, and of what the robot does after its end, up to step ``stop``.

    Raises:
        PerdureError: If the episode is not the one that was judged.
    """
    env = render_env.build()
    seeds = [FIRST_EVAL_SEED + episode.eval_seed]
    kind = outcome(episode.outcome)
    robot = _PushedWorld([lambda: env], seeds)
    world: World = robot
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
                yield Instant(step, float(result.rewards[0]), total, env, robot.push)
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
        super().__init__(model, size, SUPERSAMPLING if size[0] * size[1] <= MOST_SHARP else 1)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION.value] = 0  # half of the time on a processor
        config = getattr(env.unwrapped.mujoco_renderer, "default_cam_config", None) or {}
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING.value
        self._camera.trackbodyid = int(config.get("trackbodyid", BODY))
        self._camera.distance = float(config.get("distance", 1.5 * model.stat.extent))
        self._camera.azimuth = AZIMUTH
        self._camera.elevation = ELEVATION

    def take(self, push: FloatArray | None = None) -> Picture:
        """Return a picture of the simulation as it is now, with an arrow for a push."""
        if push is None or not np.any(push):
            return self.draw(self._data, self._camera)
        return self.draw(self._data, self._camera, partial(self._add_arrow, push / np.linalg.norm(push)))

    def _add_arrow(self, direction: FloatArray) -> None:
        """Add an arrow that ends at the robot's torso."""
        import mujoco

        length = ARROW * self._camera.distance
        end = self._data.xpos[BODY]
        arrow = self.scene.geoms[self.scene.ngeom]
        kind = mujoco.mjtGeom.mjGEOM_ARROW.value
        color = np.array([*np.divide(AMBER, 255.0), 1.0], np.float32)
        mujoco.mjv_initGeom(arrow, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color)
        # MuJoCo draws an arrow half as long as the distance of the points that it connects.
        start = end - length * direction
        mujoco.mjv_connector(arrow, kind, 0.07 * length, start, end + length * direction)
        arrow.emission = 0.6
        self.scene.ngeom += 1


def _own_picture(env: Any, push: FloatArray | None = None) -> Picture:
    """Return the picture that an environment renders itself, cut to an even width and height; pushes are not drawn."""
    picture = np.asarray(call(str(env.spec.id), "render", env.render))
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise PerdureError(f"{env.spec.id}: render must return bytes of shape (height, width, 3), not {picture.shape}")
    return picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]


def make_camera(env: Any, size: tuple[int, int], stack: ExitStack) -> Camera:
    """Return a function that takes a picture of an environment, perhaps with a push."""
    if hasattr(env.unwrapped, "mujoco_renderer"):
        return stack.enter_context(RobotCamera(env, size)).take
    return partial(_own_picture, env)


def step_seconds(env: Any) -> float:
    """Return the seconds of a step of an environment."""
    return float(getattr(env.unwrapped, "dt", 0.0) or 1.0 / (env.metadata.get("render_fps") or RATE))


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
