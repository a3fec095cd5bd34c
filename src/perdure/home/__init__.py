"""The Home Assistant Benchmark on MuJoCo: a Fetch robot tidies the house, prepares groceries and sets the table.

Subpackages, each built on those before it:
    sim          robot, objects, apartments; simulators of one or many of them; head camera
    tasks        tasks, episodes and their generator, planner
    skills       observations, rewards, start states and recipes of the skills
    agents       policies, oracle, release strategies
    evaluate     run episodes, write logs, measure success
    pictures, film, failures    pictures of a home; films and a live view; failed episodes in pictures

A lane is one of several episodes that run side by side. M3 is Gu et al., Multi-skill Mobile Manipulation (2023), whose
code (hab-mobile-manipulation) most definitions follow. "Our choice" marks what this package decided itself.
"""

from perdure.home.sim.apartments import build_apartment, make_apartment
from perdure.home.sim.occupancy import free_space
from perdure.home.sim.pieces import Apartment
from perdure.home.tasks.episodes import Episode, load_episodes, start_pose
from perdure.home.tasks.tasks import TASKS, HomeTask, WorldFacts, get_task

__all__ = [
    "TASKS",
    "Apartment",
    "Episode",
    "HomeTask",
    "WorldFacts",
    "build_apartment",
    "free_space",
    "get_task",
    "load_episodes",
    "make_apartment",
    "start_pose",
]
