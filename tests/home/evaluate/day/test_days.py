"""Days: what a home becomes, what comes after a kill, and that an errand begins as the one before it ended."""

from dataclasses import replace

import numpy as np
import pytest
from home_days import scripted_errands

from perdure.cli.home import main
from perdure.errors import PerdureError
from perdure.home.evaluate import day
from perdure.home.evaluate.day import DayProtocol, HomeDay, day_units, find_errands, run_days
from perdure.home.evaluate.day_table import read_days
from perdure.home.evaluate.day_verdict import judge_days
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.simulator import Simulator
from perdure.home.skills import SKILLS
from perdure.home.tasks.tasks import TASKS
from perdure.runs import Store, attempt
from perdure.schema import read_json

NOWHERE = Store("/nowhere")
SECONDS = 85 / 30
"""Length of a scripted errand, see `home_stories`: five targets, and the settling time."""


def protocol(errands=("tidy_house",), homes=2, hours=12 * SECONDS / 3600, **more):
    options = ExecutorOptions(planner="closed", fallback="none", settle_steps=2)
    first = EvaluationProtocol(errands[0], "rl", "eval", episodes=homes, options=options, **more)
    return DayProtocol(tuple(errands), hours, first)


def nothing(errand, poses):
    """Leave the home in order."""


def decaying(errand, poses):
    """In home 1 a clutter object falls in every errand; home 0 stays in order."""
    if errand.index == day.first_state(("tidy_house",), "eval", 1, 0)[0].index:
        poses[-1, 2] = 0.05
        standing = [k for k in range(len(errand.goals), len(poses)) if poses[k, 2] > 0.2]
        if standing:
            poses[standing[0], 2] = 0.05


@pytest.fixture
def decay(monkeypatch):
    monkeypatch.setattr(Executor, "run_to_end", scripted_errands(decaying))


def test_a_home_that_decays_and_one_that_does_not(decay, tmp_path):
    frame, notes = read_days(run_days(protocol(), tmp_path, command="a test"))
    assert notes["command"] == "a test"
    assert judge_days(frame)["verdict"].to_list() == ["holds", "fails silently"]
    in_order, decays = frame.partition_by("home")
    assert in_order["stays"].all()
    assert decays["stays"].all()
    assert in_order["on_floor"].sum() == 0
    floor = decays["on_floor"].to_list()
    assert floor == decays["fell"].cum_sum().to_list()
    assert min(np.diff(floor)) >= 1
    assert np.allclose(frame["end"] - frame["begin"], SECONDS / 3600)
    for home in (in_order, decays):
        assert home["begin"].to_list()[1:] == home["end"].to_list()[:-1]
        assert home["then"].to_list() == ["goes on"] * (home.height - 1) + ["the time is up"]


def test_a_home_without_an_errand_is_over(tmp_path, monkeypatch):
    """Every errand costs five objects of 25, the targets: after five errands none can be drawn."""

    def losing(errand, poses):
        poses[: len(errand.goals), 2] = 0.05

    monkeypatch.setattr(Executor, "run_to_end", scripted_errands(losing))
    frame, _ = read_days(run_days(protocol(homes=1), tmp_path))
    assert judge_days(frame)["verdict"].to_list() == ["no errand left"]
    assert frame["fell"].to_list() == [5] * frame.height
    assert frame["then"].to_list() == ["goes on"] * (frame.height - 1) + ["no errand left"]
    assert frame.height <= 5


def test_kills_change_no_byte(decay, tmp_path, monkeypatch):
    wanted = protocol(hours=8 * SECONDS / 3600)
    whole = run_days(wanted, tmp_path / "whole").read_bytes()
    rng = np.random.default_rng(0)

    def killed(executor, errands):
        for each in scripted_errands(decaying)(executor, errands):
            if rng.random() < 0.2:
                raise KeyboardInterrupt
            yield each

    monkeypatch.setattr(Executor, "run_to_end", killed)
    kills = 0
    again = None
    while again is None:
        try:
            again = run_days(wanted, tmp_path / "killed")
        except KeyboardInterrupt:
            kills += 1
    assert kills >= 3
    assert again.read_bytes() == whole
    assert not list((tmp_path / "killed").rglob("homes.json")), "the checkpoint goes with the end"


def test_finished_homes_are_not_run_again(decay, tmp_path, monkeypatch):
    wanted = protocol(homes=1, hours=SECONDS / 3600)
    first = run_days(wanted, tmp_path).read_bytes()
    ran = []

    def counted(executor, errands):
        ran.append(len(errands))
        return scripted_errands(decaying)(executor, errands)

    monkeypatch.setattr(Executor, "run_to_end", counted)
    assert run_days(wanted, tmp_path).read_bytes() == first
    assert ran == []
    more, _ = read_days(run_days(protocol(homes=3, hours=SECONDS / 3600), tmp_path))
    assert ran == [2] * len(ran)
    assert more["home"].unique().to_list() == [0, 1, 2]


def test_errands_alternate_and_one_that_cannot_be_drawn_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(Executor, "run_to_end", scripted_errands(nothing))
    draw = day.draw_errand
    without = []
    monkeypatch.setattr(day, "draw_errand", lambda task, *rest: None if task in without else draw(task, *rest))
    mixed = protocol(("tidy_house", "set_table"), homes=1, hours=4 * SECONDS / 3600)
    frame, _ = read_days(run_days(mixed, tmp_path / "both"))
    assert frame["task"].to_list()[:4] == ["tidy_house", "set_table"] * 2
    assert frame["errands"].unique().to_list() == ["tidy_house set_table"]
    without.append("set_table")
    frame, _ = read_days(run_days(mixed, tmp_path / "one"))
    assert set(frame["task"]) == {"tidy_house"}
    without.append("tidy_house")
    with pytest.raises(PerdureError, match="no errand"):
        run_days(mixed, tmp_path / "none")


