"""The method `steady` is two trainings in one run: it leaves what both commands leave, one after the other."""

from dataclasses import replace
from shlex import split

import polars as pl
import pytest
from safetensors.numpy import load_file

from perdure.cli import run as run_command
from perdure.envs import task_spec
from perdure.errors import PerdureError
from perdure.learn import TrainRun, method_config, on_report, train
from perdure.learn.config import Further
from perdure.learn.provenance import command
from perdure.learn.recipe import Recipe
from perdure.learn.run import kept_steps
from perdure.policy import load_policy

TASK = "InvertedPendulum-v4"
FIRST_STEPS = 256
ROLLOUT = 2048
"""Of the preset with which the recipe trains further."""
FURTHER_STEPS = 2 * ROLLOUT
STEADY = replace(
    method_config("steady", TASK, 4),
    **{"total_steps": FIRST_STEPS, "n_steps": 64, "hidden_sizes": (8,), "n_epochs": 1, "segment_steps": 128},
    then=Further(total_steps=FURTHER_STEPS),
)
RUN = TrainRun(TASK, "steady", STEADY)
CURVES = ("episodes", "iterations")


class Killed(BaseException):
    """Stands in for a signal."""


def killed_at(step, out):
    def told(report):
        if report.step >= step:
            raise Killed

    with pytest.raises(Killed):
        train(RUN, out, cores=1, observe=on_report(RUN, told))
    return kept_steps(RUN, out)


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    """The folder of a run that was killed in both stages, and its reports after that."""
    out = tmp_path_factory.mktemp("steady")
    assert killed_at(192, out) == {0: 192}
    assert killed_at(FIRST_STEPS + ROLLOUT, out) == {0: FIRST_STEPS + ROLLOUT}
    reports = []
    (path,) = train(RUN, out, cores=1, observe=on_report(RUN, reports.append))
    return path.parent, reports


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The folders of plain PPO and of the further training of its policy, without interruption."""
    out = tmp_path_factory.mktemp("both")
    (first,) = train(TrainRun(TASK, "ppo", replace(STEADY, then=None)), out, cores=1)
    (second,) = train(Recipe(total_steps=FURTHER_STEPS).run(first, TASK), out, cores=1)
    return first.parent, second.parent


def arrays(folder):
    return {name: array.tobytes() for name, array in load_file(folder / "policy.safetensors").items()}


@pytest.mark.verify
def test_its_policies_are_those_of_both_trainings_bit_for_bit(steady, both):
    folder, _ = steady
    assert arrays(folder) == arrays(both[1]) != arrays(both[0])
    assert arrays(folder / "stage-1") == arrays(both[0])


@pytest.mark.verify
def test_its_curves_go_on_where_the_first_stage_ends(steady, both):
    folder, reports = steady
    for name in CURVES:
        one = pl.read_parquet(both[0] / f"{name}.parquet")
        two = pl.read_parquet(both[1] / f"{name}.parquet")
        expected = pl.concat([one, two.with_columns(pl.col("step") + FIRST_STEPS)])
        assert pl.read_parquet(folder / f"{name}.parquet").equals(expected)
    total = FIRST_STEPS + FURTHER_STEPS
    assert [(each.step, each.steps) for each in reports] == [(total, total)]
    assert reports[-1].share == 1.0


@pytest.mark.verify
def test_its_policy_names_both_stages(steady, both):
    folder, _ = steady
    known = load_policy(folder / "policy.safetensors").provenance
    apart = load_policy(both[1] / "policy.safetensors").provenance
    assert known["method"] == "steady"
    assert (known["config"], known["disturb"]) == (apart["config"], apart["disturb"])
    assert known["config"]["protocol"]["gamma"] == 0.999
    assert known["stages"] == [{"config": STEADY.to_json(), "disturb": []}]
    assert known["from"]["steps"] == FIRST_STEPS
    assert {each.name for each in folder.rglob("*checkpoint*")} == set()


def test_the_recorded_command_trains_both_stages(monkeypatch):
    found = []
    monkeypatch.setattr("perdure.learn.run.train", lambda run, *_, **options: found.append(run) or [])
    changed = replace(STEADY, then=Further(0.995, FURTHER_STEPS, ("action_noise:0.2",)))
    for config in (method_config("steady", TASK, 4), changed):
        run = TrainRun(TASK, "mine", config, base_method="steady", disturb=("action_delay:1",))
        run_command(split(command(run, task_spec(TASK), 0))[1:])
        assert found.pop() == run
    usual = TrainRun("Hopper-v3", "steady", method_config("steady", "Hopper-v3", 11))
    line = command(usual, task_spec("Hopper-v3"), 3)
    assert line == "perdure train Hopper-v3 --method steady --preset cleanrl --seeds 3"
    assert usual.stages[1].config == replace(
        method_config("ppo", "Hopper-v3", 11),
        total_steps=300_000,
        log_std_init=-1.0,
        protocol=replace(usual.config.protocol, gamma=0.999),
    )


def test_what_disturbs_the_run_disturbs_both_stages_and_is_part_of_what_it_is():
    run = replace(RUN, disturb=("action_delay:1",))
    assert [stage.disturb for stage in run.stages] == [("action_delay:1",), ("action_delay:1", "action_noise:0.1")]
    assert RUN.identity(0)["then"][0]["config"]["protocol"]["gamma"] == 0.999
    longer = replace(RUN, config=replace(STEADY, then=Further(total_steps=300_000)))
    assert longer.identity(0) != RUN.identity(0)


def test_a_wrong_later_stage_is_refused_at_the_door():
    with pytest.raises(PerdureError, match="did you mean 'action_noise'"):
        replace(RUN, config=replace(STEADY, then=Further(disturb=("action_nose:0.1",))))
    with pytest.raises(PerdureError, match="more than one rollout"):
        replace(RUN, config=replace(STEADY, then=Further(total_steps=ROLLOUT)))
    for wrong in ({"gamma": 1.5}, {"total_steps": 0}):
        with pytest.raises(PerdureError, match=next(iter(wrong))):
            Further(**wrong)
