"""Which runs ship, and under which name."""

import json
import shutil
from importlib import import_module
from pathlib import Path

import pytest

from perdure.home.evaluate.policies import shipped_seeds

ENV = "perdure/Home{}-v0,task=set_table,training=True{}"


@pytest.fixture
def ship(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "tools")
    return import_module("ship_home")


def runs(ship, tmp_path, *named):
    for skill, options, folder in named:
        (tmp_path / ENV.format(skill, options) / folder / "seed-0").mkdir(parents=True)
    return sorted(ship.runs(tmp_path))


def test_a_run_ships_under_the_name_of_its_variant(ship, tmp_path):
    found = runs(
        *(ship, tmp_path),
        *(("Place", "", "place"), ("Place", ",gentle=True", "place"), ("Place", ",delta=200", "place")),
        *(("Place", "", "place-geometric"), ("Pick", ",clutter=True", "pick")),
    )
    names = ("pick", "place", "place-delta-200", "place-gentle", "place-geometric")
    assert found == sorted(f"set_table/{name}/seed-0" for name in names)


@pytest.mark.parametrize(
    "foreign",
    [
        ("Place", ",delta=1", "place"),
        ("Place", ",gentle=True", "place-linear"),
        ("Place", "", "place-ppo-average-reward"),
        ("Pick", ",clutter=True", "pick-geometric"),
        ("Pick", "", "pick"),  # trained without clutter
        ("Place", ",split=val", "place"),
        ("Place", "", "juggle"),
    ],
)
def test_what_no_recipe_makes_is_refused(ship, tmp_path, foreign):
    with pytest.raises(SystemExit, match="is no run of a recipe or a variant"):
        runs(ship, tmp_path, foreign)


def test_what_is_trained_ships_and_replaces_an_earlier_training(ship, tmp_path, monkeypatch, capsys):
    """Scores are scripted by file; the policies are real ones that were shipped."""
    runs, shipped, scores, page = (tmp_path / name for name in ("runs", "shipped", "scores.json", "page.md"))
    page.write_text("<!-- scores: begin -->\n<!-- scores: end -->\n")
    rates = {}
    for seed, (skill, task, options, rate) in enumerate(
        [
            ("Pick", "set_table", ",clutter=True", 0.91),
            ("Navigate", "set_table", "", 0.89),
            ("Place", "tidy_house", "", 0.2),
        ]
    ):
        folder = runs / f"perdure/Home{skill}-v0,task={task},training=True{options}/{skill.lower()}/seed-{seed}"
        folder.mkdir(parents=True)
        shutil.copy(shipped_seeds(task, skill.lower())[0], folder / "policy.safetensors")
        rates[task, skill.lower()] = rate
    names = (
        "set_table/pick/seed-7",
        "set_table/navigate/seed-7",
        "tidy_house/navigate/seed-7",
        "set_table/close_drawer/seed-7",
    )
    scores.write_text(json.dumps({name: {"success": 1.0, "learned_on": "set_table"} for name in names}))
    for name in names:
        (shipped / name).parent.mkdir(parents=True, exist_ok=True)
        (shipped / f"{name}.safetensors").touch()
    scored = []

    def score(policy, task, name):
        scored.append((task, name))
        return {"success": rates[task, name], "episodes": 400, "failures": {}}

    for name, value in {
        "SHIPPED": shipped,
        "SCORES": scores,
        "PAGE": page,
        "score": score,
        "lent": lambda _: None,
    }.items():
        monkeypatch.setattr(ship, name, value)
    for _ in range(2):  # what was scored before a stop is not scored again
        ship.main(runs)
    assert sorted(scored) == sorted(rates)
    kept = {f"set_table/{name}" for name in ("pick/seed-0", "close_drawer/seed-7", "navigate/seed-1")}
    kept.add("tidy_house/place/seed-2")
    assert {str(path.relative_to(shipped).with_suffix("")) for path in shipped.rglob("*.safetensors")} == kept
    assert set(json.loads(scores.read_text())) == kept
    assert "| set_table | pick | 0.910 |" in page.read_text()


def test_a_lent_policy_is_scored_on_the_tasks_whose_plan_uses_its_skill(ship, monkeypatch):
    """Doors are opened in SetTable's plan alone; navigate drives in all three."""
    monkeypatch.setattr(ship, "score", lambda policy, task, name: {"success": 1.0})
    scores = {}
    ship.lent(scores)
    assert {name.rsplit("/", 1)[0] for name in scores} == {"tidy_house/navigate", "prepare_groceries/navigate"}
    assert all(entry["learned_on"] == "set_table" for entry in scores.values())
