"""Render the Fetch's gripper before and after it lets go of a soup can, like figure 2-4 of the thesis.

python tools/figure_gripper_and_can.py

Nothing is posed. Each row is a release from a `val` episode that the shipped policies (training seed 0) run with the
release strategy `rl`. The left panel shows the last control step with the can in the hand, the right panel a moment
later, both from the same camera. The camera looks along the can's axis and slightly across it. The two
episodes were chosen because nothing hides the can. Writes docs/images/home-gripper-and-can.png.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perdure.film import GRAY, INK, annotate, save_picture
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.film import make_agent
from perdure.home.pictures import Shot, Studio, put, render_scene
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.tasks.episodes import Episode, load_episodes

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "home-gripper-and-can.png"
CAN = "005_tomato_soup_can"
ROWS = (
    ("tidy_house", 53, 0.17, "The jaws are left and right of the curved wall, not at the flat ends."),
    ("prepare_groceries", 41, -0.30, "The jaws are above and below the curved wall, not at the flat ends."),
)
"""Task, number of the episode, how far across the can's axis the camera stands in [m], text over the left panel."""
ALONG, UP = 0.42, 0.13
"""Where the camera stands from the gripper point in [m]: along the can's axis, and upward."""
LATER = 5
"""Control steps between the two panels: the can has landed."""
SIZE, GAP, COLORS = (660, 460), 8, 256


def release(task: str, number: int) -> tuple[Episode, FloatArray, FloatArray]:
    """Run an episode up to its first release of a soup can and return it with two states.

    Returns:
        The episode, and MuJoCo's `qpos` at the last step in the hand and `LATER` steps after it. Shape (nq,) each.
    """
    episode, agent = load_episodes(task, "val")[number], make_agent(task, "rl")
    states, held = list[FloatArray](), list[bool]()

    def keep(world: VectorSimulator, episodes: Mapping[int, Episode]) -> None:
        lane = world.simulator(0)
        states.append(lane.qpos.copy())
        held.append(lane.held >= 0 and episode.objects[lane.held].kind == CAN)

    list(Executor(agent.skills, agent.skill_agents, ExecutorOptions(lanes=1, threads=1)).run([episode], keep))
    last = next(step for step, (now, then) in enumerate(pairwise(held)) if now and not then)
    return episode, states[last], states[last + LATER]


def row(task: str, number: int, across: float, caption: str) -> Picture:
    """Render the two panels of a release next to each other. See `ROWS` for the arguments."""
    episode, before, after = release(task, number)
    title = task.replace("_", " ").title().replace(" ", "")
    later = f"{title}, {LATER / CONTROL_HZ:.2f} s later"
    texts = ((f"{title}, last moment in the hand", caption), (later, "The can lies on its curved wall."))
    panels: list[Picture] = []
    simulator = render_scene(episode, 0)
    with Studio(simulator, SIZE) as studio:
        put(simulator, before)
        point, level = simulator.gripper.copy(), simulator.gripper_axes[:2].copy()
        level /= np.linalg.norm(level, axis=0)  # a held can has the gripper's axes: z along the can, y from jaw to jaw
        eye = point + np.array([*(ALONG * level[:, 2] + across * level[:, 1]), UP])
        for state, words in zip((before, after), texts, strict=True):
            put(simulator, state)
            title, note = words
            panels += [annotate(studio.take(Shot(eye, point)), [(18, [(title, INK)]), (13, [(note, GRAY)])])]
    return np.concatenate([panels[0], np.full((len(panels[0]), GAP, 3), 255, np.uint8), panels[1]], axis=1)


if __name__ == "__main__":
    first, second = (row(*each) for each in ROWS)
    gap = np.full((GAP, first.shape[1], 3), 255, np.uint8)
    PICTURE.unlink(missing_ok=True)
    print(save_picture(np.concatenate([first, gap, second]), PICTURE, COLORS))
