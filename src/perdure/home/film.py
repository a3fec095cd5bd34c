"""Films of episodes: the oracle, or several release strategies side by side; also live in a browser.

An episode is run first and its states are kept (`record`); pictures are drawn from a copy of the scene afterwards, so
the trajectory is the same as in the protocol.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.film import GRAY, GREEN, INK, PALE, Picture, Row, annotate, check_film, tile, write_film
from perdure.home.agents.learned import SkillAgent
from perdure.home.evaluate.comparison import describe
from perdure.home.evaluate.execute import Executor, ExecutorOptions, Running
from perdure.home.evaluate.log import UNTRAINED, EpisodeLog, SkillRun
from perdure.home.evaluate.policies import ORACLE, SkillPolicy, make_agents
from perdure.home.evaluate.protocol import EvaluationProtocol, Vary
from perdure.home.pictures import CAMERAS, Follower, Shot, Studio, goal_marks, put, render_scene
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import short_name
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import SKILLS, Skill
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.planners import PlannerName
from perdure.home.tasks.tasks import SkillName, SkillStep

AFTERWARDS = 45
"""Control steps that are shown after the plan has ended."""
RATES = {".mp4": 30.0, ".gif": 12.5}
"""Pictures a second. GIFs count in hundredths of a second, and browsers slow down fast ones."""
TITLE, WORDS, SMALL = 18, 18, 13
"""Font sizes."""


@dataclass(frozen=True)
class FilmOptions:
    """Settings of a film."""

    camera: str = "follow"
    size: tuple[int, int] = (720, 480)
    """Width and height of the picture in pixels, without the text around it; both even."""
    speed: float = 4.0
    """Playback speed relative to real time."""
    seconds: float = math.inf
    """Simulated time after which the film ends, if the episode is not over before."""
    executor: ExecutorOptions = field(default_factory=ExecutorOptions)
    """Evaluation seed and settings of the world; the rest is chosen by `record`."""

    def __post_init__(self) -> None:
        """Raise PerdureError for numbers that make no film."""
        lookup(CAMERAS, self.camera, "camera")
        if not (self.speed > 0.0 and math.isfinite(self.speed)):
            raise PerdureError(f"the speed of a film must be above 0, not {self.speed}")
        if not self.seconds > 0.0:
            raise PerdureError(f"a film must last longer than 0 s, not {self.seconds}")
        if any(side % 2 for side in self.size):
            raise PerdureError(f"width and height of a film must be even, not {self.size[0]} x {self.size[1]}")


@dataclass(frozen=True)
class Agent:
    """Policies for all skills and a release strategy, with the texts written over its film."""

    title: str
    """Such as `ik: stop, lower 5 cm`; empty for no text."""
    caption: str
    """Where learned policies act and where the oracle does."""
    skill_agents: Mapping[str, SkillAgent]
    skills: Mapping[str, Skill]

    def rows(self, ended: bool) -> list[Row]:
        """Return the text over its film."""
        title = f"{self.title}{' (ended)' if ended else ''}"
        return [(TITLE, [(title, INK)]), (SMALL, [(self.caption, GRAY)])] if self.title else []


def make_agent(
    task: str,
    place: str,
    train_seed: int = 0,
    policies: Mapping[str, str] | None = None,
    vary: Vary = "all",
    planner: PlannerName = "open",
) -> Agent:
    """Return the agent of a release strategy.

    Args:
        task: Name of the task.
        place: Release strategy, see `perdure.home.evaluate.policies.read_release`.
        train_seed: Of the shipped policies.
        policies: Skill to file or "oracle", see `choose_policies`; else shipped policies, else the oracle.
        vary: Which policies are those of the training seed, see `EvaluationProtocol`.
        planner: The planner, which decides what skills there are.

    Raises:
        PerdureError: If strategy, skill or file do not exist.
    """
    options = ExecutorOptions(planner=planner)
    protocol = EvaluationProtocol(task, place, episodes=1, vary=vary, policies=policies or {}, options=options)
    chosen = protocol.policies_of(train_seed)
    skill_agents = make_agents(chosen, protocol.release.strategy)
    return Agent(f"{place}: {describe(place)}", acting(chosen), skill_agents, protocol.skills())


def acting(chosen: Mapping[SkillName, SkillPolicy]) -> str:
    """Return where learned policies act and where the oracle does, in words."""
    learned = [skill for skill, each in chosen.items() if each.learned]
    if not learned:
        return "the scripted oracle acts in every skill: there is no learned policy for any"
    if len(learned) == len(chosen):
        return "learned policies act in every skill"
    return f"learned: {', '.join(learned)}; the scripted oracle acts in the other skills"


@dataclass(frozen=True)
class Caption:
    """The caption of one step of an episode."""

    seconds: float
    """Simulated time since the start."""
    number: int
    """Number of skills that have begun."""
    words: str
    """Such as `pick the bowl`."""
    stages: tuple[tuple[str, bool], ...]
    """Names of the stages, and whether each was reached."""

    def rows(self, speed: float) -> list[Row]:
        """Return the text below a picture; stages turn green once they are reached. `speed` relative to real time."""
        pace = f"{speed:g} x real time" if speed != 1.0 else "real time"
        clock = f"skill {self.number}    {self.seconds:.1f} s    {pace}"
        stages = [(name.replace("_", " "), GREEN if done else PALE) for name, done in self.stages]
        return [(WORDS, [(self.words, INK)]), (SMALL, [(clock, GRAY)]), (SMALL, stages)]


def skill_words(episode: Episode, step: SkillStep | SkillRun) -> str:
    """Return what the robot does in a skill, such as `pick the bowl, attempt 2`."""
    if step.skill == "reset_arm":
        return "reset the arm"
    verb, _, kind = ((step.toward or "pick") if step.skill == "navigate" else step.skill).partition("_")
    words = f"{verb} the {kind or short_name(episode.objects[step.target].kind)}"
    words = f"navigate to {words}" if step.skill == "navigate" else words
    return f"{words}, attempt {step.attempt}{' (scripted)' if step.scripted else ''}" if step.attempt > 1 else words


@dataclass(frozen=True, eq=False)
class Frame:
    """An episode after a control step."""

    state: FloatArray
    """MuJoCo's `qpos`. Shape (nq,)."""
    caption: Caption
    focus: FloatArray | None
    """Point of the room that the skill is about, shape (3,)."""
    focused: int
    """Number of the object there, -1 for none."""


