"""Golden traces: steps that were recorded in training or on the robot, replayed through policy and contract.

`perdure robot check robot.yaml --policy policy.onnx --trace recorded.npz` compares three things with what was recorded:
the policy's actions, each observation term computed from the sensors, and the joint targets computed from the actions.
Nothing is simulated, so this finds mistakes under which a robust policy walks all the same.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from perdure.errors import PerdureError, did_you_mean
from perdure.robots.check import Act, act_on, changed_observations
from perdure.robots.contract import Contract, FloatArray
from perdure.robots.terms import RobotState
from perdure.robots.world import Observer, VelocityCommandEnv
from perdure.runs import read_bounded

WIDTHS: dict[str, int | None] = {
    "observation": None,
    "action": None,
    "quaternion": 4,
    "angular_velocity": 3,
    "linear_velocity": 3,
    "joint_pos": None,
    "joint_vel": None,
    "command": 3,
    "torques": None,
    "targets": None,
}
"""Arrays of a trace with a row for each step, and their columns; None: as many as the policy or the robot has."""
OF_JOINTS = ("joint_pos", "joint_vel", "torques", "targets")
MOST_BYTES = 500_000_000
TOLERANCE = 1e-3
"""Least difference that counts, of a value of 1; in proportion for larger ones."""
LONGEST_DELAY = 10
"""Control steps."""
CLEARLY = 0.5
"""Share of the squared error that another delay must leave."""
STRONGER = 1.15
"""Factor by which gains must miss the recorded torques."""
SATURATED = 0.98
"""Share of a torque limit beyond which a torque says nothing of the gains."""
PACE = 1.4
"""Factor by which the pace of the joints must miss the control step."""
FIT_STEPS = 30
"""Steps on which other contracts are tried, after the longest history."""
FITS = 0.05
"""Share of the differences that a change which explains the trace leaves at most."""


@dataclass(frozen=True)
class Trace:
    """A recorded walk of at least two steps, from one reset."""

    observation: FloatArray
    """What the policy observed, shape (steps, observation size)."""
    action: FloatArray
    """What it answered, before scale and clip and without exploration noise, shape (steps, joints)."""
    joints: tuple[str, ...]
    """Names of the columns of OF_JOINTS."""
    sensors: Mapping[str, FloatArray]
    """Arrays that were recorded beside them, by their names in WIDTHS: at the time of the observation the base's
    orientation (w, x, y, z) and its velocities in its own frame [rad/s, m/s], joint positions [rad] and velocities
    [rad/s], torques of the motors [N m] and the command that the policy was told; the joint targets that followed its
    action [rad]."""

    def of_joints(self, name: str, joints: tuple[str, ...]) -> FloatArray | None:
        """Return the columns of some joints of an array, nan where a joint was not recorded; None without the array."""
        array = self.sensors.get(name)
        if array is None:
            return None
        padded = np.column_stack([array, np.full(len(array), np.nan)])
        return padded[:, [self.joints.index(each) if each in self.joints else -1 for each in joints]]


def read_trace(path: Path, contract: Contract) -> Trace:
    """Return the trace in an .npz file.

    Args:
        path: The file: `observation`, `action`, and any other array of WIDTHS; `joints` has the names of the joints,
            those of the contract if left out.
        contract: Of the robot.

    Raises:
        PerdureError: If it is no such file, or an array is missing, unknown, of another shape or not finite.
    """
    try:
        with np.load(io.BytesIO(read_bounded(path, MOST_BYTES)), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, KeyError) as error:
        raise PerdureError(f"{path} is no .npz file of arrays: {' '.join(str(error).split())[:200]}") from None
    try:
        return make_trace(arrays, contract)
    except PerdureError as error:
        raise PerdureError(f"{path}: {error}") from None


def make_trace(arrays: Mapping[str, Any], contract: Contract) -> Trace:
    """Return the trace of some arrays; PerdureError as `read_trace`."""
    joints = tuple(str(each) for each in arrays.get("joints", contract.joints))
    found: dict[str, FloatArray] = {}
    for name, values in arrays.items():
        if name == "joints":
            continue
        if name not in WIDTHS:
            known = (*WIDTHS, "joints")
            hint = did_you_mean(name, known)
            raise PerdureError(f"there is no array {name[:80]!r} in a trace; there are {', '.join(known)}{hint}")
        width = len(joints) if name in OF_JOINTS else WIDTHS[name]
        found[name] = _checked(name, values, width)
    for name in ("observation", "action"):
        if name not in found:
            raise PerdureError(f"a trace needs the array {name}")
    steps = len(found["observation"])
    wrong = [f"{name} {len(values)}" for name, values in found.items() if len(values) != steps]
    if wrong or steps < 2:
        raise PerdureError(f"all arrays need as many rows, at least 2: observation has {steps}, {', '.join(wrong)}")
    if "quaternion" in found and not np.linalg.norm(found["quaternion"], axis=1).all():
        raise PerdureError("a quaternion of all zeros is no orientation")
    return Trace(found.pop("observation"), found.pop("action"), joints, found)


def _checked(name: str, values: Any, width: int | None) -> FloatArray:
    """Return an array of a trace; PerdureError if it is none."""
    if values.dtype.kind not in "fiu" or values.ndim != 2 or width not in (None, values.shape[1]):
        wanted = f"(steps, {width or 'columns'})"
        raise PerdureError(f"{name} must be numbers of shape {wanted}, not {values.dtype} of shape {values.shape}")
    if not np.isfinite(values).all():
        raise PerdureError(f"{name} must be finite")
    return np.asarray(values, np.float64)


def record(contract: Contract, policy: Act, steps: int, seed: int = 0) -> dict[str, Any]:
    """Return the arrays of a trace of a policy in perdure's own world, which ends at a fall."""
    env = VelocityCommandEnv(contract)
    rows: dict[str, list[Any]] = {name: [] for name in WIDTHS}
    observation, _ = env.reset(seed=seed)
    state = None
    scratch = mujoco.MjData(env.model)
    for _ in range(steps):
        for name, values in env.sensors().items():
            rows[name].append(values)
        mujoco.mj_copyData(scratch, env.model, env.data)
        mujoco.mj_forward(env.model, scratch)
        rows["torques"].append(scratch.actuator_force[: len(contract.joints)].copy())
        action, state = act_on(policy, observation, state)
        rows["observation"].append(observation)
        rows["action"].append(action)
        observation, _, fell, _, _ = env.step(action)
        rows["targets"].append(env.data.ctrl[: len(contract.joints)].copy())
        if fell:
            break
    return {"joints": np.array(contract.joints)} | {name: np.array(values) for name, values in rows.items()}


