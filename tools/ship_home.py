"""Ship trained home policies, and score them.

python tools/ship_home.py RUNS

RUNS is the `--out` of `perdure home train`. Every policy there goes to src/perdure/policy/shipped/home, without its
critic (acting does not need it) and with weights of 16 bits; other seeds of the same name, of an earlier training, go.
As shipped it runs from 400 val starts with clutter. The scores enter tools/home_skills.json and the table in
docs/home/training.md.
"""

from __future__ import annotations

import json
import re
import sys
from itertools import product
from pathlib import Path
from typing import Any

from marks import put

from perdure.envs.suites import parse_options
from perdure.home.evaluate.policies import LEARNED_ON, SHIPPED, TIMED, read_release, shipped_seeds
from perdure.home.skills import get_skill, learned_skills
from perdure.home.skills.environment import targets_of
from perdure.home.skills.place import variant_name
from perdure.home.skills.starts import fingerprint
from perdure.home.skills.train import evaluate_skill
from perdure.home.tasks.tasks import TASKS
from perdure.policy import Policy, load_policy, save_policy
from perdure.runs import file_digest, write_atomic

HERE = Path(__file__).parent
SCORES = HERE / "home_skills.json"
PAGE = HERE.parent / "docs" / "home" / "training.md"
EPISODES = 400


def runs(folder: Path) -> dict[str, Path]:
    """Finished runs by the name they ship under, such as "set_table/place-gentle/seed-0".

    Whatever was trained otherwise than a recipe or a variant says ends the program.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.glob("perdure/*/*/seed-*")):
        named = re.fullmatch(r"Home\w+-v0,(.*)", path.parent.parent.name)
        skill, _, method = path.parent.name.partition("-")
        if named is None or skill not in learned_skills():
            sys.exit(f"{path} is no run of a recipe or a variant")
        options = parse_options(named[1])
        task = options.pop("task", "")
        usual = get_skill(skill).recipe_on(task).env_options
        own = {name: value for name, value in options.items() if usual.get(name) != value}
        variant: str | None = method
        fits = usual.items() <= options.items()
        if method:
            fits = fits and skill == "place" and method in TIMED and not own
        elif own:
            variant = variant_name(own)
        if variant is None or not fits:
            sys.exit(f"{path} is no run of a recipe or a variant")
        name = f"{skill}-{variant}" if variant else skill
        found[f"{task}/{name}/{path.name}"] = path
    return found


def score(policy: Policy, task: str, name: str) -> dict[str, Any]:
    """From val starts, with clutter."""
    skill, _, variant = name.partition("-")
    options = {}
    if variant:
        options = read_release(variant).options
    result = evaluate_skill(policy, skill, EPISODES, task=task, **options)
    return {"success": result.rate, "episodes": len(result.success), "failures": dict(result.failures.most_common())}


def lent(scores: dict[str, dict[str, Any]]) -> None:
    """How well policies that are learned on one task for all do on the others."""
    for skill, home in LEARNED_ON.items():
        others = [name for name, task in TASKS.items() if name != home and targets_of(skill, task)]
        for task, seed in product(others, shipped_seeds(home, skill)):
            name = f"{task}/{skill}/seed-{seed}"
            path = shipped_seeds(task, skill)[seed]
            if path.parent.parent.name != task and name not in scores:
                scores[name] = {"learned_on": home, **score(load_policy(path), task, skill)}


def main(folder: Path) -> None:
    """Score, ship, print."""
    found = runs(folder)
    scores = json.loads(SCORES.read_text())
    renewed = {(task, skill) for task, skill, _ in (name.split("/") for name in found)}
    for name, entry in list(scores.items()):
        task, skill, _ = name.split("/")
        if name in found or (entry.get("learned_on", task), skill) not in renewed:
            continue
        (SHIPPED / f"{name}.safetensors").unlink(missing_ok=True)
        del scores[name]
    for name, path in found.items():
        scored_before = {"run": file_digest(path / "policy.safetensors"), "world": fingerprint()}
        if scored_before.items() <= scores.get(name, {}).items():  # this program was stopped after that
            continue
        task, skill, _ = name.split("/")
        trained = load_policy(path / "policy.safetensors")
        steps = trained.provenance["config"]["total_steps"]
        if steps != get_skill(skill.partition("-")[0]).recipe_on(task).total_steps:
            sys.exit(f"{path} was not trained for the steps of its recipe")
        policy = trained.without_critic().halved()
        target = SHIPPED / f"{name}.safetensors"
        target.parent.mkdir(parents=True, exist_ok=True)
        save_policy(policy, target)
        made = {"command": policy.provenance["command"], "steps": steps, **scored_before}
        scores[name] = {**made, **score(policy, task, skill)}
        _write(scores)
    lent(scores)
    _write(scores)
    text = table(scores)
    write_atomic(PAGE, put(PAGE.read_text(), "scores", text))
    print(text)


def table(scores: dict[str, dict[str, Any]]) -> str:
    """One row for each policy, all its seeds in it, in Markdown."""
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name, entry in sorted(scores.items(), key=lambda item: (list(TASKS).index(item[0].split("/")[0]), item[0])):
        task, policy, _ = name.split("/")
        rows.setdefault((task, policy), []).append(entry)
    lines = ["| task | policy | success, seed by seed |", "|---|---|---|"]
    for (task, policy), entries in rows.items():
        rates = ", ".join(f"{entry['success']:.3f}" for entry in entries)
        lines.append(f"| {task} | {policy} | {rates} |")
    return "\n".join(lines)


def _write(scores: dict[str, dict[str, Any]]) -> None:
    write_atomic(SCORES, json.dumps(dict(sorted(scores.items())), indent=1) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
