"""`robot check`: each planted fault has a change that undoes it, and walks name the fault."""

from itertools import product

import mujoco
import numpy as np
import pytest
import yaml
from msgspec.structs import replace

from perdure.__main__ import main
from perdure.robots import check as module
from perdure.robots.check import changes, check
from perdure.robots.contract import VALUES
from perdure.robots.world import VelocityCommandEnv
from tests.robots.conftest import ANT, act


def term(contract, name, **values):
    return replace(contract, observations=tuple(replace(t, **values) if t.name == name else t for t in contract.terms))


def exchanged(items, one, other):
    moved = list(items)
    moved[one], moved[other] = moved[other], moved[one]
    return tuple(moved)


def joints(contract, one, other):
    values = {name: exchanged(found, one, other) for name in VALUES if (found := getattr(contract, name))}
    return replace(contract, joints=exchanged(contract.joints, one, other), **values)


def gains(contract, factor):
    return replace(contract, **{n: tuple(factor * contract.values(n)) for n in ("stiffness", "damping")})


def pose(contract, offset):
    mine = np.array([name.startswith("ankle") for name in contract.joints])
    return replace(contract, default_pose=tuple(contract.values("default_pose") + offset * mine))


def world_frame(contract):
    terms = [replace(t, name="base_ang_vel_w") if t.name == "base_ang_vel" else t for t in contract.terms]
    return replace(contract, observations=tuple(terms))


FAULTS = {
    "two joints exchanged": lambda c: joints(c, 0, 4),
    "legs exchanged": lambda c: joints(joints(c, 0, 2), 1, 3),
    "gain 30 % off": lambda c: gains(c, 0.7),
    "terms exchanged": lambda c: replace(c, observations=exchanged(c.terms, 0, 6)),
    "scale missing": lambda c: term(c, "joint_vel", scale=1.0),
    "wrong default pose": lambda c: pose(c, 0.3),
    "wrong decimation": lambda c: replace(c, decimation=10),
    "history reversed": lambda c: replace(c, history_order="newest first"),
    "targets delayed": lambda c: replace(c, action_delay=2),
    "wrong frame": world_frame,
}
MEANT = {
    "two joints exchanged": "joints hip_3 and hip_1 exchanged",
    "legs exchanged": "legs *_2 and *_1 exchanged",
    "gain 30 % off": "stiffness and damping x 1.4",
    "terms exchanged": "terms cos_phase and base_ang_vel exchanged",
    "scale missing": "scale of joint_vel 0.05, not 1.0",
    "wrong default pose": "default pose of ankle -0.3",
    "wrong decimation": "decimation 5",
    "history reversed": "history_order oldest first",
    "targets delayed": "action_delay 0",
    "wrong frame": "base_ang_vel, not base_ang_vel_w",
}


def same(one, other):
    """Whether contracts agree, gains to within 5 %."""
    near = all(
        np.allclose(one.values(n), other.values(n), rtol=0.05) for n in VALUES if getattr(one, n) and getattr(other, n)
    )
    plain = dict.fromkeys(VALUES, None)
    return near and replace(one, **plain) == replace(other, **plain)


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_has_a_change_that_undoes_it(ant, fault):
    faulty = FAULTS[fault](ant)
    assert not same(faulty, ant)
    assert MEANT[fault] in [name for name, other in changes(faulty) if same(other, ant)]


def test_no_change_is_the_contract_itself(ant):
    found = [other for _, other in changes(ant)]
    assert not any(other == ant for other in found)


@pytest.fixture
def short(monkeypatch):
    """Short walks, forward only; the hand-made trot knows no other command."""
    monkeypatch.setattr(module, "COMMANDS", {"forward": (0.5, 0.0, 0.0)})
    monkeypatch.setattr(module, "SECONDS", 3.0)
    monkeypatch.setattr(module, "FIRST_SECONDS", 1.5)


