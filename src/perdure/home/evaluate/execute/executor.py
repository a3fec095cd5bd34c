"""Execute task plans over many episodes at once, open loop: the next skill begins whether or not the last succeeded.

As in TP+SRL: a skill ends by its own stop rule or at its step limit. After a place, open or close that timed out the
hand is opened by force. The episode ends with the plan or at the task's step limit. Then the simulation runs on for a
settling time in which the robot stands still, so that the log shows which objects stay at their goals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.benchmark.tasks import SETTLE_STEPS, SkillStep
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute.recorder import Recorder, door_links, final_objects, record_table
from perdure.home.evaluate.log import UNTRAINED, Ending, EpisodeLog, SkillRun
from perdure.home.sim.arrays import IntArray
from perdure.home.sim.world import ACTION_SIZE, Jaws, PrivilegedState, SceneOptions, VectorSimulator
from perdure.home.sim.world.scene import SERVO_HZ
from perdure.home.skills import Skill, SkillProgress, make_skill_goal

OVERTIME = 150
"""Steps that a release strategy may take beyond the step limit of place."""


@dataclass(frozen=True)
class ExecutorOptions:
    """Settings of an execution."""

    eval_seed: int = 0
    """Draws the robot's start pose."""
    lanes: int = 50
    """Episodes that run at the same time. Logs do not depend on it; more lanes cost less per episode."""
    threads: int | None = None
    """Threads that step them; the cores this process may use when None."""
    jaws: Jaws = "never"
    scene: SceneOptions = field(default_factory=SceneOptions)
    settle_steps: int = SETTLE_STEPS
    """Control steps of the settling time, 1 or more."""

    def __post_init__(self) -> None:
        """Raise HomeError for too few lanes, threads or settling steps, a low physics rate, or a choice of targets."""
        least = {"lanes": (self.lanes, 1), "threads": (self.threads, 1), "settle_steps": (self.settle_steps, 1)}
        for name, (value, low) in {**least, "physics_hz": (self.scene.physics_hz, SERVO_HZ)}.items():
            if value is not None and value < low:
                raise HomeError(f"{name} must be {low} or more, not {value}")
        if self.scene.targets is not None:
            raise HomeError(f"targets must be None where plans are executed, not {self.scene.targets}")


@dataclass
class Running:
    """An episode while it runs in a lane."""

    episode: Episode
    plan: tuple[SkillStep, ...]
    recorder: Recorder
    doors: tuple[int, int]
    """Numbers of the task's drawer (-1 for none) and of the fridge's upper door among the scene's links."""
    step: int = 0
    began: int = 0
    """Step at which the current skill began."""
    settling: int | None = None
    """Steps of the settling time so far, None before it."""

    @property
    def begun(self) -> int:
        """Number of steps of the plan that have begun."""
        return len(self.recorder.ended) + (self.settling is None)

    @property
    def current(self) -> SkillStep | None:
        """The running step of the plan, None in the settling time."""
        return self.plan[self.begun - 1] if self.settling is None else None


StepObserver = Callable[[VectorSimulator, Mapping[int, Running]], None]
"""Called after every control step with the world and the running episode of each lane."""


