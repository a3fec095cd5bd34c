"""Films of episodes, or of one release, with several agents side by side; also live in a browser.

An episode is run first and its states are kept (`record`); pictures are drawn from a copy of the scene afterwards, so
the trajectory is the same as in the protocol.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.film import GRAY, GREEN, INK, PALE, Color, Picture, Row, annotate, check_film, tile, write_film
from perdure.home.evaluate.comparison import describe
from perdure.home.evaluate.execute import Executor, Running
from perdure.home.evaluate.log import EpisodeLog, SkillRun
from perdure.home.evaluate.outcomes import placement
from perdure.home.evaluate.policies import SkillPolicy, make_agents
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.pictures import (
    CAMERAS,
    COLORS,
    Follower,
    Line,
    Mark,
    Shot,
    Studio,
    goal_marks,
    overview,
    put,
    render_scene,
)
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import short_name
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.sensors import PrivilegedState
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.errands import Errand
from perdure.home.tasks.planners import find_planner
from perdure.home.tasks.tasks import SKILL_CONTAINERS, SKILL_VERBS, SkillName, SkillStep, Verb

BEFORE = 45
AFTERWARDS = 90
"""Control steps that are shown before a release, and after it or after the end of the plan."""
MARGIN = 0.9
"""Margin around the robot's way in overviews in [m]."""
RATES = {".mp4": 30.0, ".gif": 12.5, ".webp": 12.5}
"""Pictures a second. GIFs count in hundredths of a second, and browsers slow down fast ones."""
TITLE = 18
WORDS = 18
SMALL = 13
"""Font sizes."""


@dataclass(frozen=True)
class Agent:
    """What acts: the policies of a training seed in a protocol.

    Raises:
        PerdureError: If a policy is missing.
    """

    protocol: EvaluationProtocol
    train_seed: int = 0

    def __post_init__(self) -> None:
        _ = self.policies

    @cached_property
    def policies(self) -> Mapping[SkillName, SkillPolicy]:
        """The policy of each skill."""
        return self.protocol.policies_of(self.train_seed)

    @property
    def title(self) -> str:
        """Such as `stop first, drag only`."""
        return describe(self.protocol.strategy)

    @property
    def caption(self) -> str:
        """Its name in logs, where learned policies act, and where the oracle does."""
        learned = [skill for skill, each in self.policies.items() if each.learned]
        if not learned:
            words = "the scripted oracle"
        elif len(learned) == len(self.policies):
            words = "learned policies"
        else:
            words = f"learned: {', '.join(learned)}; the scripted oracle acts in the other skills"
        options = self.protocol.options
        if learned and find_planner(options.planner).has_fallback and options.fallback == "oracle":
            words += ", after three failures the oracle"
        return f"{self.protocol.strategy.name}: {words}"


def caption(words: str, clock: str, stages: Iterable[tuple[str, bool]] = ()) -> list[Row]:
    """Return the text below a picture; the names of stages turn green once they are reached."""
    rows: list[Row] = [(WORDS, [(words, INK)]), (SMALL, [(clock, GRAY)])]
    names = [(name.replace("_", " "), GREEN if done else PALE) for name, done in stages]
    if names:
        rows.append((SMALL, names))
    return rows


def skill_words(episode: Episode, step: SkillStep | SkillRun) -> str:
    """Return what the robot does in a skill, such as `pick the bowl, attempt 2`."""
    if step.skill == Verb.RESET_ARM:
        return "reset the arm"
    skill = step.skill
    prefix = ""
    if step.skill == Verb.NAVIGATE:
        skill = step.toward or Verb.PICK.value
        prefix = "navigate to "
    thing = SKILL_CONTAINERS.get(skill) or short_name(episode.objects[step.target].kind)
    words = f"{prefix}{SKILL_VERBS.get(skill, skill)} the {thing}"
    if step.attempt > 1:
        words += f", attempt {step.attempt}"
        if step.scripted:
            words += " (scripted)"
    return words


