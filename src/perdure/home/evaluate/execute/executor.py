"""Runs task plans over many episodes at once, open loop: the next skill begins whatever became of the last one.

As in TP+SRL: a skill ends by its own stop rule or at its limit; after a place, open or close that timed out the hand is
opened by force; the episode ends with the plan or at the task's limit. Then the world goes on for a settling time, the
robot standing still, so that one can see what stays where it was put.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from perdure.home.agents.actor import Actor
from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.benchmark.tasks import NOTHING, SETTLE_STEPS, SOMETHING_ELSE, SkillStep, WorldFacts, latched_stages
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute.log import Ending, EpisodeLog, Recorder, SkillRun
from perdure.home.sim.world import ACTION_SIZE, Jaws, PrivilegedState, SceneOptions, World
from perdure.home.sim.world.state import norm
from perdure.home.skills import Progress, Skill
from perdure.home.skills.skill_goals import make_skill_goal

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

Watch = Callable[[World, Mapping[int, Episode]], None]

HANDS_OPENED = ("place", "open_drawer", "close_drawer", "open_fridge", "close_fridge")
"""Skills after whose time-out the hand is opened by force (M3)."""


OVERTIME = 150
"""Steps that a hand-over may go on beyond the limit of place."""


@dataclass(frozen=True)
class ExecutorOptions:
    """How episodes are run."""

    eval_seed: int = 0
    """Draws where the robot starts."""
    lanes: int = 50
    """Episodes that run at the same time: the more, the less each costs."""
    threads: int | None = None
    """Threads that step them; the cores this process may use when None."""
    jaws: Jaws = "never"
    scene: SceneOptions = field(default_factory=SceneOptions)
    settle_steps: int = SETTLE_STEPS


@dataclass
class _Running:
    """A lane's episode while it runs."""

    episode: Episode
    plan: tuple[SkillStep, ...]
    recorder: Recorder
    done: list[SkillRun] = field(default_factory=list)
    step: int = 0
    began: int = 0
    settling: int | None = None
    """Steps of the settling time so far, None before it."""
    diverged: bool = False
    drawer: int = -1
    """Number of the drawer that the task is about among the scene's links, -1 for none."""
    fridge: int = -1

    @property
    def current(self) -> SkillStep | None:
        return self.plan[len(self.done)] if self.settling is None else None


