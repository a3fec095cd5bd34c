"""Environments of every skill and task, thin and small, and ways to drive them."""

from types import SimpleNamespace

import numpy as np

from perdure.home.skills import learned_skills
from perdure.home.skills.environment import HomeSkillVectorEnv
from perdure.home.skills.starts import put
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import TASKS

LESSONS = [
    (skill, task)
    for skill in learned_skills()
    for task in TASKS
    if any(step.skill == skill for step in make_plan(task))
]
"""Every skill with every task that uses it."""


def make(skill, task, lanes=1, episodes=3, **options):
    """A vector over a few published episodes, without clutter, stepped by one thread unless stated otherwise."""
    options = {"threads": 1, "split": "val", **options}
    return HomeSkillVectorEnv(lanes, skill=skill, task=task, episodes=episodes, **options)


def random_actions(env, steps, seed=0):
    """Shape (steps, m): the action of one lane."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *env.single_action_space.shape))


def drive(env, seeds, actions):
    """Steps with stored actions, shape (steps, lanes, m); ended lanes are reset. All that came of it, step by step."""
    observations, _ = env.reset(seed=list(seeds))
    seen, over = [(observations,)], np.zeros(env.num_envs, dtype=bool)
    for action in actions:
        if over.any():
            observations, _ = env.reset(options={"reset_mask": over})
            seen.append((observations,))
        observations, rewards, terminated, truncated, info = env.step(action)
        over = terminated | truncated
        seen.append((observations, rewards, terminated, truncated, info))
    return seen


def begin_at(env, *starts):
    """Lets the env's lanes begin at given starts, made from its first episode and the skill's first target."""
    real, target = env.sampler, env.options.chosen_targets[0]

    def begin(world, lane, rng):
        put(world, lane, real.scene(0, target), starts[lane])
        return real.episodes[0]

    env.sampler = SimpleNamespace(begin=begin, episodes=real.episodes, scene=real.scene)
    return env


def rows(info):
    """Names and arrays of an info, nested ones too, without the masks."""
    for name, value in info.items():
        if isinstance(value, dict):
            yield from rows(value)
        elif not name.startswith("_"):
            yield name, value
