"""What the length of a physics step changes about placements: the same releases at several rates.

python benchmarks/physics_step.py [releases]

A target is let go of above its goal: up to 0.25 m high, tilted by up to 0.8 rad, moving at up to 0.8 m/s, at most
0.14 m beside the goal's middle. Five seconds later: does it lie within 0.15 m of the goal? Each release is simulated at
every rate, and at 240 Hz a second time from a place that is 1 micrometer off: what differs between these two is chance,
and no rate can agree better with another one.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np

from perdure.home.sim.scene import CONTROL_HZ, SceneOptions
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import Episode, episode_scene, load_episodes, start_pose
from perdure.home.tasks.tasks import TASKS

RATES = (60, 120, 240, 480)
GOAL_RADIUS, SECONDS = 0.15, 5
HEIGHT, TILT, SPEED, BESIDE = 0.25, 0.8, 0.8, 0.14
NUDGE = 1e-6


def release(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return how a target is let go of: offset in [m], unit quaternion, velocity in [m/s]."""
    axis, angle = rng.normal(size=3) * (1.0, 1.0, 0.0), rng.uniform(0.0, TILT)
    axis /= np.linalg.norm(axis)
    yaw, direction = rng.uniform(0.0, 2.0 * np.pi), rng.normal(size=3)
    beside = BESIDE * np.sqrt(rng.random())
    around = rng.uniform(0.0, 2.0 * np.pi)
    turn, tilt, quaternion = np.empty((3, 4))
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
    mujoco.mju_axisAngle2Quat(tilt, axis, angle)
    mujoco.mju_mulQuat(quaternion, tilt, turn)
    return {
        "offset": np.array([beside * np.cos(around), beside * np.sin(around), rng.uniform(0.0, HEIGHT)]),
        "quaternion": quaternion,
        "velocity": rng.uniform(0.0, SPEED) * direction / np.linalg.norm(direction),
    }


def settle(episode: Episode, target: int, how: dict[str, np.ndarray], rate: int, nudge: float = 0.0) -> float:
    """Return the distance from the goal in [m] after five seconds."""
    scene = episode_scene(episode, SceneOptions(physics_hz=rate))
    world, goal = VectorSimulator(1, threads=1), np.asarray(episode.goals[target].position)
    world.reset(0, scene, start_pose(scene.apartment, episode, 0), opened={"top_door": 2.0, "drawer4": 0.45})
    lane = world.simulator(0)
    for _ in range(CONTROL_HZ):
        lane.step()
    pose, velocity = lane.object(target)
    pose[:3] = goal + how["offset"] + (nudge, 0.0, 0.0)
    pose[3:] = how["quaternion"]
    velocity[:] = how["velocity"]
    for _ in range(SECONDS * CONTROL_HZ):
        lane.step()
    return float(np.linalg.norm(lane.object(target)[0][:3] - goal))


def main(count: int) -> None:
    """Print the table."""
    names = [*(str(rate) for rate in RATES), "240, nudged"]
    distance: dict[str, list[float]] = {name: [] for name in names}
    cases = [
        (episode, target)
        for task in TASKS
        for episode in load_episodes(task, "val").episodes
        for target in range(len(episode.goals))
    ]
    rng = np.random.Generator(np.random.PCG64(0))
    order = rng.permutation(len(cases))
    for turn in range(count):
        episode, target = cases[order[turn % len(cases)]]
        how = release(rng)
        for rate in RATES:
            distance[str(rate)].append(settle(episode, target, how, rate))
        distance["240, nudged"].append(settle(episode, target, how, 240, NUDGE))
        print(f"\r{turn + 1} of {count} releases", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    stays = {name: np.array(values) <= GOAL_RADIUS for name, values in distance.items()}
    fraction = {name: float(each.mean()) for name, each in stays.items()}
    print(f"{'physics':>12} {'stay':>7} {'+-':>6} {'as at 480 Hz':>13} {'as at 240 Hz':>13}")
    for name in names:
        error = np.sqrt(fraction[name] * (1.0 - fraction[name]) / count)
        same = [float((stays[name] == stays[other]).mean()) for other in ("480", "240")]
        print(f"{name:>12} {fraction[name]:7.3f} {error:6.3f} {same[0]:13.3f} {same[1]:13.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
