"""Records an episode step by step and makes its `EpisodeLog`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from perdure.home.benchmark.episodes import Episode, episode_hash
from perdure.home.benchmark.tasks import NOTHING, SOMETHING_ELSE, WorldFacts
from perdure.home.evaluate.log import EpisodeLog, FinalObject, History, SkillRun, Target
from perdure.home.sim.apartments import FRIDGE_DOOR
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.objects import KINDS
from perdure.home.sim.world import CONTROL_HZ, PrivilegedState, Scene, VectorSimulator
from perdure.home.sim.world.state import norm


@dataclass
class Recorder:
    """Collects the state of one episode; the columns of a step are kept as one row."""

    episode: Episode
    ended: list[SkillRun] = field(default_factory=list)
    """Skills that have ended, without force and reach."""
    rows: list[FloatArray] = field(default_factory=list)
    diverged: bool = False
    """Whether the simulation diverged; nothing after that counts."""

    def log(self, steps: int, final_objects: tuple[FinalObject, ...], **run: str | int) -> EpisodeLog:
        """Return the log of the episode.

        Args:
            steps: Control steps until the plan or the task's limit ended; the rows after them are the settling time.
            final_objects: All objects after the last step.
            run: `strategy`, `train_seed` and `eval_seed` of the log.
        """
        # A diverged world is reset to its start: the last row no longer belongs to this episode.
        length = max(1, len(self.rows) - 1) if self.diverged else len(self.rows)
        steps, episode, history = min(steps, length), self.episode, self._history(length)
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
            **run,  # type: ignore[arg-type]
        )

    def _history(self, length: int) -> History:
        targets = len(self.episode.goals)
        shapes = ((targets, 3), (), (), (), (3,), (3,), (targets,), (targets,), ())
        ends = np.cumsum([np.prod(shape, dtype=np.int64) for shape in shapes])
        columns = np.split(np.array(self.rows[:length]), ends[:-1], axis=1)
        objects, held, drawer, fridge, base, gripper, up, speed, force = (
            each.reshape(len(each), *shape) for each, shape in zip(columns, shapes, strict=True)
        )
        facts = WorldFacts(objects, self.episode.goal_positions, held.astype(np.int64), drawer, fridge)
        return History(facts, up, speed, gripper, base, force, float(CONTROL_HZ))


def record_table(
    world: VectorSimulator, lanes: IntArray, state: PrivilegedState, targets: int, doors: Sequence[tuple[int, int]]
) -> FloatArray:
    """Return one row of a `Recorder` for each lane after a control step. Shape (lanes, width).

    `state` is that of these lanes, `targets` the task's number of targets, `doors` the `door_links` of each lane.
    """
    poses, velocities = world.objects(lanes, targets)
    up = 1.0 - 2.0 * (poses[:, :, 4] ** 2 + poses[:, :, 5] ** 2)
    speed = np.sqrt((velocities**2).sum(axis=2))
    columns = (
        *(poses[:, :, :3], held_target(state, targets), opened(world, lanes, doors)),
        *(state.base, state.gripper, up, speed, state.contact_force),
    )
    return np.concatenate([each.reshape(len(each), -1) for each in columns], axis=1, dtype=np.float64)


def final_objects(world: VectorSimulator, lane: int) -> tuple[FinalObject, ...]:
    """Return pose and speed of every object in the scene of a lane, targets first."""
    simulator = world.simulator(lane)
    placements, held = simulator.scene.placements, simulator.held
    poses, velocities = world.objects(np.array([lane]), len(placements))
    kinds = (placement.kind for placement in placements)
    rows = zip(kinds, poses[0].tolist(), norm(velocities[0]).tolist(), strict=True)
    return tuple(
        FinalObject(kind, (x, y, z), (qw, qx, qy, qz), speed, k == held)
        for k, (kind, (x, y, z, qw, qx, qy, qz), speed) in enumerate(rows)
    )


def held_target(state: PrivilegedState, targets: int) -> IntArray:
    """Return the number of the target in the hand, NOTHING, or SOMETHING_ELSE. Shape (lanes,)."""
    held = np.where((state.held >= 0) & (state.held < targets), state.held, NOTHING)
    return np.where((held == NOTHING) & ~state.empty_hand, SOMETHING_ELSE, held)


def door_links(episode: Episode, scene: Scene) -> tuple[int, int]:
    """Return the numbers of the task's drawer (-1 for none) and of the fridge's upper door in `Scene.links`."""
    containers = [episode.container(target) for target in range(len(episode.goals))]
    drawer = next((scene.links.index(each) for each in containers if each not in (None, FRIDGE_DOOR)), -1)
    return drawer, scene.links.index(FRIDGE_DOOR)


def opened(world: VectorSimulator, lanes: IntArray, doors: Sequence[tuple[int, int]]) -> FloatArray:
    """Return how far drawer (0 where there is none) and fridge are open. Shape (lanes, 2)."""
    rows = []
    for lane, (drawer, fridge) in zip(lanes.tolist(), doors, strict=True):
        links = world.simulator(lane).links.tolist()
        rows.append((links[drawer] if drawer >= 0 else 0.0, links[fridge]))
    return np.array(rows)


def _target(episode: Episode, number: int) -> Target:
    goal, link = episode.goals[number], episode.container(number)
    container = "" if link is None else "fridge" if link == FRIDGE_DOOR else "drawer"
    return Target(goal.kind, KINDS[goal.kind].cylinder, container, goal.position)