class Executor:
    """Runs episodes of one task.

    Lanes take the next episode as soon as they are free; an episode's course does not depend on its neighbors.
    """

    def __init__(
        self, skills: Mapping[str, Skill], actors: Mapping[str, Actor], options: ExecutorOptions | None = None
    ) -> None:
        """Takes what to run and who acts.

        Args:
            skills: The skill for each name in the plan.
            actors: Who acts in each of them.
            options: How.
        """
        self._skills, self._actors = dict(skills), dict(actors)
        self._options = options or ExecutorOptions()
        missing = self._skills.keys() ^ self._actors.keys()
        if missing:
            raise HomeError(f"skills and actors must have the same names; {', '.join(sorted(missing))} do not")

    def run(self, episodes: Sequence[Episode], watch: Watch | None = None) -> Iterator[EpisodeLog]:
        """Runs episodes; hands out the log of each as soon as it has ended (so not always in order).

        Args:
            episodes: What to run.
            watch: Called after every control step with the world and the lanes' episodes.
        """
        options = self._options
        world = World(min(options.lanes, len(episodes)), options.threads, options.jaws)
        waiting = list(reversed(episodes))
        running: list[_Running | None] = [None] * world.num_lanes
        self._progress: Progress | None = None
        try:
            for lane in range(world.num_lanes):
                running[lane] = self._start(world, lane, waiting.pop())
            self._begin_skills(world, list(range(world.num_lanes)), running)
            while any(running):
                lanes = np.array([k for k, each in enumerate(running) if each is not None])
                self._step(world, lanes, running)
                if watch is not None:
                    watch(world, {int(k): running[int(k)].episode for k in lanes})  # type: ignore[union-attr]
                for lane in lanes:
                    each = running[lane]
                    assert each is not None
                    if (each.settling is not None and each.settling >= options.settle_steps) or each.diverged:
                        yield self._finish(world, int(lane), each)
                        running[lane] = self._start(world, int(lane), waiting.pop()) if waiting else None
                        if running[lane] is not None:
                            self._begin_skills(world, [int(lane)], running)
        finally:
            world.close()

    def _start(self, world: World, lane: int, episode: Episode) -> _Running:
        task = episode.home_task
        scene = episode_scene(episode, self._options.scene)
        world.reset(lane, scene, start_pose(scene.apartment, episode, self._options.eval_seed))
        running = _Running(episode, task.skills, Recorder(len(episode.goals)))
        containers = [episode.container(target) for target in range(len(episode.goals))]
        running.drawer = next((scene.links.index(c) for c in containers if c is not None and c != "top_door"), -1)
        running.fridge = scene.links.index("top_door")
        return running

    def _begin_skills(self, world: World, lanes: Sequence[int], running: list[_Running | None]) -> None:
        """Begins the next skill of these lanes' plans; all of them run and have one."""
        for lane in lanes:
            each = running[lane]
            assert each is not None
            assert each.current is not None
            world.assign(lane, make_skill_goal(each.episode, each.current, world.lane(lane)))
            each.began = each.step
        for name, group in self._groups(np.array(lanes, dtype=np.int64), running).items():
            skill = self._skill(name)
            fresh = skill.begin(world.sense(group))
            if self._progress is None or len(self._progress) != world.num_lanes:
                self._progress = fresh[np.zeros(world.num_lanes, dtype=np.int64)]
            self._progress = self._progress.put(group, fresh)
            for lane in group.tolist():
                self._actors[name].begin(world, lane, skill)

    def _skill(self, name: str) -> Skill:
        if name not in self._skills:
            raise HomeError(f"the plan needs {name}, but only {', '.join(self._skills)} are given")
        return self._skills[name]

    def _step(self, world: World, lanes: IntArray, running: list[_Running | None]) -> None:
        actions = np.zeros((world.num_lanes, ACTION_SIZE))
        speed, arm_step = np.ones(world.num_lanes), np.zeros(world.num_lanes)
        groups = self._groups(lanes, running)
        # Lanes at the same skill lie side by side, so that a group's part of a record is a view.
        settling = [int(lane) for lane in lanes if running[lane].current is None]
        lanes = np.concatenate([*groups.values(), np.array(settling, dtype=np.int64)])
        ends = dict(zip(groups, np.cumsum([len(group) for group in groups.values()]).tolist(), strict=True))
        rows = {name: slice(ends[name] - len(group), ends[name]) for name, group in groups.items()}
        reach, neighbors = np.zeros(len(lanes)), np.zeros(len(lanes), dtype=bool)
        for name in groups:
            if self._actors[name].sees:
                reach[rows[name]], neighbors[rows[name]] = (
                    self._skills[name].scan_reach,
                    self._skills[name].needs_neighbors,
                )
        known = world.sense(lanes, reach, neighbors)
        for name, group in groups.items():
            skill, actor = self._skills[name], self._actors[name]
            state = known[rows[name]]
            assert self._progress is not None
            acted = actor.act(world, group, skill, state, self._progress[group])
            actions[group] = skill.mask(acted, state)
            speed[group], arm_step[group] = skill.base_speed, skill.arm_step
        world.step(actions[lanes], lanes, speed[lanes], arm_step[lanes])
        everyone = world.sense(lanes)
        self._record(world, lanes, running, everyone)
        for name, group in groups.items():
            self._after(world, name, group, everyone[rows[name]], running)

    def _groups(self, lanes: IntArray, running: list[_Running | None]) -> dict[str, IntArray]:
        """Lanes by the skill they are at; lanes that settle are in none."""
        groups: dict[str, list[int]] = {}
        for lane in lanes:
            step = running[lane].current
            if step is not None:
                groups.setdefault(step.skill, []).append(int(lane))
        return {name: np.array(group) for name, group in groups.items()}

    def _after(
        self, world: World, name: str, group: IntArray, state: PrivilegedState, running: list[_Running | None]
    ) -> None:
        """Ends skills that stop or run out of time, and begins the next ones."""
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
                out_of_time = not self._actors[name].overtime(lane)
            at_limit = each.step >= each.episode.home_task.max_steps
            if stopped or out_of_time or at_limit:
                ending: Ending = "stopped" if stopped else "timed out" if out_of_time else "task limit"
                forced = ending == "timed out" and name in HANDS_OPENED and not bool(state.empty_hand[row])
                if self._end_skill(world, lane, each, (ending, bool(success[row]), forced), at_limit):
                    going_on.append(lane)
        if going_on:
            self._begin_skills(world, going_on, running)

    @staticmethod
    def _end_skill(world: World, lane: int, each: _Running, how: tuple[Ending, bool, bool], at_limit: bool) -> bool:
        """Notes how a lane's skill ended; whether the plan goes on."""
        step = each.current
        assert step is not None
        ending, success, forced = how
        if forced:
            world.lane(lane).release()
        each.done.append(
            SkillRun(len(each.done), step.skill, step.target, each.began, each.step, ending, success, forced)
        )
        if at_limit or len(each.done) == len(each.plan):
            each.settling = 0
        return each.settling is None

    def _record(self, world: World, lanes: IntArray, running: list[_Running | None], state: PrivilegedState) -> None:
        everyone = [each for each in (running[lane] for lane in lanes.tolist()) if each is not None]
        count = len(everyone[0].episode.goals)
        poses, speeds = world.objects(lanes, count)
        up = 1.0 - 2.0 * (poses[:, :, 4] ** 2 + poses[:, :, 5] ** 2)
        speed = np.sqrt((speeds**2).sum(axis=2))
        active = np.array([len(each.done) if each.settling is None else len(each.plan) for each in everyone])
        table = Recorder.table(
            *(poses[:, :, :3], held_target(state, count), opened(world, lanes, everyone), active),
            *(state.base, state.gripper, up, speed, state.contact_force),
        )
        for row, (each, diverged) in enumerate(zip(everyone, state.diverged.tolist(), strict=True)):
            if each.settling is None:
                each.step += 1
            else:
                each.settling += 1
            each.diverged |= diverged
            each.recorder.add(table[row])

    def _finish(self, world: World, lane: int, each: _Running) -> EpisodeLog:
        poses, velocities = world.objects(np.array([lane]), len(each.episode.objects))
        objects, held, drawer, fridge, active, base, gripper, up, speed, force = each.recorder.arrays()
        facts = WorldFacts(objects, each.episode.goal_positions, held.astype(np.int64), drawer, fridge)
        return EpisodeLog(
            episode=each.episode,
            eval_seed=self._options.eval_seed,
            skills=tuple(each.done),
            steps=each.step,
            facts=facts,
            active=active.astype(np.int64),
            base=base,
            gripper=gripper,
            object_up=up,
            object_speed=speed,
            contact_force=force,
            latched=latched_stages(each.episode.home_task, facts[: each.step])[-1],
            diverged=each.diverged,
            final_poses=poses[0],
            final_speeds=norm(velocities[0]),
            final_held=world.lane(lane).held,
        )


def held_target(state: PrivilegedState, targets: int) -> IntArray:
    """Number of the target in the hand, NOTHING, or SOMETHING_ELSE. Shape (lanes,)."""
    held = np.where((state.held >= 0) & (state.held < targets), state.held, NOTHING)
    return np.where((held == NOTHING) & ~state.empty_hand, SOMETHING_ELSE, held)


def opened(world: World, lanes: IntArray, running: Sequence[_Running]) -> FloatArray:
    """How far the task's drawer, 0 where it is about none, and the fridge's door are open. Shape (lanes, 2)."""
    rows = []
    for lane, each in zip(lanes.tolist(), running, strict=True):
        links = world.lane(lane).links.tolist()
        rows.append((links[each.drawer] if each.drawer >= 0 else 0.0, links[each.fridge]))
    return np.array(rows)
