"""Judging stored episodes again: by other rules and with new outcomes, without a simulator."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scripted import SCRIPTED, Script, policy_for, world_of

from perdure.errors import PerdureError, PerdureWarning
from perdure.evaluate import EpisodeSpec, ExtrapolationResult, evaluate_episodes
from perdure.evaluate.judge import (
    BASELINES,
    Baseline,
    judge_table,
    make_scales,
    other_engine,
    read_baselines,
    read_judged,
)
from perdure.evaluate.reference import Idle, idle_baseline, task_env
from perdure.evaluate.table import TABLE_FILE, episode_table, with_not_applied
from perdure.policy import Reference
from perdure.report import read_episodes
from perdure.report.schema import JUDGED, RAW
from perdure.report.work import WORK

RESULTS = Path(__file__).parents[2] / "results"
CALM_STEPS, DISTURBED_STEPS = 400, 200
SLOW, SLOWER = 0.72, 0.6
"""Scores of disturbed episodes: an idle robot earns nothing here, and the policy 1 a step in training."""


def baseline(policy):
    """Twenty reference episodes of 100 steps that earn 1 a step; an idle robot earns nothing."""
    size = policy.task.observation_size
    lengths = np.full(20, 100)
    rewards = np.full((20, 10), 10.0)
    reference = Reference(100, rewards, lengths, np.zeros(20, bool), -np.ones(size), np.ones(size))
    return Baseline(reference, Idle(0.0, -1.0))


def rows(rates, steps, label):
    """Raw rows of one episode for each rate of reward."""
    policy = policy_for(SCRIPTED)
    episodes = [EpisodeSpec(0, None, seed, steps=steps, label=label) for seed in range(len(rates))]
    scripts = [Script(reward=lambda step, rate=rate: rate) for rate in rates]
    records = evaluate_episodes([policy], episodes, world=world_of(scripts))
    return episode_table(["ppo"], [policy], episodes, records)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three calm episodes, and 36 disturbed ones of which 24 are a little and 12 clearly slower than in training."""
    policy = policy_for(SCRIPTED)
    raw = pl.concat(
        [rows([1.0] * 3, CALM_STEPS, "none"), rows([SLOW] * 24 + [SLOWER] * 12, DISTURBED_STEPS, "standard-1")]
    )
    baselines = {("ppo", 0): baseline(policy)}
    frame = judge_table(with_not_applied(raw, []), make_scales(baselines, "scripted"))
    out = tmp_path_factory.mktemp("stored")
    ExtrapolationResult(frame, None, baselines=baselines).write(out)
    return out


AGAIN = """
import sys

class Simulators:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("mujoco", "envpool", "gymnasium", "jax"):
            raise ImportError(f"{name} is not there")

sys.meta_path.insert(0, Simulators())
import perdure.report.scores

perdure.report.scores.HOLDS_FROM = float(sys.argv[1])
"""
REPORT = (
    AGAIN
    + """
from perdure.__main__ import main

main(["report", sys.argv[2], "--out", sys.argv[3]])
"""
)


