"""Robots that are put where they can reach something, and simple motions for them."""

from functools import cache

import numpy as np

from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import ARM_STEP
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills.starts import TOUCH, Start, put, touching
from tests.home.arm_poses import reach

AROUND = np.linspace(0.0, 2.0 * np.pi, 24)


@cache
def pose(far, height):
    """The arm for a point so far ahead and so high; it does not depend on where the robot stands."""
    return reach((far, 0.0, height), ROBOT.rest_arm, approach=(0.6, 0.0, -0.8))


def start_within_reach(scene, point, skill_goal, above=0.1, back=0.0, headings=AROUND, **start):
    """A start without contacts whose gripper is so far above a point of the room, and so far before it."""
    world = VectorSimulator(1)
    for heading in headings:
        for far in (0.7, 0.8, 0.6, 0.9):
            base = Pose(point[0] - far * np.cos(heading), point[1] - far * np.sin(heading), float(heading))
            found = pose(far - back, float(point[2] + above))
            if not found.ok:
                continue
            one = Start(base, found.arm, skill_goal, **start)
            put(world, 0, scene, one)
            if touching(world.simulator(0)) <= TOUCH:
                return one
    raise AssertionError("nothing is within reach from anywhere")


def action(forward=0.0, arm=None, grip=0.0):
    """The action of one lane; `arm` in radians per joint."""
    action = np.zeros((1, 10))
    action[0, 0], action[0, ROBOT.action.grip] = forward, grip
    if arm is not None:
        action[0, ROBOT.action.arm] = np.clip(np.asarray(arm) / ARM_STEP, -1.0, 1.0)
    return action


def to_rest(env):
    """The action that brings the arm nearer to rest."""
    left = ROBOT.rest_arm - env.state.arm_target[0]
    return action(arm=left / max(1.0, np.abs(left).max() / ARM_STEP))


def steps_until(env, action, done, limit=200):
    """Steps with action(env) until done(env) or the end; the last outcome."""
    for _ in range(limit):
        outcome = env.step(action(env))
        if outcome[2][0] or outcome[3][0] or done(env):
            return outcome
    raise AssertionError(f"not done within {limit} steps")


def never(env):
    return False