def compare(contract: Contract, policy: Act | None, trace: Trace) -> tuple[list[str], bool]:
    """Replay a trace through a policy, if there is one, and a contract.

    Returns:
        (what was found, a line each; whether everything is as recorded).
    """
    size = contract.observation_size
    if trace.observation.shape[1] != size:
        parts = ", ".join(f"{term.name} {contract.size(term)} x {term.history}" for term in contract.terms)
        return [f"trace: observations have {trace.observation.shape[1]} numbers, the contract {size}: {parts}"], False
    if trace.action.shape[1] != len(contract.joints):
        wrong = f"actions have {trace.action.shape[1]} numbers, the contract {len(contract.joints)} joints"
        return [f"trace: {wrong}"], False
    lines = [f"trace of {len(trace.action)} steps"]
    problems: list[str] = []
    if policy is not None:
        problems += _compare_actions(contract, policy, trace)
    env = VelocityCommandEnv(contract)
    replayed = Replay(contract, env, trace)
    problems += replayed.differences()
    problems += _compare_targets(contract, trace)
    problems += _compare_torques(env, trace)
    problems += _compare_pace(env, trace)
    problems += [f"as recorded with: {change}" for change in replayed.explanations()[:3]]
    if replayed.unknown:
        lines.append(f"not compared, since what they are computed from was not recorded: {', '.join(replayed.unknown)}")
    if not problems:
        lines.append("the contract computes what was recorded")
    return lines + problems, not problems


def _differs(computed: FloatArray, recorded: FloatArray) -> Any:
    """Return where two arrays differ; nowhere where the first is unknown (nan)."""
    with np.errstate(invalid="ignore"):
        return np.abs(computed - recorded) > TOLERANCE * np.maximum(1.0, np.abs(recorded))


def _compare_actions(contract: Contract, policy: Act, trace: Trace) -> Iterator[str]:
    """Yield where the policy first acts differently on the recorded observations."""
    state = None
    rows = []
    for observation in trace.observation:
        action, state = act_on(policy, observation, state)
        rows.append(action)
    answered = np.array(rows)
    if answered.shape != trace.action.shape:
        yield f"the policy acts on {answered.shape[1]} joints, the contract names {len(contract.joints)}"
        return
    different = np.argwhere(_differs(answered, trace.action))
    if len(different):
        step, joint = different[0]
        both = f"recorded {trace.action[step, joint]:.4g}, the policy answers {answered[step, joint]:.4g}"
        yield f"action of {contract.joints[joint]} differs first at step {step}: {both}"