class _TimeOverError(Exception):
    """The time limit ended the episode."""


def record(
    episode: Episode,
    agent: Agent,
    options: ExecutorOptions | None = None,
    seconds: float = math.inf,
    show: Callable[[Frame], None] | None = None,
    *,
    strategy: str = "unnamed",
    train_seed: int = UNTRAINED,
) -> tuple[list[Frame], EpisodeLog | None]:
    """Run one episode and return a frame for each control step, and its log with its history.

    The log is None if the time limit ended the episode.

    Args:
        episode: The episode.
        agent: Policies and release strategy.
        options: Evaluation seed and settings of the world; one lane and one thread are used.
        seconds: Simulated time after which it is broken off.
        show: Called with every frame while the episode runs.
        strategy: Written into the log.
        train_seed: Written into the log.
    """
    frames: list[Frame] = []
    reached: list[str] = []
    lane = np.array([0])

    def observe(world: VectorSimulator, running: Mapping[int, Running]) -> None:
        now, step, state = running[0], running[0].current, world.sense(lane)
        facts, stages = now.facts(world, 0), episode.home_task.stages
        while len(reached) < len(stages) and stages[len(reached)].met(facts):
            reached.append(stages[len(reached)].name)
        words = "settling" if step is None else skill_words(episode, step)
        begun, seconds_now = len(now.recorder.ended) + (step is not None), (len(frames) + 1) / CONTROL_HZ
        caption = Caption(seconds_now, begun, words, tuple((each.name, each.name in reached) for each in stages))
        skill, target = "reset_arm" if step is None else step.skill, world.skill_goal(0).target
        near = {"pick": state.object, "place": state.goal, "navigate": state.aim}.get(skill, state.handle)
        focus = None if skill == "reset_arm" else near[0].copy()
        focused = target if skill in ("pick", "place") else -1
        frames.append(Frame(world.simulator(0).qpos.copy(), caption, focus, focused))
        if show is not None:
            show(frames[-1])
        if seconds_now >= seconds:
            raise _TimeOverError

    options = replace(options or ExecutorOptions(settle_steps=AFTERWARDS), lanes=1, threads=1)
    executor = Executor(agent.skills, agent.skill_agents, options, strategy=strategy, train_seed=train_seed)
    try:
        (log,) = executor.run([episode], observe)
    except _TimeOverError:
        return frames, None
    return frames, log