def run(script, *arguments):
    done = subprocess.run([sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize(("threshold", "outcomes"), [(0.75, "decays 36"), (0.7, "holds 24, decays 12")])
def test_another_threshold_judges_stored_episodes_again_without_a_simulator(folder, tmp_path, threshold, outcomes):
    before = (folder / TABLE_FILE).read_bytes()
    done = run(REPORT, threshold, folder, tmp_path)
    lines = done.stdout.splitlines()
    assert [line.endswith("holds 3") for line in lines if line.startswith("ppo  ")] == [True]
    (disturbed,) = [line for line in lines if line.startswith("ppo under standard-1  ")]
    assert disturbed.endswith(outcomes)
    assert ("24 of 39 episodes have another outcome" in done.stderr) == (threshold != 0.75)
    assert (folder / TABLE_FILE).read_bytes() == before
    assert outcomes in (tmp_path / "report.html").read_text()


def test_the_same_rules_give_the_same_columns(folder):
    stored, _ = read_episodes(folder / TABLE_FILE)
    judged, _ = read_judged(folder / TABLE_FILE)
    assert [part.facts.columns for part in judged] == [part.facts.columns for part in stored]
    assert all(new.facts.equals(old.facts) for new, old in zip(judged, stored, strict=True))


def test_every_column_is_raw_or_judged(folder):
    raw = rows([1.0], DISTURBED_STEPS, "none")
    assert {*raw.columns, "not_applied"} == set(RAW)
    scale = make_scales({("ppo", 0): baseline(policy_for(SCRIPTED))}, "scripted")
    assert judge_table(raw, scale).columns == [*raw.columns, *JUDGED]


def test_baselines_come_back_from_their_file(folder):
    ((key, found),) = read_baselines(folder / BASELINES).items()
    written = baseline(policy_for(SCRIPTED))
    assert (key, found.idle, found.reference.horizon) == (("ppo", 0), written.idle, 100)
    for name in ("rewards", "lengths", "terminated"):
        np.testing.assert_array_equal(getattr(found.reference, name), getattr(written.reference, name))


def copied(folder, out, content=None):
    (out / TABLE_FILE).write_bytes((folder / TABLE_FILE).read_bytes())
    if content is not None:
        (out / BASELINES).write_bytes(content)
    return out / TABLE_FILE


def test_a_table_without_baselines_keeps_its_verdicts(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("perdure.report.scores.HOLDS_FROM", 0.7)
    found, _ = read_judged(copied(folder, tmp_path))
    assert found[1].facts["outcome"].to_list() == ["decays"] * 36


def test_baselines_of_another_table_are_refused(folder, tmp_path):
    content = bytearray((folder / BASELINES).read_bytes())
    content[len(content) // 2] ^= 1
    with pytest.raises(PerdureError, match=BASELINES):
        read_judged(copied(folder, tmp_path, bytes(content)))


def test_a_damaged_file_of_baselines_is_named(tmp_path):
    (tmp_path / BASELINES).write_bytes(b"PAR1")
    with pytest.raises(PerdureError, match=BASELINES):
        read_baselines(tmp_path / BASELINES)


def test_an_episode_of_an_unknown_policy_is_refused():
    with pytest.raises(PerdureError, match="'ppo', training seed 0"):
        judge_table(rows([1.0], DISTURBED_STEPS, "none"), {})


def test_a_changed_outcome_is_said(folder, monkeypatch):
    monkeypatch.setattr("perdure.report.scores.HOLDS_FROM", 0.5)
    with pytest.warns(PerdureWarning, match="36 of 39"):
        found, _ = read_judged(folder / TABLE_FILE)
    assert set(found[1].facts["outcome"]) == {"holds"}


@pytest.mark.parametrize("name", ["go2", "g1"])
def test_a_committed_table_without_baselines_is_read(name):
    path = RESULTS / "robots" / f"{name}.parquet"
    stored, _ = read_episodes(path)
    judged, _ = read_judged(path)
    for new, old in zip(judged, stored, strict=True):
        assert new.facts.drop(WORK).equals(old.facts.drop(WORK))
        assert old.facts["work_vs_calm"].is_nan().all(), "it was written before there was such a column"
        gain = old.facts["training_rate"] - old.facts["idle_rate"]  # it has no calm episodes
        earned = old.returns[:, -1] - (old.facts["idle_rate"] * old.facts["end_step"]).to_numpy()
        expected = earned / (gain * old.facts["test_horizon"]).to_numpy()
        np.testing.assert_allclose(new.facts["work_vs_calm"], expected)


LIMPS = (
    AGAIN
    + """
from dataclasses import dataclass
from pathlib import Path
from perdure.report.outcomes import Advice, Color, EpisodeOutcome, find_advice

@dataclass(frozen=True)
class Limps(EpisodeOutcome):
    name = "limps"
    good = False
    order = 0
    meaning = "it is a little slower than in training"
    color = Color("#123456", "#abcdef")
    advice = Advice("Look at its legs.", "fails-silently-or-decays")

    def applies(self, episode):
        return episode.comparable and 0.7 <= episode.last < 0.75

    def failed_step(self, episode):
        return episode.decay_step

from perdure.evaluate.judge import read_judged
from perdure.evaluate.table import ExtrapolationResult
from perdure.report import estimate_table, read_table, summary_text, write_report, write_table

path = Path(sys.argv[2])
out = Path(sys.argv[3])
episodes, notes = read_judged(path / "episodes.parquet")
estimates = estimate_table(episodes)
print(summary_text(estimates))
print(find_advice("limps").sentence)
write_report(estimates, out, "", ())

# A table may hold the word.
frame, notes = read_table(path / "episodes.parquet")
import polars as pl
frame = frame.with_columns(outcome=pl.lit("limps"))
write_table(out / "episodes.parquet", frame, {})
frame, notes = read_table(out / "episodes.parquet")
print(ExtrapolationResult(frame, None).summary["limps"].to_list())
"""
)


def test_an_outcome_of_another_package_is_judged_sorted_and_shown_with_its_color_and_advice(folder, tmp_path):
    """One class: no other file knows the word."""
    said = run(LIMPS, 0.75, folder, tmp_path).stdout
    assert "under standard-1 half of the episodes fail from the start" in said.splitlines()[0]
    assert "ppo under standard-1: limps in 24 of 36 episodes" in said
    assert "limps 24, decays 12" in said
    assert said.splitlines()[-1] == "[1.0, 1.0]"
    page = (tmp_path / "report.html").read_text()
    assert "<b class='word' style='--light: #123456; --dark: #abcdef'>limps</b>" in page
    assert "<em>Limps</em>: it is a little slower than in training." in page
    assert said.splitlines()[-2] == "Look at its legs."


def test_baselines_of_an_earlier_version_are_read(folder, tmp_path):
    """They do not say how long an idle robot lasts, nor in what the policy was trained."""
    older = pl.read_parquet(folder / BASELINES).drop("idle_zero_steps", "idle_random_steps", "other_engine")
    older.write_parquet(tmp_path / BASELINES)
    (found,) = read_baselines(tmp_path / BASELINES).values()
    assert np.isnan(found.idle.steps)
    assert found.other_engine == ""


@pytest.mark.parametrize(
    ("trained", "judged", "differs"),
    [
        ("EnvPool 1.2.5, MuJoCo 3.6.0", "Gymnasium 1.4.0, MuJoCo 3.6.0", False),
        ("EnvPool 1.2.5, MuJoCo 2.1.0", "Gymnasium 1.4.0, MuJoCo 3.6.0", True),
        ("Isaac Lab 2.1", "Gymnasium 1.4.0, MuJoCo 3.6.0", True),
        ("", "Gymnasium 1.4.0, MuJoCo 3.6.0", False),
    ],
)
def test_only_another_mujoco_is_another_simulator(trained, judged, differs):
    assert bool(other_engine(trained, judged)) == differs


def test_an_idle_cart_pole_falls_at_once():
    assert idle_baseline(task_env("gymnasium:CartPole-v1")).steps < 100
