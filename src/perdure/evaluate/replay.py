"""Episodes in environments that render: what was judged is repeated step by step, before a camera.

EnvPool cannot render, so the Gymnasium environment of the same name is shown. Robots of one name move alike in both, up
to rounding (`tests/envs/test_gymnasium_parity.py`): the two use different builds of MuJoCo. After some hundred steps
with contacts the trajectories differ. The failure is therefore searched for in the Gymnasium environment. Any other
environment of Gymnasium that renders rgb_array is shown by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np

from perdure.disturbances import CALM, Disturbance, root_velocity
from perdure.envs import GymnasiumWorld, OpenEnv, World, task_spec
from perdure.envs.disturbances import SIMULATED, DisturbedWorld
from perdure.envs.envpool import STEP_SECONDS
from perdure.envs.gymnasium import call, make_env, read_observation
from perdure.envs.suites import GYMNASIUM_PREFIX, ROBOTS, is_contract
from perdure.envs.world import FloatArray, IntArray, Step
from perdure.errors import PerdureError
from perdure.evaluate.episodes import FIRST_EVAL_SEED
from perdure.film import AMBER, SUPERSAMPLING, Picture, Renderer
from perdure.horizon import Clock
from perdure.policy import ClosedLoop, EpisodePolicy, PolicyLike
from perdure.policy.network import one_thread
from perdure.report import wording
from perdure.report.outcomes import Diverges, Falls, failures, outcome

Camera: TypeAlias = Callable[..., Picture]
"""Takes a picture of an environment; it may be given a push (see `Instant`)."""
RATE = 25.0
"""Pictures per second, at most."""
ARROW = 0.2
"""Length of the arrow that marks a push, of the camera's distance."""
MOST_SHARP = 100_000
"""Pictures of at most so many pixels are averaged from larger ones; for others that takes too long."""
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
    disturbances: Sequence[Disturbance] = ()
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
        """Render the current state of the simulation, with an arrow for a push."""
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
