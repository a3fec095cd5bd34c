"""Ask MuJoCo whether a simulation diverged.

MuJoCo answers a position, velocity or acceleration that is not a number, or is beyond 1e10, by resetting the data to
its start; the counters of these warnings survive that reset (``mj_checkPos``, ``mj_checkVel``, ``mj_checkAcc``).
"""

from __future__ import annotations

import sys
from typing import Any

BAD_STATE_WARNINGS = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")
"""Names; the numbers differ between versions of MuJoCo."""


def divergence_count(env: Any) -> int:
    """Return the number of MuJoCo's automatic resets after divergence since the last reset of the environment.

    Args:
        env: A Gymnasium environment; one that is not on MuJoCo's own bindings counts 0.
    """
    mujoco = sys.modules.get("mujoco")  # an environment on MuJoCo has imported it
    warnings = getattr(getattr(env.unwrapped, "data", None), "warning", None)
    if mujoco is None or warnings is None:
        return 0
    return sum(int(warnings[int(getattr(mujoco.mjtWarning, name))].number) for name in BAD_STATE_WARNINGS)
