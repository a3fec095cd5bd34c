"""Claims about the pilots: size of the embedding, FiLM, other tasks.

The pilots were planned after the other rows. Registered on 2026-11-25, before any policy of these rows was trained.
"""

from __future__ import annotations

from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claims import CHOSEN, PPO

_PILOTED = ("HalfCheetah-v3", "Hopper-v3@cleanrl", "Walker2d-v3@cleanrl")
FILM = Condition("geometric-film", "chosen")

PILOT_CLAIMS: tuple[Claim, ...] = (
    Claim(
        "five-numbers-are-enough",
        "appendix A.2",
        "On tasks for which the thesis takes an embedding of ten numbers, five give the same return.",
        tasks=("HalfCheetah-v3", "Walker2d-v3@cleanrl"),
        left=Condition("geometric-5", "chosen"),
        right=CHOSEN,
        direction="same",
        margin=0.1,
    ),
    Claim(
        "ten-numbers-do-not-help-hopper",
        "appendix A.2",
        "On Hopper, for which the thesis takes five numbers, ten give the same return.",
        tasks=("Hopper-v3@cleanrl",),
        left=Condition("geometric-10", "chosen"),
        right=CHOSEN,
        direction="same",
        margin=0.1,
    ),
    Claim(
        "film-earns-more-than-concatenation",
        "section 3.5.1, future work",
        "A time-to-go that scales and shifts the hidden layers (FiLM) earns more than one appended to the observation.",
        tasks=_PILOTED,
        left=FILM,
        right=CHOSEN,
        direction="greater",
    ),
    Claim(
        "film-makes-actions-depend-on-the-time-to-go",
        "section 3.5.1, future work",
        "With FiLM the action depends more on the time-to-go than with concatenation.",
        tasks=_PILOTED,
        left=FILM,
        right=CHOSEN,
        direction="greater",
        measure="action dependence",
    ),
    Claim(
        "the-method-matches-ppo-on-other-tasks",
        "section 3.5.2, future work",
        "On a dm_control task and on a hand that reaches for goals the method matches or outperforms discounted PPO.",
        tasks=("WalkerWalk-v1@cleanrl", "HandReachDense-v3@cleanrl"),
        left=CHOSEN,
        right=PPO,
        direction="not less",
        margin=0.05,
    ),
)
