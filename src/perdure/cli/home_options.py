"""Options that several commands of ``perdure home`` share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from perdure.errors import PerdureError
from perdure.home.sim.scene import SceneOptions, WorldOptions
from perdure.home.tasks.planners import FallbackName

if TYPE_CHECKING:
    from perdure.home.evaluate.protocol import EvaluationProtocol

Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(help="A task of `perdure home list`, such as set_table.")]
Split = Annotated[
    str, tyro.conf.arg(help="val (known layouts, arranged anew), eval (a new layout) or eval-2 (five more).")
]
Index = Annotated[int, tyro.conf.arg(help="Number of the episode in its split.")]
EvalSeed = Annotated[int, tyro.conf.arg(help="Draws the robot's start pose.")]
Policies = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        help="SKILL=FILE or SKILL=oracle ({seed}: the training seed), or `oracle`; else shipped policies (of logs: "
        "those that they name), else the oracle. FILE@constant:50: a time-to-go input is 50 steps instead of those "
        "left in the skill."
    ),
]


def _listed(kinds: Mapping[str, Any], default: str) -> str:
    """Return the members of a vocabulary with their words, for the help of a flag."""
    members = "; ".join(f"{name}: {kind.words}" for name, kind in kinds.items())
    return f"({members}; default: {default})"


def _planners(default: str) -> str:
    from perdure.home.tasks.planners import Planner

    return _listed(Planner.kinds(), default)


def _release_strategies(default: str) -> str:
    from perdure.home.agents.release import ReleaseStrategy

    return _listed(ReleaseStrategy.kinds(), default)


def _disturbances(default: str) -> str:
    from perdure.home.evaluate.disturbances import HomeEffect

    return _listed(HomeEffect.kinds(), "none")


# The vocabularies are imported when a help text is printed: other packages may add to them.
PlannerName = Annotated[str, tyro.conf.arg(help="Which skill is next in an episode.", help_behavior_hint=_planners)]
Place = Annotated[str, tyro.conf.arg(help_behavior_hint=_release_strategies)]
Fallback = Annotated[
    FallbackName,
    tyro.conf.arg(
        help="With --planner closed, who acts once a skill has failed three times. oracle: the scripted oracle. none: "
        "the policy again; after five attempts the target is given up and the plan goes on."
    ),
]
Disturb = Annotated[
    tuple[str, ...],
    tyro.conf.arg(help="Disturbances that act together, such as bump:0.1.", help_behavior_hint=_disturbances),
]
World = Annotated[WorldOptions, tyro.conf.OmitArgPrefixes]


@dataclass(frozen=True)
class RunOptions:
    """Who acts, where, and how often."""

    place: Place = "rl"
    """One release strategy: what happens when the policy commands the hand to open. Or a policy that was trained
    otherwise and opens it at once: delta-N (the object must stay for N steps), gentle (release at rest), hand
    (Cartesian actions), linear and geometric (time-to-go), linear-N and geometric-N (always N steps to go). gentle is
    shipped for set_table."""
    split: Split = "val"
    train_seeds: int = 1
    """Number of training seeds, from seed 0; each has its own policies. Three are shipped."""
    eval_seeds: int = 1
    """Number of evaluation seeds; each draws the robot's start poses."""
    policies: Policies = ()
    planner: PlannerName = "open"
    fallback: Fallback = "oracle"
    world: World = WorldOptions()  # noqa: RUF009 - frozen
    """The variant of the physics."""
    disturb: Disturb = ()

    def protocol(self, task: str, episodes: int) -> EvaluationProtocol:
        """Return the protocol of a task."""
        from perdure.home.evaluate.disturbances import parse_home_disturbances
        from perdure.home.evaluate.execute import ExecutorOptions
        from perdure.home.evaluate.protocol import EvaluationProtocol

        given = given_physics(self.world)
        scene = SceneOptions(**given)
        disturb = parse_home_disturbances(self.disturb)
        protocol = EvaluationProtocol(
            task,
            self.place,
            self.split,
            episodes,
            self.train_seeds,
            self.eval_seeds,
            policies=parse_policies(self.policies),
            options=ExecutorOptions(scene=scene, planner=self.planner, fallback=self.fallback, disturb=disturb),
        )
        return protocol.as_trained(given)


def given_physics(world: WorldOptions) -> dict[str, Any]:
    """Return the variant of the physics as options of a scene, without those that are left to the policies."""
    return {name: value for name, value in vars(world).items() if value is not None}


def parse_policies(written: tuple[str, ...]) -> dict[str, str]:
    """Return SKILL=FILE and SKILL=oracle as a mapping; "oracle" alone means the oracle in every skill.

    Raises:
        PerdureError: For anything else, or a skill that is named twice.
    """
    from perdure.home.skills import SKILLS

    if written == ("oracle",):
        return dict.fromkeys(SKILLS, "oracle")
    chosen = dict(each.partition("=")[::2] for each in written)
    if len(chosen) < len(written):
        raise PerdureError(f"policies must name each skill once, not {' '.join(written)}")
    if not all(chosen.values()):
        raise PerdureError(f"policies are written SKILL=FILE or SKILL=oracle, not {' '.join(written)}")
    return chosen