def test_errands_are_found_again(tmp_path, monkeypatch):
    """The same errands as in the day, without its neighbors."""
    seen = {}

    def kept(executor, errands):
        for errand in errands:
            seen.setdefault(errand.index, []).append(errand)
        return scripted_errands(decaying)(executor, errands)

    monkeypatch.setattr(Executor, "run_to_end", kept)
    wanted = protocol(hours=3 * SECONDS / 3600)
    run_days(wanted, tmp_path)
    first, _ = day.first_state(("tidy_house",), "eval", 1, 0)
    errands = seen[first.index]
    assert find_errands(wanted, 1, (1, 3)) == {1: errands[0], 3: errands[2]}
    with pytest.raises(PerdureError, match="3 errands"):
        find_errands(wanted, 1, (1, 4))
    with pytest.raises(PerdureError, match="numbered from 1"):
        find_errands(wanted, 1, (0,))


def test_wrong_options_fail_at_the_door():
    with pytest.raises(PerdureError, match="tidy_house"):
        protocol(("tidy_hous",))
    with pytest.raises(PerdureError, match="tidy_house"):
        DayProtocol(("set_table", "tidy_hous"), 1.0, protocol().first)
    for hours in (0.0, -1.0, float("nan")):
        with pytest.raises(PerdureError, match="hours"):
            protocol(hours=hours)
    with pytest.raises(PerdureError, match="open_drawer"):
        list(day_units(protocol(policies={"open_drawer": "drawer.safetensors"}), "", NOWHERE))


def test_an_oracle_that_was_asked_for_does_not_intervene(tmp_path, monkeypatch):
    """Only a skill that is taken over from a policy counts."""

    def by_oracle(executor, errands):
        for log, lane in scripted_errands(nothing)(executor, errands):
            yield replace(log, runs=tuple(replace(run, scripted=True) for run in log.runs)), lane

    monkeypatch.setattr(Executor, "run_to_end", by_oracle)
    for name, policies, taken in (("learned", {}, 10), ("oracle", dict.fromkeys(SKILLS, "oracle"), 0)):
        frame, _ = read_days(run_days(protocol(homes=1, hours=SECONDS / 3600, policies=policies), tmp_path / name))
        assert frame["taken_over"].to_list() == [taken] * frame.height


# In the simulator


@pytest.fixture
def hurried(monkeypatch):
    """Errands of 12 steps, in which nothing is achieved."""
    for skill in SKILLS.values():
        monkeypatch.setattr(skill, "step_limit", 5)
    monkeypatch.setitem(TASKS, "tidy_house", replace(TASKS["tidy_house"], max_steps=12))


def test_an_errand_begins_as_the_one_before_it_ended(hurried, tmp_path, monkeypatch):
    """The simulator is set to the robot, objects and doors that the checkpoint has, and the home knows no neighbor."""
    starts = []
    reset = Simulator.reset

    def seen(simulator, *arguments):
        reset(simulator, *arguments)
        starts.append((simulator.qpos.copy(), np.abs(simulator.qvel).max(), simulator.scene))

    monkeypatch.setattr(Simulator, "reset", seen)
    wanted = protocol(homes=2, hours=20 / 30 / 3600)
    (unit,) = day_units(wanted, "", NOWHERE)
    assert attempt(tmp_path, unit) == "unfinished"
    kept = tmp_path / ".working" / unit.key.replace("/", "~") / "homes.json"
    days = read_json(kept.read_bytes(), tuple[HomeDay, ...])
    starts.clear()
    assert attempt(tmp_path, unit) == "finished"
    for each, (qpos, speed, scene) in zip(days, starts, strict=True):
        assert speed == 0.0
        assert qpos[scene.robot_qpos][:3].tolist() == pytest.approx(
            [each.state.base.x, each.state.base.y, each.state.base.yaw]
        )
        assert dict(zip(scene.links, qpos[scene.link_qpos].tolist(), strict=True)) == each.state.positions
        found = {tuple(qpos[address : address + 3]) for address in scene.object_qpos}
        assert found == {placement.position for placement in each.state.objects}
    frame, _ = read_days(tmp_path / unit.key / "day.parquet")
    alone, _ = read_days(run_days(protocol(homes=1, hours=20 / 30 / 3600), tmp_path / "alone"))
    assert frame.filter(frame["home"] == 0).equals(alone)


def test_the_command_prints_verdicts_and_writes_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Executor, "run_to_end", scripted_errands(nothing))
    monkeypatch.setattr("perdure.report.page.javascript", lambda: "")  # it takes seconds
    hours = str(4.5 * SECONDS / 3600)
    flags = ["--errands", "tidy_house", "--hours", hours, "--homes", "1", "--split", "eval", "--fallback", "none"]
    main("day", [*flags, "--on", "here", "--out", str(tmp_path), "--formats"])
    assert "1 of 1 homes hold" in capsys.readouterr().out
    (page,) = tmp_path.rglob("report.html")
    assert "perdure home day --errands tidy_house" in page.read_text()
    frame, _ = read_days(page.parent / "day.parquet")
    assert frame.height == 5
    for wrong in (["--errands", "tidy_hous"], ["--film", "20"], ["--errands"]):
        with pytest.raises(PerdureError, match=r"tidy_house|--film|--errands"):
            main("day", [*wrong, "--out", str(tmp_path / "wrong")])
