"""Plant nine common mistakes in a contract that works, and print what finds them, as CSV.

    python examples/robots/faults.py examples/robots/go2.yaml policy.onnx

For each mistake: what `perdure robot check` answers, what a trace of the contract that works shows, and a minute of
walking from two start states.
"""

import csv
import sys
from typing import Any

import numpy as np
from msgspec.structs import replace

from perdure.policy.onnx import OnnxModel
from perdure.robots import Contract, read_contract
from perdure.robots.check import check
from perdure.robots.contract import VALUES
from perdure.robots.trace import compare, make_trace, record
from perdure.robots.world import VelocityCommandEnv, action_range

SECONDS, STARTS, HISTORY, DELAY = 60.0, 2, 3, 2
CHECKED = "robot check"
STEPS = 200
"""Of a trace."""


def exchanged(items: Any, one: int, other: int) -> tuple[Any, ...]:
    """Return items with two of them exchanged."""
    moved = list(items)
    moved[one], moved[other] = moved[other], moved[one]
    return tuple(moved)


def faults(contract: Contract) -> dict[str, Contract]:
    """Return contracts with one mistake each, by its name; the first one has none."""
    names, terms = contract.joints, [term.name for term in contract.terms]
    pair = 0, next(k for k in range(1, len(names)) if names[k][-9:] == names[0][-9:])
    values = {name: exchanged(found, *pair) for name in VALUES if (found := getattr(contract, name))}
    knees = [0.3 * any(word in name for word in ("calf", "knee")) for name in names]
    swapped = exchanged(contract.terms, terms.index("base_ang_vel"), terms.index("projected_gravity"))
    plain = tuple(replace(term, scale=1.0) if term.name == "joint_vel" else term for term in contract.terms)
    world = tuple(replace(t, name="base_ang_vel_w") if t.name == "base_ang_vel" else t for t in contract.terms)
    return {
        "none": contract,
        f"{names[0]} and {names[pair[1]]} exchanged": replace(contract, joints=exchanged(names, *pair), **values),
        "gains 30 % low": replace(contract, **{n: tuple(0.7 * contract.values(n)) for n in ("stiffness", "damping")}),
        "base_ang_vel and projected_gravity exchanged": replace(contract, observations=swapped),
        "scale of joint_vel missing": replace(contract, observations=plain),
        f"delay of {DELAY} steps": replace(contract, action_delay=DELAY),
        "default pose of the knees 0.3 rad off": replace(
            contract, default_pose=tuple(contract.values("default_pose") + knees)
        ),
        "decimation doubled": replace(contract, decimation=2 * (contract.decimation or 1)),
        "history reversed": replace(with_history(contract), history_order="newest first"),
        "base_ang_vel in the frame of the world": replace(contract, observations=world),
    }


def with_history(contract: Contract) -> Contract:
    """Return a contract whose terms have a history."""
    return replace(contract, observations=tuple(replace(term, history=HISTORY) for term in contract.terms))


def newest(contract: Contract, policy: Any) -> Any:
    """Return a policy for observations with a history, oldest first, of which it uses the newest step."""
    sizes = [contract.size(term) for term in contract.terms]
    ends = np.cumsum([size * HISTORY for size in sizes])
    chosen = np.concatenate([np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)])
    return lambda observations: policy(observations[:, chosen])


def minute(contract: Contract, policy: Any) -> list[Any]:
    """Return falls, mean reward of a step, heading error [degrees/min] and energy [J/m] of the walks."""
    env = VelocityCommandEnv(contract)
    (low, high), rows, fallen = action_range(env.model, contract), list[list[float]](), 0
    for seed in range(STARTS):
        observation, _ = env.reset(seed=seed)
        earned, steps = 0.0, round(SECONDS / env.dt)
        for _ in range(steps):
            observation, reward, fell, _, info = env.step(policy(observation[None])[0].clip(low, high))
            earned += reward
            if fell:
                fallen += 1
                break
        rows.append([earned / steps, info["heading_error"], info["energy_per_meter"] or np.nan])
    return [f"{fallen} of {STARTS}", *(f"{each:.3g}" for each in np.mean(rows, axis=0))]


def traced(contract: Contract, right: Contract, policy: Any) -> str:
    """Return what a trace of the right contract shows of another one: the last line, which is nearest to the cause."""
    lines, same = compare(contract, policy, make_trace(record(right, policy, STEPS), right))
    return "" if same else lines[-1]


if __name__ == "__main__":
    walking, model = read_contract(sys.argv[1]), OnnxModel.load(sys.argv[2])
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["mistake", CHECKED, "best change", "trace", "falls", "score", "degrees a minute", "J/m"])
    for name, contract in faults(walking).items():
        act, right = model, walking
        if "history" in name:
            act, right = newest(walking, model), with_history(walking)
        lines, passed = check(contract, act)
        best = next((line for line in lines if line.startswith("walks better")), "")
        found = "passes" if passed else "finds it"
        table.writerow([name, found, best, traced(contract, right, act), *minute(contract, act)])
        sys.stdout.flush()
