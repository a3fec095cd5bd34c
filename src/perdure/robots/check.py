"""`perdure robot check`: whether contract, model and policy fit, and which change of the contract walks better.

A wrong joint order, gain, scale, order of terms or decimation fits all sizes. So the policy walks for some seconds, and
common mistakes are undone, one at a time: a contract is suspicious if another one clearly walks better. A policy may be
robust against a mistake, and two at once may hide each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np
from msgspec.structs import replace

from perdure.errors import PerdureError
from perdure.robots.contract import VALUES, Contract, FloatArray
from perdure.robots.world import VelocityCommandEnv, action_range

Act = Callable[..., Any]
"""Observations, shape (1, observation_size), to actions, shape (1, joints); with a memory as in `FunctionPolicy`."""
COMMANDS = {"forward": (0.5, 0.0, 0.0), "sideways": (0.0, 0.3, 0.0), "turning": (0.0, 0.0, 0.5)}
SECONDS, FIRST_SECONDS = 5.0, 2.0
"""Of each walk; a change must first walk better forward for the shorter time."""
BETTER, PROMISING = 0.03, 0.01  # least differences in score that count, after all walks and after the first seconds
FACTORS = (0.5, 0.7, 1.4, 2.0)
SCALES = (0.05, 0.25, 1.0, 2.0, 4.0)
OFFSET = 0.3  # of the default pose [rad]
UNSTABLE = 2.0  # damping x time step / inertia, integrated explicitly
SIDES = {*["l", "r", "fl", "fr", "rl", "rr", "lf", "rf", "lh", "rh", "hl", "hr", "left", "right", "joint"]}
"""Words of a joint's name that do not say which kind of joint it is."""


def check(contract: Contract, policy: Act | None) -> tuple[list[str], bool]:
    """Check a contract against its model and, if there is one, against its policy.

    Returns:
        (what was found, a line each; whether the robot walks without a fall, clearly better than without actions, and
        no change walks clearly better).
    """
    env, size, joints = VelocityCommandEnv(contract), contract.observation_size, len(contract.joints)
    steps = f"{contract.decimation} x {1e3 * env.model.opt.timestep:g} ms"
    lines = [f"{joints} joints, {size} observations, a control step of {1e3 * env.dt:g} ms ({steps})"]
    lines += [f"warning: {each}" for each in _unusual(env)]
    if policy is None:
        return lines, True
    try:
        made = _act(policy, np.zeros(size), None)[0].size
    except PerdureError as error:
        parts = ", ".join(f"{term.name} {contract.size(term)} x {term.history}" for term in contract.terms)
        return [*lines, f"{error}; the contract has {parts}"], False
    if made != joints:
        return [*lines, f"the policy acts on {made} joints, the contract names {joints}"], False
    scores, falls = _walks(contract, policy)
    standing = float(np.mean(_walks(contract, lambda _: np.zeros((1, joints)))[0]))
    score, walks = float(np.mean(scores)), zip(COMMANDS, scores, strict=True)
    shown = ", ".join(f"{name} {each:.2f}" for name, each in walks)
    verdict = "" if score > standing + BETTER else " (no better)"
    lines.append(f"score {score:.2f} ({shown}); without actions {standing:.2f}{verdict}; falls in {falls} of 3 walks")
    first, better = _walk(contract, policy, "forward", FIRST_SECONDS)[0], list[tuple[float, str]]()
    for change, other in changes(contract):
        if _walk(other, policy, "forward", FIRST_SECONDS)[0] > first + PROMISING:
            better.append((float(np.mean(_walks(other, policy)[0])), change))
    better = sorted((each for each in better if each[0] > score + BETTER), reverse=True)
    lines += [f"walks better ({each:.2f}): {change}" for each, change in better[:5]]
    return lines, not (falls or better or verdict)


def _walks(contract: Contract, policy: Act) -> tuple[list[float], int]:
    """Return the score of a walk under each of `COMMANDS`, and how many of them fell."""
    scores, falls = zip(*(_walk(contract, policy, name, SECONDS) for name in COMMANDS), strict=True)
    return list(scores), sum(falls)


def _walk(contract: Contract, policy: Act, name: str, seconds: float) -> tuple[float, bool]:
    """Return the mean reward of a short walk, in which steps after a fall earn nothing, and whether it fell."""
    env = VelocityCommandEnv(replace(contract, command=COMMANDS[name], script=(), random=None))
    (observation, _), state = env.reset(seed=0), None
    earned, steps, reach = 0.0, round(seconds / env.dt), action_range(env.model, contract)
    for _ in range(steps):
        action, state = _act(policy, observation, state)
        observation, reward, fell, _, _ = env.step(action.clip(*reach))
        earned += reward
        if fell:
            return earned / steps, True
    return earned / steps, False


def _act(policy: Act, observation: FloatArray, state: Any) -> tuple[FloatArray, Any]:
    """Return an action, shape (joints,), and the next state of a policy with a memory."""
    found = policy(observation[None]) if state is None else policy(observation[None], state)
    actions, state = found if isinstance(found, tuple) else (found, None)
    return np.asarray(actions, np.float64)[0], state


