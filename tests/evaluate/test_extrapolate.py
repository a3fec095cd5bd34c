"""A whole evaluation on real tasks: the same table however it is cut into groups, and after whatever interruption."""

from __future__ import annotations

import shutil
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted import policy_for

from perdure.envs import make_world
from perdure.errors import OtherSourceWarning, PerdureError
from perdure.evaluate import (
    EpisodeSpec,
    Execution,
    Extrapolation,
    ExtrapolationResult,
    evaluate_episodes,
    evaluate_files,
)
from perdure.evaluate.episodes import split
from perdure.evaluate.judge import read_judged
from perdure.evaluate.reference import read_idle
from perdure.evaluate.run import read_file
from perdure.evaluate.units import Source, Worlds, evaluate_group
from perdure.horizon import Constant, Countdown, Periodic
from perdure.policy import TaskInfo, find_policy, save_policy
from perdure.report import read_table
from perdure.report.schema import RAW
from perdure.runs import Store, Work

HOPPER = TaskInfo("Hopper-v3", 11, (-1.0,) * 3, (1.0,) * 3)
FIVE_HUNDRED = Constant(500.0)
EPISODE = ["policy", "clock", "eval_seed", "step"]
calm = partial(Extrapolation, disturb=("none",))


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policies")
    plain = save_policy(policy_for(HOPPER, seed=1), folder / "plain.safetensors")
    timed = save_policy(policy_for(HOPPER, seed=2, phi=True, method="linear"), folder / "timed.safetensors")
    return plain, timed


@pytest.fixture(scope="module")
def evaluation(policies):
    return calm(policies, steps=60, clocks=("default", "periodic:20", "countdown"), eval_seeds=2)


@pytest.fixture(scope="module")
def whole(evaluation, tmp_path_factory):
    """In one process, one group."""
    return evaluate_files(
        evaluation, Execution(tmp_path_factory.mktemp("whole"), cores=1, on="here", command="perdure extrapolate ...")
    )


def test_every_policy_runs_under_every_clock_it_can_read_from_every_start(whole):
    episodes = whole.final.select("policy", "clock", "eval_seed").sort(pl.all()).rows()
    expected = [
        ("linear", clock, seed) for clock in ("constant(500)", "countdown(60)", "periodic(20)") for seed in (0, 1)
    ]
    assert episodes == [*expected, ("ppo", "none", 0), ("ppo", "none", 1)]


def test_the_table_is_one_that_reports_read_with_the_command_that_made_it(whole):
    frame, metadata = read_table(whole.path)
    assert frame.sort(EPISODE).equals(whole.frame.select(frame.columns).sort(EPISODE))
    assert metadata["command"] == "perdure extrapolate ..."


def groups(keys):
    return {key for key in keys if key.startswith("groups")}


def test_the_summary_has_a_row_for_each_policy_and_clock(whole):
    summary = whole.summary
    assert summary["episodes"].to_list() == [2] * 4
    episode = whole.final.filter(pl.col("policy") == "ppo")
    row = summary.filter(pl.col("policy") == "ppo")
    assert row["mean_return"].item() == pytest.approx(sum(episode["return"]) / 2)
    assert row["policy_state"].item() == "never worked"
    assert row["median_failed_step"].item() == 0.0, "what never worked has failed from the start"


def test_the_median_time_to_failure_is_that_of_kaplan_and_meier(whole):
    def median(*failed_steps):
        """Episodes that fall at these steps, of 60; None: holds."""
        ends = pl.DataFrame({"eval_seed": range(len(failed_steps)), "failed_step": failed_steps})
        episodes = pl.concat([whole.frame.filter(pl.col("policy") == "ppo").head(1)] * len(ends)).with_columns(
            step=pl.lit(60), test_horizon=pl.lit(60), policy_state=pl.lit("worked"), eval_seed=ends["eval_seed"],
            failed_step=ends["failed_step"].fill_null(60),
            outcome=pl.when(ends["failed_step"].is_null()).then(pl.lit("holds")).otherwise(pl.lit("falls")),
        )  # fmt: skip
        return ExtrapolationResult(episodes, None).summary["median_failed_step"].item()

    assert median(10, 20, 30, 40) == 20.0
    assert median(10, 20, None, None) == 20.0
    assert median(10, None, None, None) is None
    assert median(*range(1, 25)) == 12.0, "24 successive failures multiply to a share of 0.5000000000000001"