@dataclass(frozen=True, eq=False)
class Frame:
    """An episode after a control step."""

    state: FloatArray
    """MuJoCo's `qpos`. Shape (nq,)."""
    seconds: float
    """Simulated time since the start."""
    words: str
    """What the robot does."""
    caption: Sequence[Row]
    focus: FloatArray | None
    """Point of the room that the skill is about, shape (3,)."""
    focused: int
    """Number of the object there, -1 for none."""
    path: Line = ()
    """Where a released object has been."""


def record(
    episode: Episode, agent: Agent, show: Callable[[Frame], None] = lambda frame: None
) -> tuple[list[Frame], EpisodeLog]:
    """Run one episode and return a frame for each control step, and its log with its history.

    Args:
        episode: The episode.
        agent: What acts, in one lane and one thread.
        show: Called with every frame while the episode runs.
    """
    frames: list[Frame] = []
    reached: list[str] = []
    lane = np.array([0])

    def observe(world: VectorSimulator, running: Mapping[int, Running]) -> None:
        now = running[0]
        step = now.current

        # The stages that are reached, the benchmark's way: one after the other.
        facts = now.facts(world, 0)
        stages = episode.home_task.stages
        while not now.settling and len(reached) < len(stages) and stages[len(reached)].met(facts):
            reached.append(stages[len(reached)].name)

        # What is said, and what the camera looks at.
        words = "the robot waits"
        begun = len(now.recorder.ended)
        focus = None
        focused = -1
        if step is not None:
            words = skill_words(episode, step)
            begun += 1
            focus, focused = _focus(step.skill, world.sense(lane))
        seconds = (len(frames) + 1) / CONTROL_HZ
        done = [(each.name, each.name in reached) for each in stages]
        said = caption(words, f"skill {begun}    {seconds:.1f} s", done)
        frames.append(Frame(world.simulator(0).qpos.copy(), seconds, words, said, focus, focused))
        show(frames[-1])

    protocol = agent.protocol
    options = replace(protocol.options, lanes=1, threads=1)
    acts = make_agents(agent.policies, protocol.release.strategy)
    executor = Executor(protocol.skills(), acts, options, place=protocol.place, train_seed=agent.train_seed)
    (log,) = executor.run([episode], observe)
    return frames, log


def _focus(skill: SkillName, state: PrivilegedState) -> tuple[FloatArray | None, int]:
    """Return the point of the room that a skill is about, shape (3,), and the number of the object there, else -1."""
    target = int(state.target[0])
    if skill == Verb.RESET_ARM:
        return None, -1
    if skill == Verb.PICK:
        return state.object[0].copy(), target
    if skill == Verb.PLACE:
        return state.goal[0].copy(), target
    if skill == Verb.NAVIGATE:
        return state.aim[0].copy(), -1
    return state.handle[0].copy(), -1


def film_episode(
    episode: Episode,
    path: Path,
    agents: Sequence[Agent],
    camera: str = "follow",
    *,
    size: tuple[int, int] = (720, 480),
    speed: float | None = None,
    release: int | None = None,
) -> list[EpisodeLog]:
    """Film one episode, under several agents from left to right, and return their logs.

    Those that end early hold their last picture.

    Args:
        episode: The episode.
        path: The film, with a suffix of `RATES`.
        agents: What acts.
        camera: One of `CAMERAS`.
        size: Width and height of an agent's picture in pixels, without the text around it; both even.
        speed: Playback speed relative to real time; 4 for an episode and 1 for a release when None.
        release: Number of a target: only its placement is filmed, by a camera that stands still at its goal.

    Raises:
        PerdureError: For values that make no film, or if an agent does not release the target.
    """
    if speed is None:
        speed = 4.0 if release is None else 1.0
    _check_options(path, camera, size, speed)
    if release is not None and not 0 <= release < len(episode.goals):
        raise PerdureError(f"release must be a target from 0 to {len(episode.goals) - 1}, not {release}")
    logs: list[EpisodeLog] = []
    pace = _Pace(speed, RATES[path.suffix.lower()])

    def pictures() -> Iterator[Picture]:
        with Studio(render_scene(episode, 0), size) as studio:
            recordings = [record(episode, agent) for agent in agents]
            logs.extend(log for _, log in recordings)
            takes = [frames for frames, _ in recordings]
            view: str | Shot = camera
            marks = goal_marks(episode)
            if release is not None:
                takes = [_around_release(*each, release) for each in recordings]
                marks = (marks[release],)
                view = _release_shot(studio, takes, marks[0])
            elif camera in ("doll_house", "plan"):
                view = _overview_of(episode, logs, camera, size)
            steps = pace.steps(max(len(frames) for frames in takes))
            panels = [
                _panel(studio, (agent.title, agent.caption), frames, view, marks, steps, pace)
                for agent, frames in zip(agents, takes, strict=True)
            ]
            for row in zip(*panels, strict=True):
                yield tile(row, len(row))

    write_film(pictures(), path, pace.rate)
    return logs


