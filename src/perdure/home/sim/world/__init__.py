"""The simulation that training, oracle and evaluation share: scenes, lanes, magic grasp, state.

Contents:
    SceneOptions, Scene, build_scene                   compiled models
    VectorSimulator                                    many lanes in a pool of threads
    Simulator                                               one of them
    PrivilegedState, SkillGoal                         privileged state of all lanes, and the goal of the current skill
    ACTION_SIZE, FORWARD, TURN, ARM, GRIP, ...         parts and sizes of an action
"""

from perdure.home.sim.world.actions import (
    ACTION_SIZE,
    ARM,
    ARM_STEP,
    BASE_SPEED,
    FORWARD,
    GRASP,
    GRASP_RADIUS,
    GRIP,
    LEAVE,
    NAVIGATION_SPEED,
    RELEASE,
    STOP,
    TURN,
)
from perdure.home.sim.world.neighbors import NEIGHBORHOOD, NEIGHBORS
from perdure.home.sim.world.scan import BEAMS, SCAN_ANGLES, SCAN_RANGE
from perdure.home.sim.world.scene import (
    CONTROL_HZ,
    PHYSICS_HZ,
    ReleaseVelocity,
    Rolling,
    Scene,
    SceneOptions,
    build_scene,
)
from perdure.home.sim.world.simulator import Jaws, Simulator
from perdure.home.sim.world.state import PrivilegedState, SkillGoal
from perdure.home.sim.world.vector_simulator import VectorSimulator

__all__ = [
    "ACTION_SIZE",
    "ARM",
    "ARM_STEP",
    "BASE_SPEED",
    "BEAMS",
    "CONTROL_HZ",
    "FORWARD",
    "GRASP",
    "GRASP_RADIUS",
    "GRIP",
    "LEAVE",
    "NAVIGATION_SPEED",
    "NEIGHBORHOOD",
    "NEIGHBORS",
    "PHYSICS_HZ",
    "RELEASE",
    "SCAN_ANGLES",
    "SCAN_RANGE",
    "STOP",
    "TURN",
    "Jaws",
    "PrivilegedState",
    "ReleaseVelocity",
    "Rolling",
    "Scene",
    "SceneOptions",
    "Simulator",
    "SkillGoal",
    "VectorSimulator",
    "build_scene",
]
