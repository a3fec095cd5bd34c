"""Model cards: their numbers are those of the table, their front matter is YAML that a parser reads."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
import yaml
from scripted import policy_for

import perdure
from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.card import write_card
from perdure.policy import TaskInfo, find_policy, load_policy, save_policy
from perdure.report import read_table, write_table
from perdure.report.outcomes import MissesGoal, ReachesGoal

HOPPER = TaskInfo("Hopper-v3", 11, (-1.0,) * 3, (1.0,) * 3)
STEPS = 100


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A policy's file, its table and its card."""
    folder = tmp_path_factory.mktemp("card")
    policy = save_policy(policy_for(HOPPER, seed=2, phi=True, method="true"), folder / "policy.safetensors")
    other = save_policy(policy_for(HOPPER, seed=3, method="other"), folder / "elsewhere" / "other.safetensors")
    asked = Extrapolation((policy, other), STEPS, ("constant:500", "constant:0"), eval_seeds=6, disturb=("none",))
    result = evaluate_files(
        asked, Execution(folder / "out", on="here", command="perdure extrapolate policy.safetensors")
    )
    card = write_card(policy, result.path)
    return policy, result, card


def front_matter(card):
    return yaml.safe_load(re.match(r"---\n(.*?)\n---\n", card.read_text(), re.DOTALL)[1])


def test_it_lies_beside_the_policy_and_has_what_hugging_face_reads(made):
    policy, _, card = made
    assert card == policy.parent / "README.md"
    found = front_matter(card)
    assert (found["library_name"], found["pipeline_tag"]) == ("perdure", "reinforcement-learning")
    assert {"reinforcement-learning", "Hopper-v3"} <= set(found["tags"])
    (model,) = found["model-index"]
    assert model["name"] == "true on Hopper-v3"
    assert model["results"][0]["dataset"] == {"name": "Hopper-v3", "type": "Hopper-v3"}


def test_it_names_the_module_of_a_task_of_ones_own(made, tmp_path):
    policy = load_policy(made[0])
    for task, words in {"Hopper-v3": "policy.safetensors`", "gymnasium:my_tasks:A-v0": "--modules my_tasks`"}.items():
        file = save_policy(replace(policy, task=replace(policy.task, name=task)), tmp_path / "policy.safetensors")
        notes = {"sha256 of true, training seed 2": hashlib.sha256(file.read_bytes()).hexdigest()}
        write_table(tmp_path / "episodes.parquet", read_table(made[1].path)[0], notes)
        card = write_card(file, tmp_path / "episodes.parquet", tmp_path / task / "card.md")
        assert f"{words} evaluates it again" in card.read_text()


@pytest.mark.parametrize(("command", "shown"), [("", False), ("perdure train Hopper-v3", True)])
def test_a_training_command_is_shown_where_there_is_one(made, tmp_path, command, shown):
    policy = load_policy(made[0])
    policy = replace(policy, provenance=policy.provenance | {"command": command})
    file = save_policy(policy, tmp_path / "policy.safetensors")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    notes = {"sha256 of true, training seed 2": digest}
    write_table(tmp_path / "episodes.parquet", read_table(made[1].path)[0], notes)
    text = write_card(file, tmp_path / "episodes.parquet").read_text()
    assert ("- command: `perdure train Hopper-v3`" in text, "- command" in text) == (shown, shown)


def test_its_metrics_are_those_of_the_table(made):
    _, result, card = made
    metrics = front_matter(card)["model-index"][0]["results"][0]["metrics"]
    assert len(metrics) == 4
    for clock in ("constant(500)", "constant(0)"):
        episodes = result.final.filter((pl.col("policy") == "true") & (pl.col("clock") == clock))
        share, mean = (each for each in metrics if each["name"].endswith(f"{STEPS} steps, clock {clock}"))
        assert share["value"] == pytest.approx((episodes["outcome"] == "holds").mean(), abs=1e-4)
        assert (share["args"]["n"], share["args"]["interval_method"]) == (6, "Clopper-Pearson")
        assert mean["value"] == pytest.approx(episodes["return"].mean(), abs=1e-3)
        low, high = mean["args"]["interval"]
        margin = 2.5706 * episodes["return"].std() / np.sqrt(6)  # Student's t, 5 degrees of freedom
        assert (high - low) / 2 == pytest.approx(margin, rel=1e-3)
    assert "other" not in card.read_text().split("## Limits")[0]