def test_an_evaluation_killed_between_groups_resumes_and_gives_the_table_of_one_process(
    evaluation, whole, tmp_path, monkeypatch
):
    """Four groups; the evaluation is killed after one. What was finished is not computed again."""
    small = calm(evaluation.policies, steps=60, clocks=evaluation.clocks, eval_seeds=2, max_episodes=2)

    def die(status):
        if any(key.startswith("groups") and each.state == "finished" for key, each in status.items()):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate_files(small, Execution(tmp_path, on="here", observe=die))
    done = set(Store(tmp_path).keys("groups"))
    assert 0 < len(done) < 4
    assert not (tmp_path / "episodes.parquet").exists()
    monkeypatch.setattr("perdure.runs.store.source_digest", lambda: "another")
    resumed = []
    with pytest.warns(OtherSourceWarning, match=f"{len(done)} of {len(done)}"):
        result = evaluate_files(small, Execution(tmp_path, cores=2, observe=lambda status: resumed.append(set(status))))
    assert set(Store(tmp_path).keys("groups")) == done | groups(resumed[-1])
    assert not done & resumed[-1]
    assert result.frame.equals(whole.frame)


def test_finished_episodes_are_not_run_again_however_they_were_grouped(evaluation, whole, tmp_path):
    started = []

    def extrapolated(eval_seeds, cores, **changes):
        asked = calm(evaluation.policies, steps=60, clocks=evaluation.clocks, eval_seeds=eval_seeds, **changes)
        observe = lambda status: started.append(set(status))  # noqa: E731
        return evaluate_files(asked, Execution(tmp_path, cores=cores, on="here", observe=observe))

    extrapolated(1, 2, max_episodes=3)
    first = set(Store(tmp_path).keys("groups"))
    more = extrapolated(2, 1)
    assert more.frame.equals(whole.frame)
    assert groups(started[0]) == first
    assert started[-1] == set(Store(tmp_path).keys("groups")) - first, "idle robots and references were measured before"
    episodes = [len(Store(tmp_path).config(key)["episodes"]) for key in started[-1]]
    assert sum(episodes) == 4, "one more start state of four pairs of policy and clock"
    started.clear()
    assert extrapolated(2, 2, max_episodes=1).frame.equals(whole.frame)
    assert started == []


def test_an_evaluation_into_a_folder_in_use_waits_for_the_other(evaluation, whole, tmp_path):
    waits = threading.Event()
    with Store(tmp_path).exclusive("extrapolate"):
        second = threading.Thread(
            target=lambda: evaluate_files(evaluation, Execution(tmp_path, on="here", waiting=waits.set))
        )
        second.start()
        assert waits.wait(60.0)
        assert second.is_alive()
        assert not (tmp_path / "episodes.parquet").exists()
    second.join()
    assert read_table(tmp_path / "episodes.parquet")[0].equals(read_table(whole.path)[0])


def test_one_policy_under_two_names_is_refused(policies, tmp_path):
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(policies[0].read_bytes())
    with pytest.raises(PerdureError, match="hold the same policy"):
        evaluate_files(calm((policies[0], copy), steps=5), Execution(tmp_path / "out", cores=1))


def test_a_group_of_episodes_that_cannot_be_read_is_named(evaluation, tmp_path):
    small = replace(evaluation, steps=5)
    evaluate_files(small, Execution(tmp_path, on="here"))
    store = Store(tmp_path)
    config = store.config(store.keys("groups")[0])
    with store.workspace("groups/a", {**config, "episodes": "all"}):
        pass
    with pytest.raises(PerdureError, match="groups/a"):
        evaluate_files(small, Execution(tmp_path, on="here"))


def test_the_default_clock_is_the_same_as_its_text_whatever_the_number_is_stored_as(tmp_path):
    own = replace(policy_for(HOPPER, seed=2, phi=True), clock=Constant(500))
    path = save_policy(own, tmp_path / "whole.safetensors")
    evaluate_files(calm((path,), 5, eval_seeds=1), Execution(tmp_path / "out", on="here"))
    started = []
    again = calm((path,), 5, ("constant:500",), 1)
    evaluate_files(again, Execution(tmp_path / "out", on="here", observe=started.append))
    assert started == []


