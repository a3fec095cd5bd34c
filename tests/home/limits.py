"""Episodes of SetTable that are over after their first skills: planning motions takes most of a test's time."""

from dataclasses import replace

from perdure.home.skills import SKILLS
from perdure.home.tasks.tasks import TASKS


def shorten(patch, skill_steps, task_steps):
    """Let each skill take so many steps, and an episode so many."""
    for skill in SKILLS.values():
        patch.setattr(skill, "step_limit", skill_steps)
    patch.setitem(TASKS, "set_table", replace(TASKS["set_table"], max_steps=task_steps))
