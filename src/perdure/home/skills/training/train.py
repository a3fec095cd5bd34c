"""Train a skill with its recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from perdure.envs import make_world
from perdure.home.errors import HomeError
from perdure.home.skills.gym import env_id
from perdure.home.skills.gym.options import checked_options
from perdure.home.skills.recipe import Recipe
from perdure.home.skills.registry import SKILLS, choices, learned_skills
from perdure.horizon import Fixed
from perdure.ppo import PPOConfig, method_config
from perdure.ppo.training import TrainRun, train
from perdure.runs import Observer

HIDDEN = (256, 256)
FLAGS = ("delta", "limited_to", "rolling")
"""Environment options that are also flags of `perdure home train`."""


def skill_task(skill: str, task: str, **options: object) -> str:
    """Return the name of a skill's environment with its options, for `perdure.envs.make_world`."""
    parts = [env_id(skill), f"task={task}", *(f"{name}={value}" for name, value in options.items())]
    return ",".join(part.replace(" ", "") for part in parts)


def skill_recipe(skill: str, task: str) -> Recipe:
    """Return the recipe of a skill on a task; HomeError for a skill without one."""
    recipe = SKILLS[skill].recipe if skill in SKILLS else None
    if recipe is None:
        raise HomeError(f"no recipe for the skill {skill!r}; {choices(skill, learned_skills())}")
    return SKILLS[skill].task_recipes.get(task, recipe)


def skill_config(skill: str, task: str, **options: object) -> PPOConfig:
    """Return PPO's settings for a skill on a task, with options of the environment.

    A skill's time-out is no part of the task, because the plan continues. So the last observation is bootstrapped.
    """
    recipe = skill_recipe(skill, task)
    world = make_world(skill_task(skill, task, **{**options, "split": "val", "episodes": 1}), [0])
    size = world.spec.observation_size
    world.close()
    config = method_config("ppo", task, size)
    limit = checked_options({"skill": skill, "task": task, **options}).make_skill().limit
    protocol = replace(
        config.protocol, horizon=Fixed(limit), gamma=recipe.gamma, normalizer_gamma=recipe.gamma, end="truncated"
    )
    settings: dict[str, Any] = {"hidden_sizes": HIDDEN, "learning_rate_decay": "linear", "segment_steps": 100_000}
    settings |= {each.name: getattr(recipe, each.name) for each in fields(PPOConfig) if hasattr(recipe, each.name)}
    return replace(config, protocol=protocol, **settings)


def train_skill(
    skill: str,
    task: str,
    seeds: tuple[int, ...],
    out: str | Path,
    total_steps: int | None = None,
    *,
    cores: int | None = None,
    on: str = "here",
    observe: Observer = lambda status: None,
    **options: object,
) -> list[Path]:
    """Train a skill with its recipe; the same call resumes an interrupted training.

    Args:
        skill: Name of the skill.
        task: The task whose objects and places are used.
        seeds: Training seeds.
        out: The folder of the runs.
        total_steps: Environment steps in place of the recipe's.
        cores: Number of cores; all by default.
        on: Where to train, see `perdure.ppo.train`.
        observe: Called with the progress of every seed.
        options: Options of the environment, such as `delta`.

    Returns:
        The policy files, one for each seed.
    """
    config = skill_config(skill, task, **options)
    config = config if total_steps is None else replace(config, total_steps=total_steps)
    command = train_command(skill, task, total_steps, options)
    env_options = {**skill_recipe(skill, task).env_options, **options}
    run = TrainRun(skill_task(skill, task, **env_options), skill, config, seeds, command)
    return train(run, out, cores=cores, on=on, observe=observe)


def train_command(skill: str, task: str, total_steps: int | None, options: Mapping[str, object]) -> str:
    """Return the command that trains `{seed}` again; a Python call for options without a flag."""
    if options.keys() <= set(FLAGS):
        steps = {} if total_steps is None else {"steps": total_steps}
        flags = {"task": task, "seeds": "{seed}", **options, **steps}
        return f"perdure home train {skill} " + " ".join(
            f"--{name.replace('_', '-')} {value}" for name, value in flags.items()
        )
    given = "".join(f", {name}={value!r}" for name, value in {"total_steps": total_steps, **options}.items())
    return f"perdure.home.skills.training.train_skill({skill!r}, {task!r}, ({{seed}},), OUT{given})"
