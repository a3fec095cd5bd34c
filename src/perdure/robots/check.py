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
SECONDS = 5.0
"""Of each walk."""
FIRST_SECONDS = 2.0
"""Of a walk forward that a change must do better first."""
BETTER = 0.03  # least difference in score that counts
PROMISING = 0.01  # least difference after the first seconds
FACTORS = (0.5, 0.7, 1.4, 2.0)
SCALES = (0.05, 0.25, 1.0, 2.0, 4.0)
DELAYS = (0, 1, 2)
FRAMES = (
    ("base_lin_vel", "base_lin_vel_w", "imu_lin_vel"),
    ("base_ang_vel", "base_ang_vel_w", "imu_ang_vel"),
    ("projected_gravity", "imu_projected_gravity"),
)
"""Terms of one quantity in several frames."""
OFFSET = 0.3  # of the default pose [rad]
UNSTABLE = 2.0  # damping x time step / inertia, integrated explicitly
SIDES = frozenset(["l", "r", "fl", "fr", "rl", "rr", "lf", "rf", "lh", "rh", "hl", "hr", "left", "right", "joint"])
"""Words of a joint's name that do not say which kind of joint it is."""


def check(contract: Contract, policy: Act | None) -> tuple[list[str], bool]:
    """Check a contract against its model and, if there is one, against its policy.

    Returns:
        (what was found, a line each; whether the robot walks without a fall, clearly better than without actions, and
        no change walks clearly better).
    """
    env = VelocityCommandEnv(contract)
    size = contract.observation_size
    joints = len(contract.joints)
    steps = f"{contract.decimation} x {1e3 * env.model.opt.timestep:g} ms"
    lines = [f"{joints} joints, {size} observations, a control step of {1e3 * env.dt:g} ms ({steps})"]
    lines += [f"warning: {each}" for each in _unusual(env)]
    if policy is None:
        return lines, True
    try:
        made = act_on(policy, np.zeros(size), None)[0].size
    except PerdureError as error:
        parts = ", ".join(f"{term.name} {contract.size(term)} x {term.history}" for term in contract.terms)
        return [*lines, f"{error}; the contract has {parts}"], False
    if made != joints:
        return [*lines, f"the policy acts on {made} joints, the contract names {joints}"], False
    scores, falls = _walks(contract, policy)
    score = float(np.mean(scores))
    standing = float(np.mean(_walks(contract, lambda _: np.zeros((1, joints)))[0]))
    walks = score > standing + BETTER
    shown = ", ".join(f"{name} {each:.2f}" for name, each in zip(COMMANDS, scores, strict=True))
    against = f"without actions {standing:.2f}"
    if not walks:
        against += " (no better)"
    lines.append(f"score {score:.2f} ({shown}); {against}; falls in {falls} of 3 walks")
    better = _better(contract, policy, score)
    lines += [f"walks better ({each:.2f}): {change}" for each, change in better[:5]]
    return lines, walks and not falls and not better


def _better(contract: Contract, policy: Act, score: float) -> list[tuple[float, str]]:
    """Return scores of the changes that walk clearly better than with this score, the best first."""
    first, _ = _walk(contract, policy, "forward", FIRST_SECONDS)
    better = []
    for change, other in changes(contract):
        promising, _ = _walk(other, policy, "forward", FIRST_SECONDS)
        if promising <= first + PROMISING:
            continue
        scores, _ = _walks(other, policy)
        changed = float(np.mean(scores))
        if changed > score + BETTER:
            better.append((changed, change))
    return sorted(better, reverse=True)


def _walks(contract: Contract, policy: Act) -> tuple[list[float], int]:
    """Return the score of a walk under each of `COMMANDS`, and how many of them fell."""
    walks = [_walk(contract, policy, name, SECONDS) for name in COMMANDS]
    return [score for score, _ in walks], sum(fell for _, fell in walks)


def _walk(contract: Contract, policy: Act, name: str, seconds: float) -> tuple[float, bool]:
    """Return the mean reward of a short walk, in which steps after a fall earn nothing, and whether it fell."""
    env = VelocityCommandEnv(replace(contract, command=COMMANDS[name], script=(), random=None))
    low, high = action_range(env.model, contract)
    steps = round(seconds / env.dt)
    earned = 0.0
    state = None
    observation, _ = env.reset(seed=0)
    for _ in range(steps):
        action, state = act_on(policy, observation, state)
        observation, reward, fell, _, _ = env.step(action.clip(low, high))
        earned += reward
        if fell:
            return earned / steps, True
    return earned / steps, False


def act_on(policy: Act, observation: FloatArray, state: Any) -> tuple[FloatArray, Any]:
    """Return an action, shape (joints,), and the next state of a policy with a memory."""
    arguments = [observation[None]]
    if state is not None:
        arguments.append(state)
    found = policy(*arguments)
    after = None
    if isinstance(found, tuple):
        found, after = found
    return np.asarray(found, np.float64)[0], after