def test_it_knows_of_a_goal_that_only_another_policy_of_its_table_reaches(made, tmp_path):
    policy, result, _ = made
    reached = pl.when(pl.col("method") == "other").then(pl.lit(ReachesGoal.name)).otherwise(pl.lit("holds"))
    frame, notes = read_table(result.path)
    table = write_table(tmp_path / "episodes.parquet", frame.with_columns(outcome=reached), notes)
    assert MissesGoal.name in write_card(policy, table, tmp_path / "card.md").read_text()
    assert MissesGoal.name not in made[2].read_text()


def test_it_has_every_section_and_its_example_runs(made):
    policy, _, card = made
    text = card.read_text()
    for heading in ("Does it hold?", "Training", "Limits", "How to use it", "How the verdict was made"):
        assert f"\n## {heading}\n" in text
    example = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    done = subprocess.run(
        [sys.executable, "-c", example + "\nprint(actions.shape)"], cwd=policy.parent, capture_output=True, text=True
    )
    assert done.stdout.strip() == "(1, 3)", done.stderr


def test_a_card_is_written_again_but_another_readme_is_left_alone(made, tmp_path):
    policy, result, card = made
    before = card.read_bytes()
    assert write_card(policy.parent / "policy.safetensors", result.path).read_bytes() == before
    strange = tmp_path / "README.md"
    for text in ("# My project\nlibrary_name: perdure\n", "---\nlibrary_name: theirs\n---\nlibrary_name: perdure\n"):
        strange.write_text(text)
        with pytest.raises(PerdureError, match="is no model card of this policy"):
            write_card(policy, result.path, strange)
        assert strange.read_text() == text


def test_a_table_that_does_not_name_its_files_is_refused(made, tmp_path):
    policy, result, _ = made
    with pytest.raises(PerdureError, match=r"holds no episode of .*evaluate this file"):
        write_card(policy, write_table(tmp_path / "episodes.parquet", result.frame, {}))


def test_another_file_of_the_same_training_gets_no_card(made, tmp_path):
    policy, result, _ = made
    subject = load_policy(policy)
    zero = replace(subject, weights={name: np.zeros_like(each) for name, each in subject.weights.items()})
    path = save_policy(zero, tmp_path / "zero.safetensors")
    theirs, evaluated = (hashlib.sha256(each.read_bytes()).hexdigest()[:12] for each in (path, policy))
    with pytest.raises(PerdureError, match=rf"{path} \(SHA-256 {theirs}\).*true.*\({evaluated}\)"):
        write_card(path, result.path)


def test_every_table_of_a_policy_file_says_which_file_it_is_of(made, tmp_path):
    policy, result, _ = made
    result.write(tmp_path / "copy")
    perdure.extrapolate(policy, steps=STEPS, eval_seeds=1, disturb="none", out=tmp_path / "one", on="here")
    for folder in (result.path.parent, tmp_path / "copy", tmp_path / "one"):
        notes = read_table(folder / "episodes.parquet")[1]
        assert notes["sha256 of true, training seed 2"] == hashlib.sha256(policy.read_bytes()).hexdigest()


def test_policies_of_one_folder_have_a_card_each(made, tmp_path):
    policy, result, _ = made
    for name in ("a", "b"):
        shutil.copy(policy, tmp_path / f"{name}.safetensors")
    names = [write_card(tmp_path / f"{name}.safetensors", result.path).name for name in ("a", "b")]
    assert names == ["a.README.md", "b.README.md"]


def test_no_card_is_written_into_the_package_or_into_the_cache_of_downloads(made, tmp_path):
    policy, result, _ = made
    downloaded = tmp_path / "models--lab--hopper" / "snapshots" / "abc" / "policy.safetensors"
    downloaded.parent.mkdir(parents=True)
    shutil.copy(policy, downloaded)
    for file in (downloaded, find_policy("Hopper-v3/ppo")):
        with pytest.raises(PerdureError, match=f"{file}.*name a file with --out"):
            write_card(file, result.path)
    assert write_card(downloaded, result.path, tmp_path / "card.md").is_file()
