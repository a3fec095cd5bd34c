"""Words of figures for release strategies, worlds, stages, outcomes and objects, instead of code names."""

from __future__ import annotations

import re

from perdure.home.benchmark.tasks import HomeTask, Stage
from perdure.home.errors import HomeError
from perdure.home.evaluate.outcomes.labels import DID_NOT_LAST, OTHER, SUCCESS
from perdure.home.evaluate.protocol.naming import read_strategy
from perdure.home.sim.objects import short_name

_STRATEGIES = {"rl": "policy alone", "stop": "stop", "ik": "stop, lower 5 cm", "ik+": "stop, lower to contact"}
_WORLDS = {
    "drag": "drag only",
    "hull-apple": "apple a convex hull",
    "base-velocity-removed": "base velocity removed",
    "released-at-zero-velocity": "released at zero velocity",
    "jaws-apart": "released objects touch the robot again",
}
_OUTCOMES = {
    SUCCESS: "every object stayed",
    DID_NOT_LAST: "counted as success, but an object left later",
    OTHER: "failed in another stage",
}


def describe(strategy: str, with_world: bool = True) -> str:
    """Return what a release strategy does: "ik" -> "stop, lower 5 cm"; the name itself where it is not ours.

    `with_world` adds what differs from the usual world.
    """
    try:
        place, _ = read_strategy(strategy)
    except HomeError:
        return strategy
    trained = re.fullmatch(r"delta-(\d+)(?:-in-(\d+))?", place)
    if trained:
        words = f"trained to stay {trained[1]} steps" + (f" of {trained[2]}" if trained[2] else "")
    else:
        words = _STRATEGIES.get(place, place)
    return ", ".join(filter(None, (words, world(strategy) if with_world else "")))


def world(strategy: str) -> str:
    """Return settings that differ from the default world: "ik drag" -> "drag only"; "" where unknown."""
    try:
        read_strategy(strategy)
    except HomeError:
        return ""
    return ", ".join(_WORLDS.get(word, word.replace("-", " ")) for word in strategy.split(" ")[1:])


def stage(each: Stage, unmet: bool = False) -> str:
    """Return the state in which a stage is reached, "pick_0" -> "object 1 picked"; unmet: "object 1 not picked"."""
    verb, _, number = each.name.partition("_")
    past = {"pick": "picked", "place": "placed", "open": "opened", "close": "closed"}[verb]
    doors = [found.name.removeprefix(f"{past}_") for found in each.conditions if found.name.startswith(f"{past}_")]
    return f"{doors[-1] if doors else f'object {int(number) + 1}'} {'not ' if unmet else ''}{past}"


def stages(task: HomeTask) -> tuple[str, ...]:
    """Return the words of all stages of a task, in order."""
    return tuple(stage(each) for each in task.stages)


def outcome(name: str) -> str:
    """Return what became of an episode, see `outcomes.outcome`: "place_1" -> "object 2 did not stay"."""
    if name in _OUTCOMES:
        return _OUTCOMES[name]
    return f"object {int(name.partition('_')[2]) + 1} did not stay"


def kind(name: str, cylinder: bool) -> str:
    """Return the name of an object: "013_apple" -> "apple", with "(cylinder)" for cans."""
    words = short_name(name)
    return f"{words} (cylinder)" if cylinder else words


def task(name: str) -> str:
    """Return a task as the benchmark writes it: "set_table" -> "SetTable"."""
    return name.title().replace("_", "")