def _check_options(path: Path, camera: str, size: tuple[int, int], speed: float) -> None:
    """Refuse values that make no film."""
    check_film(path)
    lookup(CAMERAS, camera, "camera")
    if not (speed > 0.0 and math.isfinite(speed)):
        raise PerdureError(f"the speed of a film must be a number above 0, not {speed}")
    if any(side % 2 for side in size):
        raise PerdureError(f"width and height of a film must be even, not {size[0]} x {size[1]}")


def film_errands(
    errands: Mapping[int, Errand],
    agents: Mapping[str, Agent],
    path: Path,
    camera: str = "doll_house",
    *,
    size: tuple[int, int] = (720, 480),
    speed: float = 4.0,
) -> list[EpisodeLog]:
    """Film errands of one home side by side and return their logs; those that end early hold their last picture.

    Args:
        errands: Number of an errand in its home to the errand, see `perdure.home.evaluate.day.find_errands`.
        agents: What acts, by task.
        path: The film, with a suffix of `RATES`.
        camera: One of `CAMERAS`.
        size: Width and height of an errand's picture in pixels, without the text around it; both even.
        speed: Playback speed relative to real time.

    Raises:
        PerdureError: For values that make no film.
    """
    _check_options(path, camera, size, speed)
    logs: list[EpisodeLog] = []
    pace = _Pace(speed, RATES[path.suffix.lower()])

    def pictures() -> Iterator[Picture]:
        recordings = {number: record(errand, agents[errand.task]) for number, errand in errands.items()}
        logs.extend(log for _, log in recordings.values())
        steps = pace.steps(max(len(frames) for frames, _ in recordings.values()))
        # Objects are numbered differently in each errand, so each has its own scene.
        with ExitStack() as studios:
            panels = []
            for number, errand in errands.items():
                studio = studios.enter_context(Studio(render_scene(errand, 0), size))
                view: str | Shot = camera
                if camera in ("doll_house", "plan"):
                    view = _overview_of(errand, logs, camera, size)
                words = (f"errand {number} without a reset", agents[errand.task].caption)
                frames, _ = recordings[number]
                panels.append(_panel(studio, words, frames, view, goal_marks(errand), steps, pace))
            for row in zip(*panels, strict=True):
                yield tile(row, len(row))

    write_film(pictures(), path, pace.rate)
    return logs


@dataclass(frozen=True)
class _Pace:
    """How fast a film is played."""

    speed: float
    """Relative to real time."""
    rate: float
    """Pictures a second."""

    @property
    def words(self) -> str:
        """Such as `4 x real time`."""
        if self.speed == 1.0:
            return "real time"
        return f"{self.speed:g} x real time"

    def steps(self, length: int) -> list[int]:
        """Return the control step that each picture of a film of `length` steps shows."""
        stride = CONTROL_HZ * self.speed / self.rate
        return [max(0, math.ceil(k * stride - 1e-9) - 1) for k in range(int(length / stride + 1e-9) + 1)]


def _release_shot(studio: Studio, takes: Sequence[Sequence[Frame]], mark: Mark) -> Shot:
    """Return a camera that shows a goal well in all takes of a release."""
    states = [take[BEFORE].state for take in takes]
    goal = np.array([mark.goal] * 2)
    return Follower(studio.simulator).fixed(states, [goal] * len(states), mark.number)[0]