def _unusual(env: VelocityCommandEnv) -> Iterator[str]:
    """Yield what is unusual about a contract and its model."""
    model = env.model
    names = env.contract.joints
    joints = model.actuator_trnid[: len(names), 0]
    numbers = model.jnt_dofadr[joints]

    driven = [model.joint(number).name for number in model.actuator_trnid[:, 0]]
    loose = [name for name in (model.joint(k).name for k in range(1, model.njnt)) if name not in driven]
    if loose:
        yield f"no controller holds these joints of the model: {', '.join(loose[:8])}"
    pose = env.contract.values("default_pose")
    low, high = model.jnt_range[joints].T
    for k in np.flatnonzero(model.jnt_limited[joints].astype(bool) & ((pose < low) | (pose > high))):
        yield f"default pose of {names[k]}, {pose[k]:g}, is outside {low[k]:g} to {high[k]:g}"
    free = [name for name, limit in zip(names, model.actuator_forcelimited, strict=False) if not limit]
    if free:
        yield f"no torque limit: {', '.join(free[:8])} (effort_limit)"
    bare = [name for name, armature in zip(names, model.dof_armature[numbers], strict=True) if not armature]
    if bare:
        yield f"no rotor inertia: {', '.join(bare[:8])} (armature)"
    yield from _unusual_damping(env, numbers)


def _unusual_damping(env: VelocityCommandEnv, numbers: Any) -> Iterator[str]:
    """Yield the first joint whose damping makes the simulation unstable, and the first that is damped twice.

    Args:
        env: The robot.
        numbers: Degree of freedom of each of the contract's joints, shape (joints,).
    """
    model = env.model
    names = env.contract.joints
    damping = env.contract.values("damping")
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
    yield from changed_observations(contract)
    yield from _changed_control(contract)


def changed_observations(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield those of them that change what the policy observes."""
    yield from _changed_terms(contract)
    yield from _changed_frames(contract)
    yield from _changed_history(contract)
    yield from _changed_joints(contract)


def _changed_terms(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield other orders and scales of the observation terms."""
    terms = contract.terms
    for one, other in combinations(range(len(terms)), 2):
        order = _exchanged(terms, one, other)
        yield f"terms {terms[one].name} and {terms[other].name} exchanged", replace(contract, observations=tuple(order))
    for (k, term), scale in product(enumerate(terms), SCALES):
        if term.scale != scale:
            scaled = (*terms[:k], replace(term, scale=scale), *terms[k + 1 :])
            yield f"scale of {term.name} {scale:g}, not {term.scale}", replace(contract, observations=scaled)


def _changed_frames(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield terms of the same quantity in another frame."""
    terms = contract.terms
    for k, term in enumerate(terms):
        for frames in FRAMES:
            others = [name for name in frames if name != term.name and (contract.imu or not name.startswith("imu"))]
            if term.name not in frames or term.value is not None:
                others = []
            for name in others:
                moved = (*terms[:k], replace(term, name=name), *terms[k + 1 :])
                yield f"{name}, not {term.name}", replace(contract, observations=moved)


def _changed_control(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield other gains, action scales, decimations and delays."""
    for factor, names in product(FACTORS, (("stiffness", "damping"), ("stiffness",), ("damping",), ("action_scale",))):
        values = {name: tuple(factor * contract.values(name)) for name in names}
        yield f"{' and '.join(names)} x {factor:g}", replace(contract, **values)
    steps = contract.decimation or 1
    for decimation in {max(1, steps // 2), 2 * steps} - {steps}:
        yield f"decimation {decimation}", replace(contract, decimation=decimation)
    for delay in DELAYS:
        if delay != contract.action_delay:
            yield f"action_delay {delay}", replace(contract, action_delay=delay)


def _changed_history(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield other layouts of the history, if a term has one."""
    histories = {term.history for term in contract.terms}
    if histories == {1}:
        return
    order = _other(contract.history_order, "oldest first", "newest first")
    yield f"history_order {order}", replace(contract, history_order=order)
    if len(histories) == 1:  # of different ones there are no whole steps
        layout = _other(contract.history_layout, "by term", "by step")
        yield f"history_layout {layout}", replace(contract, history_layout=layout)


def _other(value: str, first: str, second: str) -> Any:
    """Return which of two values it is not."""
    if value == first:
        return second
    return first


def _changed_joints(contract: Contract) -> Iterator[tuple[str, Contract]]:
    """Yield other default poses of a kind of joint, and other orders of the joints."""
    joints = contract.joints
    kinds = [_kind(joint) for joint in joints]
    for kind, offset in product(dict.fromkeys(kinds), (-OFFSET, OFFSET)):
        pose = contract.values("default_pose") + offset * (np.array(kinds) == kind)
        yield f"default pose of {kind} {offset:+g}", replace(contract, default_pose=tuple(pose))
    for name, chosen in _orders(joints, kinds).items():
        moved = {"joints": tuple(joints[k] for k in chosen)}
        for field in VALUES:
            values = getattr(contract, field)
            if values is not None:
                moved[field] = tuple(values[k] for k in chosen)
        yield name, replace(contract, **moved)


def _kind(joint: str) -> str:
    """Return a joint's name without its side and number: "FL_hip_joint" -> "hip"."""
    words = [word for word in joint.split("_") if word.lower() not in SIDES and not word.isdigit()]
    return "_".join(words)


def _orders(joints: Sequence[str], kinds: Sequence[str]) -> dict[str, list[int]]:
    """Return other orders of the joints, by what differs; their values go with them."""
    numbers = list(range(len(joints)))
    found: dict[str, list[int]] = {}
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
    """Return a list in which two items, given by their places, have changed places."""
    moved = list(items)
    moved[one], moved[other] = moved[other], moved[one]
    return moved
