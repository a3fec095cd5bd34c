"""Execute episodes, many at once: a planner chooses the skills one by one (`perdure.home.tasks.planners`).

As in TP+SRL a skill ends by its own stop rule or at its step limit. After a place, open or close that timed out the
hand is opened by force. After the plan, or at the task's step limit, the simulation runs on for a settling time in
which the robot stands still, so that the log shows which objects stay at their goals. Then the planner is asked once
more: a closed loop brings back what has rolled away, and settles again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.home.agents.learned import SkillAgent
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate.disturbances import HomeDisturbance, HomeEffect, home_labels
from perdure.home.evaluate.log import UNTRAINED, Ending, EpisodeLog, FinalObject, History, SkillRun, Target
from perdure.home.evaluate.strategy import Strategy, strategy_of
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.objects import KINDS
from perdure.home.sim.pieces import CONTAINERS, LINK_CONTAINERS
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ, SERVO_HZ, Scene, SceneOptions
from perdure.home.sim.sensors import PrivilegedState, SkillGoal, norm
from perdure.home.sim.simulator import Simulator
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import Skill, SkillProgress, make_skill_goal
from perdure.home.skills.starts import keep_apart
from perdure.home.tasks.episodes import Episode, episode_hash, episode_scene, start_pose
from perdure.home.tasks.errands import Errand
from perdure.home.tasks.planners import FallbackName, OpenLoop, Planner, find_planner, needed_skills
from perdure.home.tasks.tasks import NOTHING, SETTLE_STEPS, SOMETHING_ELSE, SkillStep, WorldFacts

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
    scene: SceneOptions = field(default_factory=SceneOptions)
    settle_steps: int = SETTLE_STEPS
    """Control steps of the settling time, 1 or more."""
    planner: str = OpenLoop.name
    """A name of `Planner`."""
    fallback: FallbackName = "oracle"
    """Of planners that have one. "oracle" takes over a skill that failed often; "none": its target is given up."""
    disturb: tuple[HomeDisturbance, ...] = ()
    """Disturbances that act together."""

    def __post_init__(self) -> None:
        """Refuse unknown names, too few lanes, threads or settling steps, a low physics rate, chosen targets."""
        planner = find_planner(self.planner)
        lookup(dict.fromkeys(get_args(FallbackName)), self.fallback, "fallback")
        if self.fallback != "oracle" and not planner.has_fallback:
            having = ", ".join(name for name, kind in Planner.kinds().items() if kind.has_fallback)
            raise PerdureError(
                f"fallback {self.fallback} needs another planner ({having}): with planner {self.planner} the oracle "
                "never takes over"
            )
        least = {"lanes": (self.lanes, 1), "threads": (self.threads, 1), "settle_steps": (self.settle_steps, 1)}
        for name, (value, low) in {**least, "physics_hz": (self.scene.physics_hz, SERVO_HZ)}.items():
            if value is not None and value < low:
                raise PerdureError(f"{name} must be {low} or more, not {value}")
        if self.scene.targets is not None:
            raise PerdureError(f"targets must be None where plans are executed, not {self.scene.targets}")

    def strategy(self, place: str) -> Strategy:
        """Return what is run with these options and a release strategy."""
        return strategy_of(place, self.scene, self.planner, self.fallback, home_labels(self.disturb))


@dataclass
class Recorder:
    """Collects the state of one episode."""

    episode: Episode
    ended: list[SkillRun] = field(default_factory=list)
    """Skills that have ended, without force and reach."""
    rows: list[tuple[Any, ...]] = field(default_factory=list)
    """Of each step: the columns of a `History`, facts first."""
    diverged: bool = False
    """Whether the simulation diverged; nothing after that counts."""

    def log(self, steps: int, final_objects: tuple[FinalObject, ...], **run: str | int) -> EpisodeLog:
        """Return the log of the episode.

        Args:
            steps: Control steps until the plan or the task's limit ended; the rows after them are the settling time.
            final_objects: All objects after the last step; none if the world diverged, which reset them.
            run: Columns of `Strategy`, `train_seed` and `eval_seed` of the log.
        """
        # A diverged world is reset to its start: the last row no longer belongs to this episode.
        length = max(1, len(self.rows) - 1) if self.diverged else len(self.rows)
        steps = min(steps, length)
        episode = self.episode
        history = self._history(length)
        return EpisodeLog(
            task=episode.task,
            split=episode.split,
            index=episode.index,
            episode_hash=episode_hash(episode),
            control_hz=history.control_hz,
            steps=steps,
            length=length,
            diverged=self.diverged,
            targets=tuple(_target(episode, k) for k in range(len(episode.goals))),
            runs=tuple(
                history.measured(replace(run, begin=min(run.begin, steps), end=min(run.end, steps)))
                for run in self.ended
            ),
            events=history.events,
            releases=history.releases,
            final_objects=final_objects,
            history=history,
            drawn=episode.home_task,
            **run,  # type: ignore[arg-type]
        )

    def _history(self, length: int) -> History:
        rows = zip(*self.rows[:length], strict=True)
        objects, held, positions, up, speed, gripper, base, force, touched = map(np.array, rows)
        containers = dict(zip(CONTAINERS, positions.T, strict=True))
        facts = WorldFacts(objects, self.episode.goal_positions, held, containers)
        return History(facts, up, speed, gripper, base, force, float(CONTROL_HZ), touched)


def final_objects(lane: Simulator) -> tuple[FinalObject, ...]:
    """Return pose and speed of every object in the scene of a lane, targets first."""
    poses, velocities = lane.objects(len(lane.scene.placements))
    rows = zip(lane.scene.placements, poses.tolist(), norm(velocities).tolist(), strict=True)
    return tuple(
        FinalObject(placement.kind, (x, y, z), (qw, qx, qy, qz), speed, k == lane.held)
        for k, (placement, (x, y, z, qw, qx, qy, qz), speed) in enumerate(rows)
    )


def held_target(lane: Simulator, targets: int) -> int:
    """Return the number of the target in the hand, NOTHING, or SOMETHING_ELSE."""
    if 0 <= lane.held < targets:
        return lane.held
    return NOTHING if lane.held < 0 and lane.held_link < 0 else SOMETHING_ELSE


def container_numbers(episode: Episode, scene: Scene) -> tuple[int, ...]:
    """Return for each of `CONTAINERS` the number of its link in `Scene.links`, -1 where the episode has none."""
    links = episode.container_links().values()
    return tuple(-1 if link is None else scene.links.index(link) for link in links)


def _target(episode: Episode, number: int) -> Target:
    goal = episode.goals[number]
    link = episode.container(number)
    container = "" if link is None else LINK_CONTAINERS[link].name
    return Target(goal.kind, KINDS[goal.kind].cylinder, container, goal.position)


@dataclass
class Running:
    """An episode while it runs in a lane."""

    episode: Episode
    planner: Planner
    recorder: Recorder
    containers: tuple[int, ...]
    """See `container_numbers`."""
    current: SkillStep | None = None
    """The running skill, None in the settling time."""
    step: int = 0
    began: int = 0
    """Step at which the current skill began."""
    settling: int = 0
    """Steps of the settling time so far."""
    effects: Sequence[HomeEffect] = ()
    """What disturbances do."""
    stood: defaultdict[tuple[str, int], list[FloatArray]] = field(default_factory=lambda: defaultdict(list))
    """Where the attempts of each skill and target began, and where they or a navigation failed, x and y in [m]."""

    def read(self, lane: Simulator) -> tuple[FloatArray, int, tuple[float, ...]]:
        """Return middles of the targets (targets, 3), what the hand holds, how far each of `CONTAINERS` is open."""
        links = lane.links.tolist()
        targets = len(self.episode.goals)
        positions = tuple(links[number] if number >= 0 else 0.0 for number in self.containers)
        return lane.middles[:targets], held_target(lane, targets), positions

    def facts(self, world: VectorSimulator, lane: int) -> WorldFacts:
        """Return the facts of now as the robot perceives them."""
        objects, held, positions = self.read(world.simulator(lane))
        containers = {name: np.array(position) for name, position in zip(CONTAINERS, positions, strict=True)}
        facts = WorldFacts(objects, self.episode.goal_positions, np.array(held), containers)
        for effect in self.effects:
            facts = effect.perceive_facts(facts)
        return facts


def perceived(state: PrivilegedState, lanes: IntArray, running: Mapping[int, Running]) -> PrivilegedState:
    """Return the state of lanes as their robots perceive it."""
    for row, lane in enumerate(lanes.tolist()):
        for effect in running[lane].effects:
            rows = np.array([row])
            state = state.put(rows, effect.perceive_state(state[rows]))
    return state


def disturbed(
    world: VectorSimulator, state: PrivilegedState, lanes: IntArray, running: Mapping[int, Running]
) -> PrivilegedState:
    """Disturb the homes of lanes after a control step; return the state as their robots perceive it then."""
    effects = [(lane, effect) for lane in lanes.tolist() for effect in running[lane].effects]
    if not effects:
        return state
    for lane, effect in effects:
        effect.after_step(world.simulator(lane))
    return perceived(world.sense(lanes), lanes, running)


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
        place: str = "unnamed",
        train_seed: int = UNTRAINED,
    ) -> None:
        """Check that every skill has an agent.

        Args:
            skills: The skill for each name in the plan.
            agents: The agent of each of them.
            options: Settings.
            place: Release strategy, or any name, written into the logs beside what the options say of the run.
            train_seed: Training seed of the policies, written into the logs.

        Raises:
            PerdureError: If skills and agents have different names.
        """
        self._skills = dict(skills)
        self._options = options or ExecutorOptions()
        self._named: dict[str, str | int] = {
            **asdict(self._options.strategy(place)),
            "train_seed": train_seed,
            "eval_seed": self._options.eval_seed,
        }
        missing = skills.keys() ^ agents.keys()
        if missing:
            raise PerdureError(f"skills and agents must have the same names; {', '.join(sorted(missing))} do not")
        oracle = Oracle()
        self._agents = {
            (name, scripted): oracle if scripted else agents[name] for name in skills for scripted in (False, True)
        }

    def run(self, episodes: Sequence[Episode], observe: StepObserver | None = None) -> Iterator[EpisodeLog]:
        """Yield the log of each episode as soon as it has ended, so not always in order."""
        for log, _ in self.run_to_end(episodes, observe):
            yield log

    def run_to_end(
        self, episodes: Sequence[Episode], observe: StepObserver | None = None
    ) -> Iterator[tuple[EpisodeLog, Simulator]]:
        """Yield also the simulator as an episode left it; the next one may be run in it."""
        options = self._options
        for task in {each.home_task for each in episodes}:
            if missing := set(needed_skills(task, options.planner)) - self._skills.keys():
                lacks = f"the plan needs {', '.join(sorted(missing))}, but only {', '.join(self._skills)} are given"
                raise PerdureError(lacks)
        world = VectorSimulator(min(options.lanes, len(episodes)), options.threads)
        waiting = list(reversed(episodes))
        running: dict[int, Running] = {}
        self._progress: SkillProgress | None = None
        try:
            for lane in range(world.num_lanes):
                running[lane] = self._start(world, lane, waiting.pop())
            self._begin_skills(world, sorted(running), running)
            while running:
                self._step(world, running)
                over = {lane: each for lane, each in sorted(running.items()) if self._is_over(world, lane, each)}
                if observe is not None:
                    observe(world, running)
                for lane, each in over.items():
                    last = () if each.recorder.diverged else final_objects(world.simulator(lane))
                    yield each.recorder.log(each.step, last, **self._named), world.simulator(lane)
                    del running[lane]
                    if waiting:
                        running[lane] = self._start(world, lane, waiting.pop())
                        self._begin_skills(world, [lane], running)
        finally:
            world.close()

    def _is_over(self, world: VectorSimulator, lane: int, each: Running) -> bool:
        """Return whether an episode is over; after the settling time a skill that the planner then names begins."""
        if each.recorder.diverged or each.settling < self._options.settle_steps:
            return each.recorder.diverged
        steps = each.step + each.settling
        if steps >= each.episode.home_task.max_steps:
            return True
        again = each.planner.next(each.facts(world, lane))
        if again is None:
            return True
        each.current = again
        each.step = steps
        each.settling = 0
        self._begin_skills(world, [lane], {lane: each})
        return False

    def _start(self, world: VectorSimulator, lane: int, episode: Episode) -> Running:
        scene = episode_scene(episode, self._options.scene)
        if isinstance(episode, Errand):
            world.reset(lane, scene, episode.base, episode.arm, episode.positions)
        else:
            world.reset(lane, scene, start_pose(scene.apartment, episode, self._options.eval_seed))
        planner = find_planner(self._options.planner)(episode, self._options.fallback)
        effects = [disturbance.effect(episode, self._options.eval_seed) for disturbance in self._options.disturb]
        each = Running(episode, planner, Recorder(episode), container_numbers(episode, scene), effects=effects)
        each.current = planner.next(each.facts(world, lane))
        return each

    def _begin_skills(self, world: VectorSimulator, lanes: Sequence[int], running: Mapping[int, Running]) -> None:
        """Begin the next skill of these lanes' plans; all of them run and have one."""
        for lane in lanes:
            each = running[lane]
            assert each.current is not None
            world.assign(lane, self._skill_goal(world, lane, each, each.current))
            each.began = each.step
        for (name, scripted), group in self._groups(lanes, running).items():
            skill = self._skills[name]
            fresh = skill.begin(perceived(world.sense(group), group, running))
            if self._progress is None or len(self._progress) != world.num_lanes:
                self._progress = fresh[np.zeros(world.num_lanes, dtype=np.int64)]
            self._progress = self._progress.put(group, fresh)
            for lane in group.tolist():
                self._agents[name, scripted].begin(world, lane, skill)

    @staticmethod
    def _skill_goal(world: VectorSimulator, lane: int, each: Running, step: SkillStep) -> SkillGoal:
        """Return the goal of a step; a navigation to a further attempt ends away from where the earlier ones stood."""
        episode = each.planner.seen(each.facts(world, lane), step)
        goal = make_skill_goal(episode, step, world.simulator(lane))
        for effect in each.effects:
            goal = effect.perceive_goal(goal)
        stood = each.stood[step.toward or step.skill, step.target]
        if step.toward is None:
            stood.append(world.sense(np.array([lane])).base[0, :2].copy())
        elif not step.scripted:  # the oracle plans its own stand
            goal = keep_apart(goal, stood)
        return goal

    def _step(self, world: VectorSimulator, running: Mapping[int, Running]) -> None:
        groups = self._groups(sorted(running), running)
        # Lanes at the same skill lie side by side, so that a group's part of a record is a view.
        settling = [lane for lane, each in sorted(running.items()) if each.current is None]
        lanes = np.concatenate([*groups.values(), np.array(settling, dtype=np.int64)])
        ends = dict(zip(groups, np.cumsum([len(group) for group in groups.values()]).tolist(), strict=True))
        rows = {name: slice(ends[name] - len(group), ends[name]) for name, group in groups.items()}

        # Sense what the agents need: only some want the scan and the target's neighbors.
        scan_reach = np.zeros(len(lanes))
        neighbors = np.zeros(len(lanes), dtype=bool)
        for name in groups:
            if self._agents[name].needs_scan:
                skill = self._skills[name[0]]
                scan_reach[rows[name]] = skill.scan_reach
                neighbors[rows[name]] = skill.needs_neighbors
        known = perceived(world.sense(lanes, scan_reach, neighbors), lanes, running)

        # Act. A lane in its settling time stands still.
        actions = np.zeros((world.num_lanes, ROBOT.action_size))
        speed = np.ones(world.num_lanes)
        arm_step = np.zeros(world.num_lanes)
        for name, group in groups.items():
            skill = self._skills[name[0]]
            state = known[rows[name]]
            assert self._progress is not None
            acted = self._agents[name].act(world, group, skill, state, self._progress[group])
            actions[group] = skill.mask(acted, state)
            speed[group] = skill.base_speed
            arm_step[group] = skill.arm_step
        world.step(actions[lanes], lanes, speed[lanes], arm_step[lanes])

        # Record the step, and go on to the next skills.
        after = world.sense(lanes)
        self._record(world, lanes, running, after)
        after = disturbed(world, after, lanes, running)
        for name, group in groups.items():
            self._end_skills(world, name, group, after[rows[name]], running)

    def _groups(self, lanes: Sequence[int], running: Mapping[int, Running]) -> dict[tuple[str, bool], IntArray]:
        """Return the lanes at each skill, scripted or not; lanes in their settling time are in no group."""
        groups: dict[tuple[str, bool], list[int]] = {}
        for lane in lanes:
            step = running[lane].current
            if step is not None:
                groups.setdefault((step.skill, step.scripted), []).append(lane)
        return {name: np.array(group) for name, group in groups.items()}

    def _ending(
        self, name: tuple[str, bool], lane: int, stopped: bool, elapsed: int, holds: bool, at_limit: bool
    ) -> Ending | None:
        """Return why a skill ends now, None while it goes on; an agent that holds the target may ask for more time."""
        limit = self._skills[name[0]].limit
        out_of_time = elapsed >= limit
        if out_of_time and holds and elapsed < limit + OVERTIME:
            out_of_time = not self._agents[name].overtime(lane)
        if stopped:
            return "stopped"
        if out_of_time:
            return "timed out"
        return "task limit" if at_limit else None

    def _end_skills(
        self,
        world: VectorSimulator,
        name: tuple[str, bool],
        group: IntArray,
        state: PrivilegedState,
        running: Mapping[int, Running],
    ) -> None:
        """End skills that stop or run out of time, and begin the next ones."""
        skill = self._skills[name[0]]
        assert self._progress is not None
        progress = skill.advance(self._progress[group], state)
        self._progress = self._progress.put(group, progress)
        stop = skill.stop(state, progress)
        success = skill.success(state, progress)
        going_on = []
        for row, lane in enumerate(group.tolist()):
            each = running[lane]
            step = each.current
            assert step is not None
            at_limit = each.step >= each.episode.home_task.max_steps
            holds = bool(state.holds_target[row])
            ending = self._ending(name, lane, bool(stop[row]), int(progress.elapsed[row]), holds, at_limit)
            if ending is None:
                continue

            # A skill that must end with an empty hand lets go when its time is over.
            forced = ending == "timed out" and skill.ends_with_empty_hand and not bool(state.empty_hand[row])
            if forced:
                world.simulator(lane).release()

            # Record the run, and where a failed one stood.
            succeeded = bool(success[row] and not state.diverged[row])
            if not succeeded:
                each.stood[step.toward or step.skill, step.target].append(state.base[row, :2].copy())
            what = (step.skill, step.target, step.attempt, step.toward or "", self._agents[name].is_oracle)
            each.recorder.ended.append(SkillRun(*what, each.began, each.step, ending, succeeded, forced))

            # Ask the planner what is next.
            each.current = None if at_limit else each.planner.next(each.facts(world, lane), succeeded)
            if each.current is not None:
                going_on.append(lane)
        if going_on:
            self._begin_skills(world, going_on, running)

    @staticmethod
    def _record(
        world: VectorSimulator, lanes: IntArray, running: Mapping[int, Running], state: PrivilegedState
    ) -> None:
        """Add a row to the recorder of each lane after a control step; `state` is that of these lanes."""
        for row, lane in enumerate(lanes.tolist()):
            each = running[lane]
            simulator = world.simulator(lane)
            objects, held, positions = each.read(simulator)
            poses, velocities = simulator.objects(len(objects))
            up = 1.0 - 2.0 * (poses[:, 4] ** 2 + poses[:, 5] ** 2)
            speed = np.sqrt((velocities**2).sum(axis=1))
            touched = simulator.touched(len(objects))
            robot = (state.gripper[row], state.base[row], state.contact_force[row], touched)
            each.recorder.rows.append((objects, held, positions, up, speed, *robot))
            each.recorder.diverged |= bool(state.diverged[row])
            if each.current is not None:
                each.step += 1
            else:
                each.settling += 1
