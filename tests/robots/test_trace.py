"""Golden traces: recorded here from MuJoCo itself, replayed through contracts with one mistake each."""

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace

from perdure.__main__ import main
from perdure.errors import PerdureError
from perdure.robots.trace import compare, make_trace, read_trace, record
from perdure.robots.world import VelocityCommandEnv
from tests.robots.conftest import ANT, act
from tests.robots.test_check import FAULTS, MEANT

STEPS = 60


@pytest.fixture(scope="module")
def arrays(ant):
    """A walk of the Ant as a logger would write it; frames and torques are those of the simulator."""
    env = VelocityCommandEnv(ant)
    joints = [f"{kind}_{leg}" for kind in ("ankle", "hip") for leg in range(4, 0, -1)]  # in an order of its own
    rows = {name: [] for name in ("observation", "action", "quaternion", "angular_velocity", "linear_velocity")}
    rows |= {name: [] for name in ("joint_pos", "joint_vel", "torques", "command", "targets")}
    observation, _ = env.reset(seed=0)
    for _ in range(STEPS):
        now = mujoco.MjData(env.model)
        mujoco.mj_copyData(now, env.model, env.data)
        mujoco.mj_forward(env.model, now)
        action = act(observation)
        rows["observation"].append(observation)
        rows["action"].append(action)
        rows["quaternion"].append(now.body("torso").xquat)
        both = np.zeros(6)
        mujoco.mj_objectVelocity(env.model, now, mujoco.mjtObj.mjOBJ_XBODY, 1, both, 1)
        rows["angular_velocity"].append(both[:3])
        rows["linear_velocity"].append(both[3:])
        rows["joint_pos"].append([now.joint(name).qpos[0] for name in joints])
        rows["joint_vel"].append([now.joint(name).qvel[0] for name in joints])
        rows["torques"].append([now.joint(name).qfrc_actuator[0] for name in joints])
        rows["command"].append(ant.command)
        observation, *_ = env.step(action)
        rows["targets"].append([env.data.actuator(name).ctrl[0] for name in joints])
    return {"joints": np.array(joints)} | {name: np.array(values) for name, values in rows.items()}


SHOWN = MEANT | {
    "gain 30 % off": "torques are as with stiffness x 1.43 and damping x 1.43",
    "wrong decimation": "ms, the contract has 100 ms",
    "targets delayed": "action_delay 0, not 2",
}
"""How the line ends that names each mistake."""


def test_the_contract_of_the_trace_computes_what_was_recorded(ant, arrays):
    lines, same = compare(ant, act, make_trace(arrays, ant))
    assert same, lines
    assert len(lines) == 2, "nothing is left out"


@pytest.mark.parametrize("mistake", FAULTS)
def test_each_mistake_is_found_and_named(ant, arrays, mistake):
    lines, same = compare(FAULTS[mistake](ant), None, make_trace(arrays, ant))
    assert not same
    named = [line for line in lines if line.endswith(SHOWN[mistake])]
    assert named, lines
    offered = [line for line in lines if line.startswith("as recorded with")]
    assert offered[:1] in ([], named)


def test_the_first_difference_is_named_by_term_step_and_both_values(ant, arrays):
    changed = {**arrays, "observation": arrays["observation"].copy()}
    changed["observation"][7:, 12] += 0.5
    changed["observation"][9:, 30] -= 0.5
    lines, _ = compare(ant, None, make_trace(changed, ant))
    recorded = changed["observation"][7, 12]
    computed = arrays["observation"][7, 12]
    both = f"recorded {recorded:.4g}, the contract computes {computed:.4g}"
    assert lines[1] == f"joint_pos[3] (ankle_2) differs first at step 7: {both}"
    assert len(lines) == 3
    assert lines[2].startswith("actions[5] (ankle_3) differs first at step 9")


def test_another_policy_is_named(ant, arrays):
    lines, same = compare(ant, lambda seen: act(seen) * np.where(seen[:, :1] > 0.0, 1.0, 1.1), make_trace(arrays, ant))
    assert not same
    assert lines[1].startswith("action of ")
    assert "the policy answers" in lines[1]


