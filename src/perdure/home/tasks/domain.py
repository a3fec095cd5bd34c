"""The planning domain of the Home Assistant Benchmark: which skill when. Actions are named like the skills.

Doors. "Not in a closed container" is a negation over what holds the target; plain STRIPS has none. So every target is
in exactly one holder, every holder is open or closed, and what stands on tables and counters is in the holder
`in_the_open`, which is always open.

Where the robot is. It stands at one landmark, the last one it went to. A drawer is pulled towards the robot: with the
drawer open, the robot stands at the target that lies in it. The fridge's door swings through where the robot stands:
whoever moves it ends up elsewhere. That is why SetTable picks the bowl without navigating, but not the apple.

Order. Only the target whose turn it is may be handled. The turn goes to the next target when this one is at its goal
and never comes back, so a container the task wants closed is closed before it goes.
"""

from __future__ import annotations

from perdure.home.sim.pieces import CONTAINERS, Container
from perdure.home.tasks.strips import ActionSchema, Domain
from perdure.home.tasks.tasks import Verb

ELSEWHERE = "elsewhere"
"""The landmark of a robot that stands at none of the others."""
IN_THE_OPEN = "in_the_open"
NEXT_TARGET = "next_target"
"""No skill: the benchmark's counter of targets."""
TYPES = {
    "landmark": "object",
    "target": "landmark",
    "goal": "landmark",
    "holder": "landmark",
    **dict.fromkeys(CONTAINERS, "holder"),
}
PDDL_PREDICATES = {
    "turn": (("?t", "target"),),
    "next": (("?t", "target"), ("?u", "target")),  # after ?t comes ?u
    "concerns": (("?l", "landmark"), ("?t", "target")),  # handling ?t may lead to ?l: itself, its goal, its containers
    "goal_of": (("?g", "goal"), ("?t", "target"), ("?h", "holder")),  # ?t belongs at ?g, which is in ?h
    "robot_at": (("?l", "landmark"),),
    "in": (("?t", "target"), ("?h", "holder")),
    "open": (("?h", "holder"),),
    "closed": (("?h", "holder"),),
    "hand_empty": (),
    "holding": (("?t", "target"),),
    "at_goal": (("?t", "target"),),
}
NAVIGATE = ActionSchema(
    Verb.NAVIGATE.value,
    parameters=(("?t", "target"), ("?here", "landmark"), ("?there", "landmark")),
    needs=(("turn", "?t"), ("robot_at", "?here"), ("concerns", "?there", "?t")),
    adds=(("robot_at", "?there"),),
    deletes=(("robot_at", "?here"),),
)
PICK = ActionSchema(
    Verb.PICK.value,
    parameters=(("?t", "target"), ("?h", "holder")),
    needs=(("turn", "?t"), ("robot_at", "?t"), ("in", "?t", "?h"), ("open", "?h"), ("hand_empty",)),
    adds=(("holding", "?t"),),
    deletes=(("hand_empty",), ("in", "?t", "?h"), ("at_goal", "?t")),
)
PLACE = ActionSchema(
    Verb.PLACE.value,
    parameters=(("?t", "target"), ("?g", "goal"), ("?h", "holder")),
    needs=(("turn", "?t"), ("robot_at", "?g"), ("holding", "?t"), ("goal_of", "?g", "?t", "?h"), ("open", "?h")),
    adds=(("hand_empty",), ("in", "?t", "?h"), ("at_goal", "?t")),
    deletes=(("holding", "?t"),),
)
TURN = ActionSchema(
    NEXT_TARGET,
    parameters=(("?t", "target"), ("?u", "target")),
    needs=(("turn", "?t"), ("next", "?t", "?u"), ("at_goal", "?t"), ("hand_empty",)),
    adds=(("turn", "?u"),),
    deletes=(("turn", "?t"),),
)


def open_container(container: Container) -> ActionSchema:
    """Return the action that opens a container: a drawer for what lies in it, a door also for what belongs behind."""
    inside = ("in", "?t", "?c") if container.slides else ("concerns", "?c", "?t")
    robot_at = "?t" if container.slides else ELSEWHERE
    return ActionSchema(
        container.open_skill,
        parameters=(("?t", "target"), ("?c", container.name)),
        needs=(("turn", "?t"), ("robot_at", "?c"), inside, ("closed", "?c"), ("hand_empty",)),
        adds=(("open", "?c"), ("robot_at", robot_at)),
        deletes=(("closed", "?c"), ("robot_at", "?c")),
    )


def close_container(container: Container) -> ActionSchema:
    """Return the action that closes a container; the robot stays in front of a drawer, but not of a door."""
    moved = () if container.slides else (("robot_at", "?c"),)
    arrived = () if container.slides else (("robot_at", ELSEWHERE),)
    return ActionSchema(
        container.close_skill,
        parameters=(("?t", "target"), ("?c", container.name)),
        needs=(("turn", "?t"), ("robot_at", "?c"), ("concerns", "?c", "?t"), ("open", "?c"), ("hand_empty",)),
        adds=(("closed", "?c"), *arrived),
        deletes=(("open", "?c"), *moved),
    )


_DOORS = tuple(action for each in CONTAINERS.values() for action in (open_container(each), close_container(each)))
HOME = Domain(
    "home",
    types=TYPES,
    constants=((ELSEWHERE, "landmark"), (IN_THE_OPEN, "holder")),
    predicates=PDDL_PREDICATES,
    actions=(NAVIGATE, PICK, PLACE, *_DOORS, TURN),
)
