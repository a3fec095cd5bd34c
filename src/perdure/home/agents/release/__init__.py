"""Release strategies: agents that wrap the agent of place.

Contents:
    STRATEGIES, make_strategy    by name: rl (the policy alone), stop, ik, ik+
    HandOver               their common base: freeze, move, open the hand, continue
    Stop, Ik, IkPlus
"""

from perdure.home.agents.release.hand_over import HandOver
from perdure.home.agents.release.ik import Ik
from perdure.home.agents.release.ik_plus import IkPlus
from perdure.home.agents.release.stop import Stop
from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.errors import HomeError

_HAND_OVERS: dict[str, type[HandOver]] = {each.name: each for each in (Stop, Ik, IkPlus)}
STRATEGIES: tuple[str, ...] = ("rl", *_HAND_OVERS)
"""Names of all, the values of `--place`."""


def make_strategy(name: str, inner: SkillAgent) -> SkillAgent:
    """Return the strategy of that name around an agent; `rl` is the agent itself."""
    if name == "rl":
        return inner
    if name not in _HAND_OVERS:
        raise HomeError(f"no release strategy is named {name!r}; there are {', '.join(STRATEGIES)}")
    return _HAND_OVERS[name](inner)


__all__ = ["STRATEGIES", "HandOver", "Ik", "IkPlus", "Stop", "make_strategy"]
