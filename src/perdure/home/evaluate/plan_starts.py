"""Record start states for training: the states before the skills of a task's plan, in a closed loop."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace

import msgspec
import numpy as np

from perdure.home.evaluate.execute import Executor, ExecutorOptions, Running
from perdure.home.evaluate.policies import ORACLE, make_agents, shipped_seeds
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import SKILLS
from perdure.home.skills.starts import TOUCH, PlanStart, open_links, plan_starts_file, touching, train_pool
from perdure.home.tasks.planners import needed_skills
from perdure.home.tasks.tasks import get_task
from perdure.runs import write_atomic

RUNS = 3
"""Of each training episode, with the shipped policy sets in turn."""


def record_plan_starts(task: str) -> None:
    """Run the training episodes and store the states in which skills begin; nothing where that is done.

    The shipped policies act; where they were trained with other physics, the oracle.
    """
    if (path := plan_starts_file(task)).exists():
        return
    print(f"recording start states of {task} (once, some minutes)", file=sys.stderr, flush=True)
    rows: list[PlanStart] = []
    counts = [len(shipped_seeds(task, skill)) for skill in needed_skills(get_task(task), "closed")]
    sets = min(filter(None, counts), default=1)
    for run in range(RUNS):
        protocol = EvaluationProtocol(task, options=ExecutorOptions(eval_seed=run, planner="closed"))
        if protocol.trained_otherwise():  # with this physics the shipped policies fail, and so would their plans
            protocol = replace(protocol, policies=dict.fromkeys(SKILLS, ORACLE))
        executor = Executor(protocol.skills(), make_agents(protocol.policies_of(run % sets), "rl"), protocol.options)
        for _ in executor.run(train_pool(task).episodes, lambda *now: rows.extend(found_states(*now))):
            pass
    write_atomic(path, msgspec.json.encode(rows))


def found_states(world: VectorSimulator, running: Mapping[int, Running]) -> list[PlanStart]:
    """Return the states of lanes in which a skill begins, free of contact and with what it expects in hand."""
    found = []
    for lane, each in running.items():
        step, simulator = each.current, world.simulator(lane)
        if step is None or each.step != each.began or step.skill == "reset_arm" or touching(simulator) > TOUCH:
            continue
        what = step.skill, step.target, step.toward
        believed = each.planner.seen(each.facts(world, lane), step).objects[step.target]
        held = step.target if "place" in what else -1
        if each.recorder.diverged or (simulator.held, simulator.held_link) != (held, -1):
            continue
        robot = np.round(simulator.robot, 4).tolist()
        x, y, yaw = robot[:3]
        opened = {**dict.fromkeys(each.episode.opened, 0.0), **open_links(simulator)}
        a, b, c, w, i, j, k = np.round(simulator.object(step.target)[0], 5).tolist()
        base, arm, pose = (x, y, yaw), tuple(robot[ROBOT.arm_columns]), ((a, b, c), (w, i, j, k))
        seen = believed.receptacle, believed.position
        others = [] if step.scripted else each.stood[step.toward or step.skill, step.target]
        stood = tuple((float(x), float(y)) for x, y in others)
        found.append(PlanStart(each.episode.index, what, step.attempt, seen, stood, base, arm, opened, pose))
    return found
