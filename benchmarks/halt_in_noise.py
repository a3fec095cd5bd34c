"""What training sees of standing still: apples that stay when a robot halts and lets go under exploration noise.

python benchmarks/halt_in_noise.py [episodes]

SetTable's apples in the world `drag`, val starts without clutter. Place's shipped policy (training seed 0) carries the
apple until it tells the hand to open while the apple is in its goal region. Then it either goes on as it would, or the
robot halts: a mean action of 0, for half a second before the hand opens and ever after. The noise of the row is added
to every action of base and arm (not of the hand) from the start. It is normal, as in training, and nobody corrects
where it moves a robot that halts. Counted are apples that were within their goal for 200 steps on end after that, and
those that were first let go outside of it.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from perdure.home.evaluate.protocol.policies import shipped_policy
from perdure.home.sim.world import ARM, GRASP, GRIP, RELEASE
from perdure.home.skills import Place
from perdure.home.skills.gym import HomeSkillVectorEnv
from perdure.home.skills.place import GOAL_RADIUS
from perdure.policy import Policy, load_policy

TASK, APPLE = "set_table", 1
HALT = 15
"""Control steps that the robot stands still before the hand opens: half a second."""
DELTA = 200
LANES = 20
BASE = slice(0, ARM.start)
NOISE = ("none", "exp(-4)", "exp(-3)", "exp(-2)", "exp(-1)")
PARTS = {"base and arm": (1.0, 1.0), "base": (1.0, 0.0), "arm": (0.0, 1.0)}
"""By how much the noise of base and arm is multiplied."""
CASES = (
    *((False, name, "base and arm") for name in ("none", "exp(-2)", "exp(-1)")),
    *((True, name, "base and arm") for name in NOISE),
    *((True, "exp(-2)", part) for part in ("base", "arm")),
)


def outcomes(policy: Policy, episodes: int, halts: bool, noise: str, parts: str) -> Counter[str]:
    """What became of the apples.

    Args:
        policy: Carries them.
        episodes: How many, rounded up to a multiple of LANES.
        halts: Whether the robot halts; else the policy goes on.
        noise: Standard deviation, one of NOISE; 1 is full speed.
        parts: What is noisy, one of PARTS.

    Returns:
        Counts of "stayed", "let go outside" and "left its goal"; starts in which no release was asked for are none.
    """
    size = 0.0 if noise == "none" else float(np.exp(float(noise[4:-1])))
    base, arm = (size * share for share in PARTS[parts])
    env = HomeSkillVectorEnv(
        LANES,
        max_episode_steps=Place(delta=DELTA).limit,
        skill="place",
        task=TASK,
        targets=APPLE,
        split="val",
        rolling="drag",
        delta=DELTA,
    )
    rng = np.random.default_rng(0)
    left, since, stayed = np.full(LANES, -(-episodes // LANES)), np.full(LANES, -1), np.zeros(LANES, dtype=bool)
    found: Counter[str] = Counter()
    observations, _ = env.reset(seed=1000)
    while left.any():
        actions = _told(policy, observations, env)
        asks = (actions[:, GRIP] < 0.0) & env.state.holds_target & (env.state.object_to_goal <= GOAL_RADIUS)
        since = np.where((since >= 0) | asks, since + 1, -1)
        asked: NDArray[np.bool_] = since >= 0
        if halts:
            actions[asked] = 0.0
            actions[asked, GRIP] = np.where(since[asked] < HALT, GRASP, RELEASE)
        drawn = rng.standard_normal(actions.shape)
        actions[:, BASE] += base * drawn[:, BASE]
        actions[:, ARM] += arm * drawn[:, ARM]
        observations, _, terminated, truncated, info = env.step(actions)
        stayed |= env.progress.lasting >= DELTA
        over = terminated | truncated
        for lane in np.flatnonzero(over & (left > 0)):
            left[lane] -= 1
            outside = info["failure"][lane] == "wrong drop"
            if asked[lane]:
                found["stayed" if stayed[lane] else "let go outside" if outside else "left its goal"] += 1
        if over.any():
            observations, _ = env.reset(options={"reset_mask": over})
            since[over], stayed[over] = -1, False
    env.close()
    return found


def _told(policy: Policy, observations: NDArray[np.float64], env: HomeSkillVectorEnv) -> NDArray[np.float64]:
    """Mean actions; a policy of Delta = 1 does not know for how long the object has stayed."""
    known = observations[:, : policy.task.observation_size]
    return np.array(policy.act(known, env.progress.elapsed), dtype=np.float64)


def main(episodes: int) -> None:
    """Prints the table."""
    path = shipped_policy(TASK, "place", 0)
    assert path is not None
    policy = load_policy(path)
    print("| who | noise | apples that stayed | let go outside their goal |\n|---|---|---|---|")
    for halts, noise, parts in CASES:
        found = outcomes(policy, episodes, halts, noise, parts)
        who = "halts, then lets go" if halts else "the policy itself"
        where = "" if parts == "base and arm" else f", {parts} only"
        share = 100 * found["stayed"] / found.total()
        cells = who, noise + where, f"{found['stayed']} of {found.total()} ({share:.0f} %)", found["let go outside"]
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