def _unusual(env: VelocityCommandEnv) -> Iterator[str]:
    """Yield what is unusual about a contract and its model."""
    model, contract, names = env.model, env.contract, env.contract.joints
    pose, damping, joints = contract.values("default_pose"), contract.values("damping"), model.actuator_trnid[:, 0]
    low, high = model.jnt_range[joints].T
    if loose := [model.joint(k).name for k in range(1, model.njnt) if model.joint(k).name not in names]:
        yield f"no controller holds these joints of the model: {', '.join(loose[:8])}"
    for k in np.flatnonzero(model.jnt_limited[joints].astype(bool) & ((pose < low) | (pose > high))):
        yield f"default pose of {names[k]}, {pose[k]:g}, is outside {low[k]:g} to {high[k]:g}"
    if free := [name for name, limit in zip(names, model.actuator_forcelimited, strict=True) if not limit]:
        yield f"no torque limit: {', '.join(free[:8])} (effort_limit)"
    numbers = model.jnt_dofadr[joints]
    if bare := [name for name, armature in zip(names, model.dof_armature[numbers], strict=True) if not armature]:
        yield f"no rotor inertia: {', '.join(bare[:8])} (armature)"
    slowing = damping * model.opt.timestep * model.dof_invweight0[numbers]  # share of its speed that a step takes away
    explicit = model.opt.integrator in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4)
    for k in np.flatnonzero(explicit & (slowing > UNSTABLE))[:1]:
        small = f"damping {damping[k]:g} is unstable in steps of {1e3 * model.opt.timestep:g} ms"
        yield f"{names[k]}: {small} with so little inertia (armature; integrator of the model)"
    passive = model.dof_damping[numbers]
    for k in np.flatnonzero(passive > 0.5 * damping)[:1]:
        beside = f"the model damps {names[k]} by {passive[k]:g} beside the controller's {damping[k]:g}"
        yield f"{beside}: right only if training did too (joint_damping)"


def changes(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield contracts that differ in one thing that is often wrong, and what differs."""
    terms, joints = contract.terms, contract.joints
    for one, other in combinations(range(len(terms)), 2):
        order = _exchanged(terms, one, other)
        yield f"terms {terms[one].name} and {terms[other].name} exchanged", replace(contract, observations=tuple(order))
    for (k, term), scale in product(enumerate(terms), SCALES):
        if term.scale != scale:
            scaled = (*terms[:k], replace(term, scale=scale), *terms[k + 1 :])
            yield f"scale of {term.name} {scale:g}, not {term.scale}", replace(contract, observations=scaled)
    for factor, names in product(FACTORS, (("stiffness", "damping"), ("stiffness",), ("damping",), ("action_scale",))):
        values = {name: tuple(factor * contract.values(name)) for name in names}
        yield f"{' and '.join(names)} x {factor:g}", replace(contract, **values)
    steps = contract.decimation or 1
    for decimation in {max(1, steps // 2), 2 * steps} - {steps}:
        yield f"decimation {decimation}", replace(contract, decimation=decimation)
    if (histories := {term.history for term in terms}) != {1}:
        turned: Any = "newest first" if contract.history_order == "oldest first" else "oldest first"
        yield f"history_order {turned}", replace(contract, history_order=turned)
        layout: Any = "by step" if contract.history_layout == "by term" else "by term"
        yield from [(f"history_layout {layout}", replace(contract, history_layout=layout))] * (len(histories) == 1)
    kinds = ["_".join(w for w in joint.split("_") if w.lower() not in SIDES and not w.isdigit()) for joint in joints]
    for kind, offset in product(dict.fromkeys(kinds), (-OFFSET, OFFSET)):
        pose = contract.values("default_pose") + offset * (np.array(kinds) == kind)
        yield f"default pose of {kind} {offset:+g}", replace(contract, default_pose=tuple(pose))
    for name, chosen in _orders(joints, kinds).items():
        moved = {field: tuple(found[k] for k in chosen) for field in VALUES if (found := getattr(contract, field))}
        yield name, replace(contract, joints=tuple(joints[k] for k in chosen), **moved)


def _orders(joints: Sequence[str], kinds: Sequence[str]) -> dict[str, list[int]]:
    """Return other orders of the joints, by what differs; their values go with them."""
    numbers, found = list(range(len(joints))), dict[str, list[int]]()
    legs = [joint.replace(kind, "*") for joint, kind in zip(joints, kinds, strict=True)]
    for what, of in (("kind", kinds), ("leg", legs)):
        found[f"joints by {what}"] = sorted(numbers, key=lambda k, of=of: of.index(of[k]))  # type: ignore[misc]
    places = {both: k for k, both in enumerate(zip(legs, kinds, strict=True))}
    for one, other in combinations(dict.fromkeys(legs), 2):
        turn = {one: other, other: one}
        found[f"legs {one} and {other} exchanged"] = [
            places.get((turn.get(leg, leg), kind), k) for (leg, kind), k in places.items()
        ]
    for first, second in combinations(numbers, 2):
        found[f"joints {joints[first]} and {joints[second]} exchanged"] = _exchanged(numbers, first, second)
    return {name: chosen for name, chosen in found.items() if sorted(chosen) == numbers != chosen}


def _exchanged(items: Sequence[Any], one: int, other: int) -> list[Any]:
    moved = list(items)
    moved[one], moved[other] = moved[other], moved[one]
    return moved