@pytest.mark.parametrize("at", [0.6, 0.9])
def test_a_damaged_group_of_episodes_is_named(evaluation, tmp_path, at):
    small = replace(evaluation, steps=50)
    evaluate_files(small, Execution(tmp_path, on="here"))
    path = next(tmp_path.glob("groups/*/episodes.parquet"))
    content = bytearray(path.read_bytes())
    place = int(at * len(content))
    content[place : place + 40] = 40 * b"\xff"
    path.write_bytes(content)
    with pytest.raises(PerdureError, match="are damaged: remove its folder groups"):
        evaluate_files(small, Execution(tmp_path, on="here"))


def test_policies_of_one_run_in_two_folders_have_two_labels(tmp_path):
    """The files differ in their critic alone."""
    policy = policy_for(HOPPER, seed=1)
    paths = [tmp_path / name / "seed-0" / "policy.safetensors" for name in ("a", "b")]
    save_policy(policy, paths[0])
    save_policy(policy.without_critic(), paths[1])
    result = evaluate_files(calm(tuple(paths), 5, eval_seeds=1), Execution(on="here"))
    labels = result.frame["policy"].unique(maintain_order=True)
    assert [str(path) in label for path, label in zip(paths, labels, strict=True)] == [True, True]


@pytest.mark.parametrize("text", ["[" * 100_000, "{}", '{"zero": NaN, "random": 0}', '{"zero": "0", "random": 0}'])
def test_a_damaged_measurement_of_an_idle_robot_is_named(tmp_path, text):
    (tmp_path / "idle.json").write_text('{"zero": 1, "random": 0.5}')
    assert read_idle(tmp_path).rate == 1
    (tmp_path / "idle.json").write_text(text)
    with pytest.raises(PerdureError, match=r"idle\.json"):
        read_idle(tmp_path)


def test_a_policy_that_changes_meanwhile_is_refused(evaluation, policies, tmp_path):
    work = Work(tmp_path, 1, lambda *done, **facts: None)
    changed = Source("0" * 64, partial(read_file, policies[0], "0" * 64, "Hopper-v3", None))
    asked = {"references": [None], "episodes": [EpisodeSpec(0, None, 0, steps=5)], "worlds": Worlds("Hopper-v3")}
    with pytest.raises(PerdureError, match="has changed"):
        evaluate_group(work, sources=[changed], **asked)


def test_a_worker_that_fails_is_told_in_a_sentence_and_leaves_no_group_behind(evaluation, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(PerdureError, match="exit code 1"):
        evaluate_files(evaluation, Execution(tmp_path, cores=1))
    assert Store(tmp_path).keys("groups") == ()


class TestStarts:
    def test_the_same_evaluation_seed_starts_from_the_same_state_under_every_policy_and_clock(self):
        plain, timed = policy_for(HOPPER, seed=1), policy_for(HOPPER, seed=2, phi=True)
        episodes = [
            EpisodeSpec(policy, clock, seed, steps=3)
            for policy, clock in ((0, None), (1, Constant(5.0)), (1, Periodic(5.0)))
            for seed in (3, 4)
        ]
        asked = []

        class Watched:
            def __init__(self, task, seeds):
                self.inside = make_world(task, seeds)

            def __getattr__(self, name):
                return getattr(self.inside, name)

            def reset(self, *arguments):
                observations = self.inside.reset(*arguments)
                asked.append(observations.copy())
                return observations

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("perdure.evaluate.episodes.make_world", Watched)
            evaluate_episodes([plain, timed], episodes)
        (starts,) = asked
        by_seed = {
            seed: {starts[i].tobytes() for i, episode in enumerate(episodes) if episode.eval_seed == seed}
            for seed in (3, 4)
        }
        assert [len(states) for states in by_seed.values()] == [1, 1]
        assert by_seed[3] != by_seed[4]

    def test_an_evaluation_seed_does_not_depend_on_how_many_are_evaluated(self):
        policy = [policy_for(HOPPER)]
        many = evaluate_episodes(policy, [EpisodeSpec(0, None, seed, steps=30) for seed in range(4)])
        one = evaluate_episodes(policy, [EpisodeSpec(0, None, 2, steps=30)])
        assert one.returns[0].tobytes() == many.returns[2].tobytes()


class TestClocks:
    def clocks(self, *texts, steps=700, default=FIVE_HUNDRED):
        return list(Extrapolation(("p",), clocks=texts).deployment_clocks(default, steps))

    def test_are_read_in_order_and_each_once(self):
        found = self.clocks("countdown", "constant:5", "default", "constant(500)", "periodic:0.0", "countdown:700")
        assert found == [Countdown(700.0), Constant(5.0), Constant(500.0), Periodic(0.0)]

    def test_a_policy_without_a_clock_of_its_own_has_no_default(self):
        assert self.clocks("default", "constant:1", default=None) == [Constant(1.0)]

    def test_the_sweep_is_the_thesis_grid_with_the_countdown(self):
        found = self.clocks("sweep")
        hundreds = [100.0 * i for i in range(11)]
        assert [c.steps for c in found if isinstance(c, Constant)] == hundreds
        assert [c.steps for c in found if isinstance(c, Periodic)] == hundreds[1:]
        assert [c.steps for c in found if isinstance(c, Countdown)] == [700.0]
        assert len(found) == 22

    @pytest.mark.parametrize("text", ["constant:-1", "constant", "sundial:3", "periodic:x", ""])
    def test_that_make_no_sense_are_refused_at_the_door(self, text):
        with pytest.raises(PerdureError):
            self.clocks(text)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"steps": 0}, "steps"),
        ({"eval_seeds": 0}, "eval_seeds"),
        ({"max_episodes": 0}, "max_episodes"),
        ({"clocks": ()}, "clock"),
        ({"policies": "mine"}, "policies must be a tuple, got 'mine'"),
        ({"policies": (3,)}, "policies must be a list or tuple of strings or paths"),
        ({"clocks": "constant:5"}, "clocks must be a tuple, got 'constant:5'"),
        ({"clocks": (5,)}, "clocks must be a list or tuple of strings"),
        ({"modules": "mine"}, "modules must be a tuple, got 'mine'"),
        ({"steps": 1.5}, "steps must be a whole number, got 1.5"),
        ({"first_eval_seed": 2**31 - 1}, r"first_eval_seed \+ eval_seeds must be at most 2146483648, got 2147483647"),
    ],
)
def test_an_evaluation_of_nothing_is_refused_by_name(policies, change, word):
    with pytest.raises(PerdureError, match=word):
        Extrapolation(**({"policies": policies} | change))


