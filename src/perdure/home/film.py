"""Films of episodes, or of one release, with several agents side by side; also live in a browser.

An episode is run first and its states are kept (`record`); pictures are drawn from a copy of the scene afterwards, so
the trajectory is the same as in the protocol.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from perdure.home.pictures import CAMERAS, COLORS, Follower, Line, Shot, Studio, goal_marks, overview, put, render_scene
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import short_name
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.tasks import SkillName, SkillStep

BEFORE, AFTERWARDS = 45, 90
"""Control steps that are shown before a release, and after it or after the end of the plan."""
MARGIN = 0.9
"""Margin around the robot's way in overviews in [m]."""
RATES = {".mp4": 30.0, ".gif": 12.5, ".webp": 12.5}
"""Pictures a second. GIFs count in hundredths of a second, and browsers slow down fast ones."""
TITLE, WORDS, SMALL = 18, 18, 13
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
        words = f"learned: {', '.join(learned)}; the scripted oracle acts in the other skills"
        if len(learned) in (0, len(self.policies)):
            words = "learned policies" if learned else "the scripted oracle"
        options = self.protocol.options
        if learned and options.planner == "closed" and options.fallback == "oracle":
            words += ", after three failures the oracle"
        return f"{self.protocol.strategy.name}: {words}"


def caption(words: str, clock: str, stages: Iterable[tuple[str, bool]] = ()) -> list[Row]:
    """Return the text below a picture; the names of stages turn green once they are reached."""
    names = [(name.replace("_", " "), GREEN if done else PALE) for name, done in stages]
    return [(WORDS, [(words, INK)]), (SMALL, [(clock, GRAY)]), *([(SMALL, names)] if names else [])]


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
        now, step, state = running[0], running[0].current, world.sense(lane)
        facts, stages = now.facts(world, 0), episode.home_task.stages
        while not now.settling and len(reached) < len(stages) and stages[len(reached)].met(facts):
            reached.append(stages[len(reached)].name)
        words = "the robot waits" if step is None else skill_words(episode, step)
        begun, seconds = len(now.recorder.ended) + (step is not None), (len(frames) + 1) / CONTROL_HZ
        clock, done = f"skill {begun}    {seconds:.1f} s", [(each.name, each.name in reached) for each in stages]
        skill, target = "reset_arm" if step is None else step.skill, world.skill_goal(0).target
        near = {"pick": state.object, "place": state.goal, "navigate": state.aim}.get(skill, state.handle)
        focus = None if skill == "reset_arm" else near[0].copy()
        focused = target if skill in ("pick", "place") else -1
        said = caption(words, clock, done)
        frames.append(Frame(world.simulator(0).qpos.copy(), seconds, words, said, focus, focused))
        show(frames[-1])

    protocol, options = agent.protocol, replace(agent.protocol.options, lanes=1, threads=1)
    acts = make_agents(agent.policies, protocol.release.strategy)
    executor = Executor(protocol.skills(), acts, options, place=protocol.place, train_seed=agent.train_seed)
    (log,) = executor.run([episode], observe)
    return frames, log


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
    check_film(path)
    lookup(CAMERAS, camera, "camera")
    speed = speed if speed is not None else 4.0 if release is None else 1.0
    if not (speed > 0.0 and math.isfinite(speed)):
        raise PerdureError(f"the speed of a film must be a number above 0, not {speed}")
    if any(side % 2 for side in size):
        raise PerdureError(f"width and height of a film must be even, not {size[0]} x {size[1]}")
    if release is not None and not 0 <= release < len(episode.goals):
        raise PerdureError(f"release must be a target from 0 to {len(episode.goals) - 1}, not {release}")
    logs: list[EpisodeLog] = []
    rate, pace = RATES[path.suffix.lower()], f"{speed:g} x real time" if speed != 1.0 else "real time"

    def pictures() -> Iterator[Picture]:
        with Studio(render_scene(episode, 0), size) as studio:
            recordings = [record(episode, agent) for agent in agents]
            logs.extend(log for _, log in recordings)
            takes, shot, marks = [frames for frames, _ in recordings], None, goal_marks(episode)
            if release is not None:
                takes, marks = [_around_release(*each, release) for each in recordings], (marks[release],)
                states, goal = [take[BEFORE].state for take in takes], np.array([marks[0].goal] * 2)
                shot = Follower(studio.simulator).fixed(states, [goal] * len(states), release)[0]
            elif camera in ("doll_house", "plan"):
                ways = np.concatenate([log.history.base[:, :2] for log in logs if log.history is not None])
                shot = overview(episode.apartment(), camera, size, np.concatenate([ways - MARGIN, ways + MARGIN]))
            stride = CONTROL_HZ * speed / rate
            length = max(len(frames) for frames in takes)
            steps = [max(0, math.ceil(k * stride - 1e-9) - 1) for k in range(int(length / stride + 1e-9) + 1)]

            def panel(agent: Agent, frames: Sequence[Frame]) -> Iterator[Picture]:
                follower, ended = Follower(studio.simulator), False
                for step in steps:
                    if not ended:  # then its last picture stays
                        ended, frame = step >= len(frames), frames[min(step, len(frames) - 1)]
                        put(studio.simulator, frame.state)
                        view: str | Shot = shot or camera
                        if view == "follow":
                            view = follower.shot(frame.focus, frame.focused, 1.0 / rate)
                        title, below = f"{agent.title}{' (ended)' if ended else ''}", f"{agent.caption}; {pace}"
                        above = [(TITLE, [(title, INK)]), (SMALL, [(below, GRAY)])]
                        picture = annotate(studio.take(view, marks, frame.path), above, frame.caption)
                    yield picture

            for row in zip(*map(panel, agents, takes), strict=True):
                yield tile(row, len(row))

    write_film(pictures(), path, rate)
    return logs


def _around_release(frames: Sequence[Frame], log: EpisodeLog, target: int) -> list[Frame]:
    """Return the frames around the placement of a target, with the path of the object; PerdureError without one."""
    release = placement(log, target)
    if log.history is None or release is None:
        raise PerdureError(f"target {target} is never released in {log.name}")
    goal, kind, color = np.array(log.targets[target].goal), short_name(log.targets[target].kind), COLORS[target]
    path: list[tuple[FloatArray, Color]] = []
    shown = []
    for step in range(release.step - BEFORE, release.step + AFTERWARDS + 1):
        now, held = min(max(step, 0), log.length - 1), step <= release.step  # the last state waits
        place = log.history.facts.object_positions[now, target]
        path.append((place, GRAY if held else color))
        words, clock = f"{kind} in the hand", f"{abs(step - release.step) / CONTROL_HZ:.1f} s"
        if not held:
            words = f"released at {release.object_speed:.2f} m/s, {np.linalg.norm(place - goal):.2f} m from its goal"
        said = caption(words, f"{clock} {'before' if held else 'after'} the release")
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
    began, words = math.nan, ""

    def show(frame: Frame) -> None:
        nonlocal began, words
        began = time.monotonic() if math.isnan(began) else began
        put(simulator, frame.state)
        scene.update_from_mjdata(simulator.data)
        if frame.words != words:
            words = frame.words
            report(f"{frame.seconds:6.1f} s  {words}")
        time.sleep(max(0.0, began + frame.seconds / speed - time.monotonic()))

    return show