def _overview_of(episode: Episode, logs: Sequence[EpisodeLog], camera: str, size: tuple[int, int]) -> Shot:
    """Return the camera `doll_house` or `plan` over wherever the robots drove."""
    ways = np.concatenate([log.history.base[:, :2] for log in logs if log.history is not None])
    return overview(episode.apartment(), camera, size, np.concatenate([ways - MARGIN, ways + MARGIN]))


def _panel(
    studio: Studio,
    words: tuple[str, str],
    frames: Sequence[Frame],
    camera: str | Shot,
    marks: Sequence[Mark],
    steps: Sequence[int],
    pace: _Pace,
) -> Iterator[Picture]:
    """Yield the pictures of an episode under a title and a line; the last one stays once it has ended."""
    follower = Follower(studio.simulator)
    ended = False
    for step in steps:
        if not ended:
            ended = step >= len(frames)
            frame = frames[min(step, len(frames) - 1)]
            put(studio.simulator, frame.state)
            view = camera
            if view == "follow":
                view = follower.shot(frame.focus, frame.focused, 1.0 / pace.rate)
            title, line = words
            if ended:
                title = f"{title} (ended)"
            above: list[Row] = [(TITLE, [(title, INK)]), (SMALL, [(f"{line}; {pace.words}", GRAY)])]
            picture = annotate(studio.take(view, marks, frame.path), above, frame.caption)
        yield picture


def _around_release(frames: Sequence[Frame], log: EpisodeLog, target: int) -> list[Frame]:
    """Return the frames around the placement of a target, with the path of the object; PerdureError without one."""
    release = placement(log, target)
    if log.history is None or release is None:
        raise PerdureError(f"target {target} is never released in {log.name}")
    goal = np.array(log.targets[target].goal)
    kind = short_name(log.targets[target].kind)
    path: list[tuple[FloatArray, Color]] = []
    shown = []
    for step in range(release.step - BEFORE, release.step + AFTERWARDS + 1):
        now = min(max(step, 0), log.length - 1)  # before the first state it waits, and after the last one
        place = log.history.facts.object_positions[now, target]
        seconds = abs(step - release.step) / CONTROL_HZ
        if step <= release.step:
            path.append((place, GRAY))
            words = f"{kind} in the hand"
            clock = f"{seconds:.1f} s before the release"
        else:
            path.append((place, COLORS[target]))
            words = f"released at {release.object_speed:.2f} m/s, {np.linalg.norm(place - goal):.2f} m from its goal"
            clock = f"{seconds:.1f} s after the release"
        said = caption(words, clock)
        shown.append(replace(frames[now], caption=said, path=tuple(path)))
    return shown


def serve_episode(
    episode: Episode,
    agents: Sequence[Agent],
    port: int = 8080,
    speed: float = 1.0,
    report: Callable[[str], None] = print,
) -> None:
    """Show an episode on a page served by this machine, one agent after the other, over and over.

    Args:
        episode: The episode.
        agents: What acts.
        port: Port of the server.
        speed: Playback speed relative to real time.
        report: Called with the address, each agent, and each new step of the plan.

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
        for agent in cycle(agents):
            server.scene.reset()
            simulator = render_scene(episode, 0)
            scene = mjviser.ViserMujocoScene(server, simulator.model, num_envs=1)
            report(agent.caption)
            record(episode, agent, _player(simulator, scene, speed, report))
    finally:
        server.stop()


def _player(simulator: Simulator, scene: Any, speed: float, report: Callable[[str], None]) -> Callable[[Frame], None]:
    """Return a function that shows frames in a scene of mjviser at the playback speed."""
    began = math.nan
    words = ""

    def show(frame: Frame) -> None:
        nonlocal began, words
        if math.isnan(began):
            began = time.monotonic()
        put(simulator, frame.state)
        scene.update_from_mjdata(simulator.data)
        if frame.words != words:
            words = frame.words
            report(f"{frame.seconds:6.1f} s  {words}")
        time.sleep(max(0.0, began + frame.seconds / speed - time.monotonic()))

    return show