def test_an_evaluation_of_no_file_is_refused():
    with pytest.raises(PerdureError, match="name at least one policy file"):
        evaluate_files(Extrapolation())


def test_a_folder_is_no_execution(tmp_path):
    with pytest.raises(PerdureError, match="must be an Execution"):
        evaluate_files(calm((Path("Hopper-v3/ppo"),), 5), tmp_path)


def test_a_policy_may_be_a_name_a_folder_or_text_and_steps_a_whole_float(policies, tmp_path):
    """The episodes are those of the files: none is run again."""
    (tmp_path / "mine").mkdir()
    mine = shutil.copy(policies[0], tmp_path / "mine" / "policy.safetensors")
    named = calm((Path("Hopper-v3/ppo"), str(tmp_path / "mine")), 2e1, eval_seeds=1)
    first = evaluate_files(named, Execution(tmp_path / "out", on="here"))
    started = []
    files = calm((find_policy("Hopper-v3/ppo"), mine), 20, eval_seeds=1)
    again = evaluate_files(files, Execution(tmp_path / "out", on="here", observe=started.append))
    assert again.frame.equals(first.frame)
    assert started == []


def test_policies_for_two_tasks_are_refused(policies, tmp_path):
    other = save_policy(policy_for(TaskInfo("Swimmer-v3", 8, (-1.0,) * 2, (1.0,) * 2)), tmp_path / "swimmer")
    with pytest.raises(PerdureError, match=r"Hopper-v3, Swimmer-v3"):
        evaluate_files(calm((policies[0], other), steps=5), Execution(tmp_path / "out"))


def test_one_robot_in_two_engines_is_refused_with_a_way_out(policies, tmp_path):
    theirs = save_policy(policy_for(TaskInfo("gymnasium:Hopper-v3", 11, (-1.0,) * 3, (1.0,) * 3)), tmp_path / "hopper")
    way_out = "read models with --env envpool:Hopper-v3; for Gymnasium's, train in gymnasium:Hopper-v3"
    with pytest.raises(PerdureError, match=way_out):
        evaluate_files(Extrapolation((policies[0], theirs), steps=5), Execution(tmp_path / "out"))


