"""The Home Assistant Benchmark on MuJoCo: a Fetch robot tidies the house, prepares groceries and sets the table.

It reads from top to bottom like the benchmark itself:
    robot       the Fetch as MJCF
    objects     the ten YCB objects
    layouts     the apartments and the free space in them
    tasks       the three tasks: goals, skill sequences, stages, two ways of counting
    episodes    starts, goals and clutter, kept in files

Importing this package imports NumPy and nothing heavier; MuJoCo, SciPy and matplotlib are imported where they are used.
"""

from perdure.home.benchmark.episodes import Episode, load_episodes, start_pose
from perdure.home.benchmark.tasks import TASKS, HomeTask, WorldFacts, get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, build_apartment, free_space, make_apartment

__all__ = [
    "TASKS",
    "Apartment",
    "Episode",
    "HomeError",
    "HomeTask",
    "WorldFacts",
    "build_apartment",
    "free_space",
    "get_task",
    "load_episodes",
    "make_apartment",
    "start_pose",
]