@pytest.mark.parametrize("delay", [1, 3])
def test_the_delay_of_a_robot_is_found_in_spite_of_a_wrong_scale(ant, delay):
    """A robot with a delay that its contract does not have, also where another mistake hides it."""
    trace = make_trace(record(replace(ant, action_delay=delay), act, STEPS), ant)
    wrong = replace(ant, action_scale=(0.2,) * 8)
    lines, _ = compare(wrong, None, trace)
    assert f"targets lag {delay} steps behind the actions: action_delay {delay}, not 0" in lines
    assert any("action_scale 0.3 and" in line for line in lines)
    lines, _ = compare(replace(ant, action_delay=delay), None, trace)
    assert not any("lag" in line for line in lines)


def test_without_sensors_only_what_is_recorded_is_compared(ant, arrays):
    few = {name: arrays[name] for name in ("observation", "action")}
    lines, same = compare(ant, act, make_trace(few, ant))
    assert same
    assert "base_ang_vel, projected_gravity, command, joint_pos, joint_vel" in lines[1]
    assert "actions" not in lines[1].partition(": ")[2]
    order = list(ant.terms)
    order[4], order[5] = order[5], order[4]
    lines, same = compare(replace(ant, observations=tuple(order)), act, make_trace(few, ant))
    assert not same, "the last action is known"


def test_what_perdure_records_is_a_trace_of_its_contract(ant, arrays):
    recorded = record(ant, act, STEPS)
    assert compare(ant, act, make_trace(recorded, ant))[1]
    for name in ("observation", "angular_velocity", "linear_velocity"):
        assert np.allclose(recorded[name], arrays[name]), name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"action": None}, "needs the array action"),
        ({"gyroscope": np.zeros((STEPS, 3))}, "no array 'gyroscope'"),
        ({"comand": np.zeros((STEPS, 3))}, "did you mean 'command'"),
        ({"command": np.zeros((STEPS, 2))}, r"command must be numbers of shape \(steps, 3\)"),
        ({"targets": np.zeros((STEPS, 7))}, r"targets must be numbers of shape \(steps, 8\)"),
        ({"action": np.zeros((STEPS - 1, 8))}, "as many rows"),
        ({"command": np.full((STEPS, 3), np.nan)}, "command must be finite"),
        ({"action": np.full((STEPS, 8), "x")}, "action must be numbers"),
        ({"quaternion": np.zeros((STEPS, 4))}, "no orientation"),
    ],
)
def test_arrays_that_are_no_trace_are_refused(ant, arrays, tmp_path, change, message):
    values = {name: array for name, array in {**arrays, **change}.items() if array is not None}
    np.savez(tmp_path / "trace.npz", **values)
    with pytest.raises(PerdureError, match=message):
        read_trace(tmp_path / "trace.npz", ant)


def test_sizes_that_differ_are_named(ant, arrays):
    lines, same = compare(replace(ant, observations=ant.terms[1:]), None, make_trace(arrays, ant))
    assert not same
    assert "45 numbers, the contract 42" in lines[0]
    narrow = {**arrays, "action": arrays["action"][:, :7]}
    lines, same = compare(ant, None, make_trace(narrow, ant))
    assert not same
    assert "7 numbers" in lines[0]


def test_the_command(ant, arrays, tmp_path, capsys):
    np.savez(tmp_path / "trace.npz", **arrays)
    main(["robot", "check", str(ANT), "--trace", str(tmp_path / "trace.npz")])
    assert "the contract computes what was recorded" in capsys.readouterr().out
    late = tmp_path / "late.yaml"
    late.write_text(ANT.read_text() + "action_delay: 1\n")
    with pytest.raises(SystemExit) as ended:
        main(["robot", "check", str(late), "--trace", str(tmp_path / "trace.npz")])
    assert ended.value.code == 3
    (tmp_path / "no.npz").write_bytes(b"no")
    with pytest.raises(SystemExit):
        main(["robot", "check", str(ANT), "--trace", str(tmp_path / "no.npz")])
    assert "no .npz file" in capsys.readouterr().err