@given(episodes=st.integers(1, 300), size=st.integers(1, 60), parts=st.integers(1, 9))
def test_groups_hold_every_episode_once_even_and_small_enough_each_with_its_share_of_a_policy(episodes, size, parts):
    every = [EpisodeSpec(2 * seed // episodes, None, seed) for seed in range(episodes)]
    groups = split(every, size, parts)
    assert sorted((episode for group in groups for episode in group), key=lambda each: each.eval_seed) == every
    first = [sum(each.policy == 0 for each in group) for group in groups]
    assert max(first) - min(first) <= 1
    lengths = [len(group) for group in groups]
    assert max(lengths) <= size
    assert max(lengths) - min(lengths) <= 1
    assert len(groups) % parts == 0 or len(groups) == episodes  # no worker idles while another has its last group


def test_a_policy_file_imports_no_module_that_the_user_has_not_named(tmp_path, monkeypatch):
    name = "perdure_test_hostile"
    trace = tmp_path / "imported"
    (tmp_path / f"{name}.py").write_text(f"import pathlib; pathlib.Path({str(trace)!r}).touch()")
    monkeypatch.syspath_prepend(tmp_path)
    task = TaskInfo(f"gymnasium:{name}:Id-v0", 11, (-1.0,) * 3, (1.0,) * 3)
    policy = save_policy(policy_for(task, seed=1), tmp_path / "policy.safetensors")
    with pytest.raises(ValueError, match=f"imports the Python module {name}; .* --modules {name}"):
        evaluate_files(calm((policy,), 10), Execution(tmp_path / "out", cores=1))
    assert not trace.exists()
    with pytest.raises(ValueError, match="no task named"):
        evaluate_files(calm((policy,), 10, modules=(name,)), Execution(tmp_path / "out", cores=1))
    assert trace.exists()


def test_a_disturbed_evaluation_does_not_replace_the_calm_one_and_resumes(tmp_path):
    """Calm episodes in one folder are not taken for disturbed ones; the same draws come whatever runs beside."""
    run = partial(Extrapolation, (Path("Hopper-v3/ppo"),), 300, eval_seeds=2)
    quiet = evaluate_files(run(disturb=("none",)), Execution(tmp_path, on="here")).final
    both = ("push:0", "action_noise:0.2")
    with pytest.raises(PerdureError, match="another evaluation, which would be replaced"):
        evaluate_files(run(disturb=both), Execution(tmp_path, on="here"))
    noisy = evaluate_files(run(disturb=both), Execution(tmp_path / "noisy", on="here")).final
    assert quiet["disturbance"].unique().to_list() == ["none"]
    assert noisy["disturbance"].unique().to_list() == ["action_noise:0.2 push:0"]
    assert (noisy["return"] != quiet["return"]).all()
    alone = evaluate_files(run(disturb=both[::-1], max_episodes=1), Execution(tmp_path / "again", on="here")).final
    assert alone["return"].equals(noisy["return"])
    folder = tmp_path / "noisy"
    again = evaluate_files(
        run(disturb=both), Execution(folder, observe=lambda status: pytest.fail("nothing is left to run"))
    )
    assert again.final["return"].equals(noisy["return"])
    assert "ppo under action_noise:0.2 push:0" in str(again)


def test_other_rules_replace_the_verdicts_of_a_stored_evaluation_without_a_step(evaluation, tmp_path, monkeypatch):
    started = []
    before = evaluate_files(evaluation, Execution(tmp_path, on="here"))
    monkeypatch.setattr("perdure.evaluate.verdict.LEAST_GAIN", -100.0)
    monkeypatch.setattr("perdure.evaluate.verdict.LEAST_SCORE", -100.0)
    after = evaluate_files(
        evaluation, Execution(tmp_path, on="here", observe=lambda status: started.append(set(status)))
    )
    assert started == []
    assert "worked" not in set(before.frame["policy_state"])
    assert set(after.frame["policy_state"]) == {"worked"}
    assert after.frame.select(RAW).equals(before.frame.select(RAW))
    judged, _ = read_judged(after.path)
    assert set(judged[0].facts["policy_state"]) == {"worked"}


def test_other_raw_columns_are_simulated_again(policies, tmp_path, monkeypatch):
    small = calm(policies[:1], steps=5, eval_seeds=1)
    evaluate_files(small, Execution(tmp_path, on="here"))
    before = set(Store(tmp_path).keys("groups"))
    monkeypatch.setattr("perdure.evaluate.units.RAW_VERSION", "another")
    evaluate_files(small, Execution(tmp_path, on="here"))
    assert len(before) == 1
    assert len(set(Store(tmp_path).keys("groups")) - before) == 1