class Executor:
    """Executes episodes of one task.

    A lane starts the next episode as soon as it is free. An episode does not depend on the other lanes.
    """

    def __init__(
        self,
        skills: Mapping[str, Skill],
        agents: Mapping[str, SkillAgent],
        options: ExecutorOptions | None = None,
        *,
        strategy: str = "unnamed",
        train_seed: int = UNTRAINED,
    ) -> None:
        """Check that every skill has an agent.

        Args:
            skills: The skill for each name in the plan.
            agents: The agent of each of them.
            options: Settings.
            strategy: Name of the release strategy, written into the logs.
            train_seed: Training seed of the policies, written into the logs.

        Raises:
            HomeError: If skills and agents have different names.
        """
        self._skills, self._agents = dict(skills), dict(agents)
        self._options = options or ExecutorOptions()
        self._named = {"strategy": strategy, "train_seed": train_seed, "eval_seed": self._options.eval_seed}
        missing = self._skills.keys() ^ self._agents.keys()
        if missing:
            raise HomeError(f"skills and agents must have the same names; {', '.join(sorted(missing))} do not")

    def run(self, episodes: Sequence[Episode], observe: StepObserver | None = None) -> Iterator[EpisodeLog]:
        """Yield the log of each episode as soon as it has ended, so not always in order."""
        options = self._options
        world = VectorSimulator(min(options.lanes, len(episodes)), options.threads, options.jaws)
        waiting = list(reversed(episodes))
        running: list[Running | None] = [None] * world.num_lanes
        self._progress: SkillProgress | None = None
        try:
            for lane in range(world.num_lanes):
                running[lane] = self._start(world, lane, waiting.pop())
            self._begin_skills(world, list(range(world.num_lanes)), running)
            while any(running):
                lanes = np.array([k for k, each in enumerate(running) if each is not None])
                self._step(world, lanes, running)
                if observe is not None:
                    observe(world, {k: each for k, each in enumerate(running) if each is not None})
                for lane in lanes.tolist():
                    each = running[lane]
                    assert each is not None
                    if (each.settling is None or each.settling < options.settle_steps) and not each.recorder.diverged:
                        continue
                    yield each.recorder.log(each.step, final_objects(world, lane), **self._named)
                    running[lane] = self._start(world, lane, waiting.pop()) if waiting else None
                    if running[lane] is not None:
                        self._begin_skills(world, [lane], running)
        finally:
            world.close()

    def _start(self, world: VectorSimulator, lane: int, episode: Episode) -> Running:
        scene = episode_scene(episode, self._options.scene)
        world.reset(lane, scene, start_pose(scene.apartment, episode, self._options.eval_seed))
        return Running(episode, episode.home_task.skills, Recorder(episode), door_links(episode, scene))

    def _begin_skills(self, world: VectorSimulator, lanes: Sequence[int], running: list[Running | None]) -> None:
        """Begin the next skill of these lanes' plans; all of them run and have one."""
        for lane in lanes:
            each = running[lane]
            assert each is not None
            assert each.current is not None
            world.assign(lane, make_skill_goal(each.episode, each.current, world.simulator(lane)))
            each.began = each.step
        for name, group in self._groups(np.array(lanes, dtype=np.int64), running).items():
            if name not in self._skills:
                raise HomeError(f"the plan needs {name}, but only {', '.join(self._skills)} are given")
            skill = self._skills[name]
            fresh = skill.begin(world.sense(group))
            if self._progress is None or len(self._progress) != world.num_lanes:
                self._progress = fresh[np.zeros(world.num_lanes, dtype=np.int64)]
            self._progress = self._progress.put(group, fresh)
            for lane in group.tolist():
                self._agents[name].begin(world, lane, skill)

    def _step(self, world: VectorSimulator, lanes: IntArray, running: list[Running | None]) -> None:
        actions = np.zeros((world.num_lanes, ACTION_SIZE))
        speed, arm_step = np.ones(world.num_lanes), np.zeros(world.num_lanes)
        groups = self._groups(lanes, running)
        # Lanes at the same skill lie side by side, so that a group's part of a record is a view.
        settling = [int(lane) for lane in lanes if running[lane].current is None]
        lanes = np.concatenate([*groups.values(), np.array(settling, dtype=np.int64)])
        ends = dict(zip(groups, np.cumsum([len(group) for group in groups.values()]).tolist(), strict=True))
        rows = {name: slice(ends[name] - len(group), ends[name]) for name, group in groups.items()}
        scan_reach, neighbors = np.zeros(len(lanes)), np.zeros(len(lanes), dtype=bool)
        for name in groups:
            if self._agents[name].sees:
                skill = self._skills[name]
                scan_reach[rows[name]], neighbors[rows[name]] = skill.scan_reach, skill.needs_neighbors
        known = world.sense(lanes, scan_reach, neighbors)
        for name, group in groups.items():
            skill, agent, state = self._skills[name], self._agents[name], known[rows[name]]
            assert self._progress is not None
            acted = agent.act(world, group, skill, state, self._progress[group])
            actions[group] = skill.mask(acted, state)
            speed[group], arm_step[group] = skill.base_speed, skill.arm_step
        world.step(actions[lanes], lanes, speed[lanes], arm_step[lanes])
        after = world.sense(lanes)
        self._record(world, lanes, running, after)
        for name, group in groups.items():
            self._end_skills(world, name, group, after[rows[name]], running)

    def _groups(self, lanes: IntArray, running: list[Running | None]) -> dict[str, IntArray]:
        """Return the lanes at each skill; lanes in their settling time are in no group."""
        groups: dict[str, list[int]] = {}
        for lane in lanes:
            step = running[lane].current
            if step is not None:
                groups.setdefault(step.skill, []).append(int(lane))
        return {name: np.array(group) for name, group in groups.items()}

    def _end_skills(
        self, world: VectorSimulator, name: str, group: IntArray, state: PrivilegedState, running: list[Running | None]
    ) -> None:
        """End skills that stop or run out of time, and begin the next ones."""
        skill = self._skills[name]
        assert self._progress is not None
        progress = skill.advance(self._progress[group], state)
        self._progress = self._progress.put(group, progress)
        stop, success = skill.stop(state, progress), skill.success(state, progress)
        going_on = []
        for row, (lane, stopped, elapsed) in enumerate(
            zip(group.tolist(), stop.tolist(), progress.elapsed.tolist(), strict=True)
        ):
            each = running[lane]
            assert each is not None
            out_of_time = elapsed >= skill.limit
            if out_of_time and state.holds_target[row] and elapsed < skill.limit + OVERTIME:
                out_of_time = not self._agents[name].overtime(lane)
            at_limit = each.step >= each.episode.home_task.max_steps
            if stopped or out_of_time or at_limit:
                ending: Ending = "stopped" if stopped else "timed out" if out_of_time else "task limit"
                forced = ending == "timed out" and skill.ends_with_empty_hand and not bool(state.empty_hand[row])
                if self._end_skill(world, lane, each, (ending, bool(success[row]), forced), at_limit):
                    going_on.append(lane)
        if going_on:
            self._begin_skills(world, going_on, running)

    @staticmethod
    def _end_skill(
        world: VectorSimulator, lane: int, each: Running, how: tuple[Ending, bool, bool], at_limit: bool
    ) -> bool:
        """Record how a lane's skill ended, and return whether the plan goes on."""
        step, ended = each.current, each.recorder.ended
        assert step is not None
        if how[2]:
            world.simulator(lane).release()
        ended.append(SkillRun(len(ended), step.skill, step.target, each.began, each.step, *how))
        if at_limit or len(ended) == len(each.plan):
            each.settling = 0
        return each.settling is None

    @staticmethod
    def _record(world: VectorSimulator, lanes: IntArray, running: list[Running | None], state: PrivilegedState) -> None:
        everyone = [each for each in (running[lane] for lane in lanes.tolist()) if each is not None]
        doors = [each.doors for each in everyone]
        table = record_table(world, lanes, state, len(everyone[0].episode.goals), doors)
        for row, (each, diverged) in enumerate(zip(everyone, state.diverged.tolist(), strict=True)):
            if each.settling is None:
                each.step += 1
            else:
                each.settling += 1
            each.recorder.diverged |= diverged
            each.recorder.rows.append(table[row])