def test_walks_name_the_fault(ant, short, monkeypatch):
    faulty = FAULTS["history reversed"](ant)  # it then walks backward
    every = dict(changes(faulty))
    others = [name for name in every if name.startswith(("terms", "scale", "damping", "action_scale"))]
    some = {name: every[name] for name in (*others[::6], MEANT["history reversed"])}
    monkeypatch.setattr(module, "changes", lambda contract: some.items())
    lines, passed = check(faulty, act)
    assert not passed
    better = [line.rpartition("): ")[2] for line in lines if line.startswith("walks better")]
    assert better[0] == MEANT["history reversed"], lines


def test_a_policy_of_another_size_is_refused(ant):
    lines, passed = check(ant, lambda observations: np.zeros((1, 7)))
    assert not passed
    assert lines[-1] == "the policy acts on 7 joints, the contract names 8"


def test_what_is_unusual_is_named(ant):
    contract = replace(pose(ant, 1.0), damping=(1.0,) * 8)
    lines, passed = check(contract, None)
    assert passed
    assert any("default pose of ankle_1, 1.9, is outside" in line for line in lines)
    assert any("the model damps hip_1 by 1 beside the controller's 1" in line for line in lines)
    fewer = {name: tuple(contract.values(name)[:7]) for name in VALUES if getattr(contract, name)}
    lines, _ = check(replace(contract, joints=contract.joints[:7], **fewer), None)
    assert any(line.endswith("no controller holds these joints of the model: ankle_4") for line in lines)


def test_a_driven_joint_without_rotor_inertia_is_named(ant):
    """As in mjlab's Go1, whose armature is not in its MJCF: explicit damping then diverges."""
    (line, unstable), (usual, *_) = check(replace(ant, armature=(0.0,) * 8), None)[0][1:3], check(ant, None)[0]
    assert line == f"warning: no rotor inertia: {', '.join(ant.joints)} (armature)"
    assert unstable.startswith("warning: hip_1: damping 60 is unstable in steps of 10 ms")
    assert "inertia" not in usual
    model = VelocityCommandEnv(replace(ant, armature=(0.0,) * 8))
    model.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert not any("unstable" in each for each in module._unusual(model))


@pytest.mark.parametrize(("score", "passes"), [(0.5, True), (0.42, False)])
def test_a_policy_must_walk_better_than_without_actions(ant, monkeypatch, score, passes):
    scores = iter([score, 0.4])
    monkeypatch.setattr(module, "_walks", lambda contract, policy: ([next(scores)] * 3, 0))
    monkeypatch.setattr(module, "changes", lambda contract: [])
    lines, passed = check(ant, act)
    assert passed == passes
    assert lines[-1].endswith(f"without actions 0.40{'' if passes else ' (no better)'}; falls in 0 of 3 walks")


def test_a_policy_with_a_memory_gets_its_state_back(ant, short, monkeypatch):
    seen = []

    def counts(observations, state=0):
        seen.append(state)
        return np.zeros((1, 8)), state + 1

    monkeypatch.setattr(module, "changes", lambda contract: [])
    check(ant, counts)
    assert seen[:3] == [0, 0, 1]
    assert max(seen) == 3.0 / VelocityCommandEnv(ant).dt - 1


def test_the_command(capsys, policy_file, tmp_path):
    main(["robot", "check", str(ANT)])
    assert capsys.readouterr().out.startswith("8 joints, 45 observations, a control step of 50 ms (5 x 10 ms)")
    values = yaml.safe_load(ANT.read_text()) | {"history": 2}
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(SystemExit) as ended:
        main(["robot", "check", str(tmp_path / "other.yaml"), "--policy", str(policy_file)])
    assert ended.value.code == 3
    assert "takes observations of shape (n, 45), got (1, 78); the contract has" in capsys.readouterr().out


def test_names_of_many_robots_have_kinds():
    legs, parts = ("FL", "FR", "RL", "RR"), ("hip", "thigh", "calf")
    names = [f"{leg}_{part}_joint" for leg, part in product(legs, parts)]
    found = module._orders(names, [part for _, part in product(legs, parts)])
    assert [names[k] for k in found["joints by kind"]][:4] == [f"{leg}_hip_joint" for leg in legs]
    assert "joints by leg" not in found  # that is their order
    assert len(found) == 1 + 6 + 66