class Replay:
    """Observations that a contract computes from the sensors of a trace."""

    def __init__(self, contract: Contract, env: VelocityCommandEnv, trace: Trace) -> None:
        self._contract = contract
        self._trace = trace
        self._model = env.model
        self._data = mujoco.MjData(env.model)
        self._seconds = float(env.dt)
        self._states = list(self._robot_states())
        computed = self._observations(contract, len(trace.action))
        self._names = Observer(contract).names
        self._computed = computed
        self._different = _differs(computed, trace.observation)
        terms = [name.partition("[")[0] for name in self._names]
        bare = [bool(np.isnan(column).all()) for column in computed.T]
        self.unknown = list(dict.fromkeys(term for term, each in zip(terms, bare, strict=True) if each))
        """Terms that cannot be computed from what was recorded."""

    def _robot_states(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield positions and velocities of the robot at each step; nan where they were not recorded."""
        trace = self._trace
        model = self._model
        names = [model.joint(k).name for k in range(1, model.njnt)]
        places = {"joint_pos": model.jnt_qposadr[1:], "joint_vel": model.jnt_dofadr[1:]}
        for step in range(len(trace.action)):
            qpos = np.full(model.nq, np.nan)
            qvel = np.full(model.nv, np.nan)
            qpos[:3] = 0.0, 0.0, 1.0
            for name, target in (("joint_pos", qpos), ("joint_vel", qvel)):
                values = trace.of_joints(name, tuple(names))
                if values is not None:
                    target[places[name]] = values[step]
            if "quaternion" in trace.sensors:
                qpos[3:7] = trace.sensors["quaternion"][step]
                qpos[3:7] /= np.linalg.norm(qpos[3:7])
            if "angular_velocity" in trace.sensors:
                qvel[3:6] = trace.sensors["angular_velocity"][step]
            if "linear_velocity" in trace.sensors:
                turned = np.zeros(3)
                mujoco.mju_rotVecQuat(turned, trace.sensors["linear_velocity"][step], qpos[3:7])
                qvel[:3] = turned  # in the frame of the world, as MuJoCo has it
            yield qpos, qvel

    def _observations(self, contract: Contract, steps: int) -> FloatArray:
        """Return what a contract computes for the first steps; nan where something was not recorded."""
        observer = Observer(contract)
        observer.begin()
        robot = RobotState(contract, self._model, self._data)
        commands = self._trace.sensors.get("command")
        rows = []
        for step in range(steps):
            self._data.qpos[:], self._data.qvel[:] = self._states[step]
            robot.read_base()
            robot.action = np.full(len(contract.joints), np.nan)  # before the trace
            if step:
                robot.action = self._trace.action[step - 1]
            robot.command = (math.nan,) * 3
            if commands is not None:
                robot.command = commands[step].tolist()
            robot.walk_on(robot.command, self._seconds)
            rows.append(observer.read(robot))
        found = np.array(rows)
        # What fills the history of the first steps differs from one simulator to the next.
        histories = {term.name: term.history for term in contract.terms}
        for column, name in enumerate(observer.names):
            found[: histories[name.partition("[")[0]] - 1, column] = np.nan
        return found

    def differences(self) -> list[str]:
        """Return the first difference of each term, the earliest first."""
        found = []
        seen = set()
        for step, column in np.argwhere(self._different):
            term = self._names[column].partition("[")[0]
            if term in seen:
                continue
            seen.add(term)
            recorded = self._trace.observation[step, column]
            both = f"recorded {recorded:.4g}, the contract computes {self._computed[step, column]:.4g}"
            found.append(f"{self._label(column)} differs first at step {step}: {both}")
        return found

    def _label(self, column: int) -> str:
        """Return the name of a component of the observations, with its joint where it is of one."""
        name = self._names[column]
        term, _, number = name.rstrip("]").partition("[")
        if term in ("joint_pos", "joint_pos_abs", "joint_vel", "actions"):
            return f"{name} ({self._contract.joints[int(number)]})"
        return name

    def explanations(self) -> list[str]:
        """Return changes of the contract with which it computes what was recorded, the best first."""
        longest = max(term.history for term in self._contract.terms)
        steps = min(len(self._states), longest + FIT_STEPS)
        recorded = self._trace.observation[:steps]
        before = int(self._different[:steps].sum())
        if not before:
            return []
        fitting = []
        for change, other in changed_observations(self._contract):
            if other.observation_size != recorded.shape[1]:
                continue
            left = int(_differs(self._observations(other, steps), recorded).sum())
            if left <= FITS * before:
                fitting.append((left, change))
        return [change for _, change in sorted(fitting)]


def _compare_targets(contract: Contract, trace: Trace) -> Iterator[str]:
    """Yield the delay of the recorded joint targets behind the actions, and the first target that differs."""
    recorded = trace.of_joints("targets", contract.joints)
    if recorded is None:
        return
    actions = trace.action.clip(-contract.action_clip, contract.action_clip)
    delay = contract.action_delay
    errors = _delay_errors(actions, recorded)
    if len(errors) > delay:
        best = int(np.argmin(errors))
        if errors[best] < CLEARLY * errors[delay]:
            yield f"targets lag {best} steps behind the actions: action_delay {best}, not {delay}"
            delay = best
    computed = contract.values("default_pose") + contract.values("action_scale") * actions
    late = recorded[delay:]
    early = computed[: len(computed) - delay]
    different = np.argwhere(_differs(early, late))
    if not len(different):
        return
    step, joint = different[0]
    both = f"recorded {late[step, joint]:.4g}, the contract computes {early[step, joint]:.4g}"
    mine = actions[: len(late), joint]
    fit = ""
    if np.ptp(mine) > TOLERANCE:
        slope, offset = np.polyfit(mine, late[:, joint], 1)
        fit = f" (action_scale {slope:.3g} and default_pose {round(offset, 6):.3g} fit)"
    yield f"target of {contract.joints[joint]} differs first at step {step + delay}: {both}{fit}"


def _delay_errors(actions: FloatArray, targets: FloatArray) -> list[float]:
    """Return the squared error of targets by least squares from the actions of so many steps before, by this delay.

    Each joint has its own scale and offset, so that a wrong one does not hide the delay. All delays are judged on the
    same steps.
    """
    longest = min(LONGEST_DELAY, len(actions) // 3)
    later = targets[longest:] - targets[longest:].mean(axis=0)
    errors = []
    for delay in range(longest + 1):
        earlier = actions[longest - delay : len(actions) - delay]
        earlier = earlier - earlier.mean(axis=0)
        power = np.maximum((earlier**2).sum(axis=0), 1e-12)
        slope = (earlier * later).sum(axis=0) / power
        errors.append(float(np.nansum((later - slope * earlier) ** 2)) + 1e-9)
    return errors


def _compare_torques(env: VelocityCommandEnv, trace: Trace) -> Iterator[str]:
    """Yield that the motors were stiffer or softer, or more or less damped, by least squares over all joints."""
    contract = env.contract
    names = ("joint_pos", "joint_vel", "torques", "targets")
    places, speeds, torques, targets = (trace.of_joints(name, contract.joints) for name in names)
    if places is None or speeds is None or torques is None or targets is None:
        return
    springs = contract.values("stiffness") * (targets[:-1] - places[1:])  # targets hold until the next observation
    dampers = -contract.values("damping") * speeds[1:]
    measured = torques[1:]
    model = env.model
    limits = np.where(model.actuator_forcelimited, model.actuator_forcerange[:, 1], np.inf)[: len(contract.joints)]
    useful = np.abs(measured) < SATURATED * limits
    both = np.column_stack([springs[useful], dampers[useful]])
    if len(both) < 2:
        return
    factors, *_ = np.linalg.lstsq(both, measured[useful], rcond=None)
    wrong = []
    for name, factor in zip(("stiffness", "damping"), factors, strict=True):
        if not 1.0 / STRONGER < factor < STRONGER:
            wrong.append(f"{name} x {factor:.3g}")
    if wrong:
        yield f"torques are as with {' and '.join(wrong)}"


def _compare_pace(env: VelocityCommandEnv, trace: Trace) -> Iterator[str]:
    """Yield that the joints moved as if the control step was another one."""
    joints = env.contract.joints
    places = trace.of_joints("joint_pos", joints)
    speeds = trace.of_joints("joint_vel", joints)
    if places is None or speeds is None:
        return
    moved = np.diff(places, axis=0)
    between = 0.5 * (speeds[1:] + speeds[:-1])
    power = float(np.nansum(between**2))
    if power < TOLERANCE:
        return
    seconds = float(np.nansum(moved * between)) / power
    if not 1.0 / PACE < seconds / env.dt < PACE:
        yield f"joints move as in control steps of about {1e3 * seconds:.2g} ms, the contract has {1e3 * env.dt:.3g} ms"