def film_episode(
    episode: Episode, path: Path, options: FilmOptions | None = None, agents: Sequence[Agent] = ()
) -> list[EpisodeLog | None]:
    """Film one episode, under several agents from left to right; those that end early hold their last picture.

    Args:
        episode: The episode.
        path: The film: `.mp4` or `.gif`.
        options: Settings; the size is that of one agent's picture.
        agents: Policies and release strategies; the oracle if there is none.

    Returns:
        A log for each agent, None where the film ended before the episode.
    """
    check_film(path)
    options, rate = options or FilmOptions(), RATES[path.suffix.lower()]
    executor, agents = replace(options.executor, settle_steps=AFTERWARDS), agents or [_oracle(episode)]
    recordings: list[tuple[list[Frame], EpisodeLog | None]] = []

    def pictures() -> Iterator[Picture]:
        with Studio(render_scene(episode, options.executor.eval_seed), options.size) as studio:
            recordings.extend(record(episode, agent, executor, options.seconds) for agent in agents)
            stride = CONTROL_HZ * options.speed / rate
            length = max(len(frames) for frames, _ in recordings)
            steps = [max(0, math.ceil(k * stride - 1e-9) - 1) for k in range(int(length / stride + 1e-9) + 1)]
            panels = [
                _panel(studio, episode, options, agent, frames, steps, 1.0 / rate)
                for agent, (frames, _) in zip(agents, recordings, strict=True)
            ]
            for row in zip(*panels, strict=True):
                yield tile(row, len(row))

    write_film(pictures(), path, rate)
    return [log for _, log in recordings]


def _oracle(episode: Episode) -> Agent:
    return replace(make_agent(episode.task, "rl", UNTRAINED, dict.fromkeys(SKILLS, ORACLE)), title="")


def _panel(
    studio: Studio,
    episode: Episode,
    options: FilmOptions,
    agent: Agent,
    frames: Sequence[Frame],
    steps: Sequence[int],
    seconds: float,
) -> Iterator[Picture]:
    """Yield the pictures of one agent at some steps, `seconds` apart on the screen; the last one stays."""
    marks, follower = goal_marks(episode), Follower(studio.simulator)

    def draw(frame: Frame, ended: bool) -> Picture:
        put(studio.simulator, frame.state)
        camera: str | Shot = options.camera
        if camera == "follow":
            camera = follower.shot(frame.focus, frame.focused, 0.0 if ended else seconds)
        return annotate(studio.take(camera, marks), agent.rows(ended), frame.caption.rows(options.speed))

    yield from (draw(frames[step], ended=False) for step in steps if step < len(frames))
    if over := sum(step >= len(frames) for step in steps):
        yield from repeat(draw(frames[-1], ended=True), over)


def serve_episode(
    episode: Episode, port: int = 8080, speed: float = 1.0, seed: int = 0, report: Callable[[str], None] = print
) -> None:
    """Show the oracle in an episode, over and over, on a page served by this machine.

    Args:
        episode: The episode.
        port: Port of the server.
        speed: Playback speed relative to real time.
        seed: Evaluation seed: draws the robot's start pose.
        report: Called with the address, and with each new step of the plan.

    Raises:
        PerdureError: If mjviser is not installed or the speed is not positive.
    """
    if not speed > 0.0:
        raise PerdureError(f"the speed must be above 0, not {speed}")
    try:
        import mjviser
        import viser
    except ImportError as error:
        raise PerdureError("a live view needs mjviser: pip install 'perdure[viewer]'") from error
    server: Any = viser.ViserServer(port=port, verbose=False)
    report(f"http://localhost:{server.get_port()}")
    try:
        while True:
            server.scene.reset()
            simulator = render_scene(episode, seed)
            scene = mjviser.ViserMujocoScene(server, simulator.model, num_envs=1)
            options = ExecutorOptions(eval_seed=seed, settle_steps=AFTERWARDS)
            record(episode, _oracle(episode), options, show=_player(simulator, scene, speed, report))
    finally:
        server.stop()


def _player(simulator: Simulator, scene: Any, speed: float, report: Callable[[str], None]) -> Callable[[Frame], None]:
    """Return a function that shows frames in a scene of mjviser at the playback speed."""
    began, words = time.monotonic(), ""

    def show(frame: Frame) -> None:
        nonlocal words
        put(simulator, frame.state)
        scene.update_from_mjdata(simulator.data)
        if frame.caption.words != words:
            words = frame.caption.words
            report(f"{frame.caption.seconds:6.1f} s  {words}")
        time.sleep(max(0.0, began + frame.caption.seconds / speed - time.monotonic()))

    return show
