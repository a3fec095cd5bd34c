"""Score trained home policies, and ship those that are good enough.

python tools/ship_home.py RUNS [seed ...]
python tools/ship_home.py again [task/policy/seed ...]

RUNS is the `--out` of `perdure home train`. Every policy there runs from 400 val starts with clutter. A place policy
also runs in the world `drag`. The scores enter tools/home_skills.json and the table in docs/home/training.md. A policy
that succeeds often enough goes to src/perdure/policy/shipped/home, without its critic (acting does not need it) and
with weights of 16 bits, as it is scored. `again` scores shipped policies anew, after a change of the world.
"""

from __future__ import annotations

import json
import re
import sys
from itertools import product
from pathlib import Path
from typing import Any

from marks import put

from perdure.home.evaluate.policies import LEARNED_ON, SHIPPED, read_release, shipped_seeds
from perdure.home.skills import learned_skills
from perdure.home.skills.train import evaluate_skill
from perdure.home.tasks.tasks import TASKS
from perdure.policy import Policy, load_policy, save_policy
from perdure.runs import write_atomic

HERE = Path(__file__).parent
SCORES = HERE / "home_skills.json"
PAGE = HERE.parent / "docs" / "home" / "training.md"
WORTH_SHIPPING = 0.90
"""Success of a policy that ships; below it the oracle acts better. One that places ships whatever it reaches:
how it lets go is what release strategies are compared by."""
EPISODES = 400


def runs(folder: Path) -> list[tuple[str, str, int, Path]]:
    """(task, name of the policy, seed, folder) of every finished run of a policy that is shipped."""
    found = []
    for path in sorted(folder.glob("perdure/*/*/seed-*")):
        named = re.fullmatch(r"Home\w+-v0,(.*)", path.parent.parent.name)
        if named is None or path.parent.name not in learned_skills() or "release_cost" in named[1]:
            continue
        options = dict(pair.split("=", 1) for pair in named[1].split(","))
        name = path.parent.name
        if "delta" in options:
            within = f"-in-{options['limited_to']}" if "limited_to" in options else ""
            name = read_release(f"delta-{options['delta']}{within}").policy
        found.append((options["task"], name, int(path.name.removeprefix("seed-")), path))
    return found


def score(policy: Policy, task: str, name: str) -> dict[str, Any]:
    """From val starts, with clutter; what places also with Habitat's drag."""
    options = read_release(name.removeprefix("place-")).options if name.startswith("place-") else {}
    skill = "place" if name.startswith("place-") else name
    result = evaluate_skill(policy, skill, EPISODES, task=task, **options)
    scored = {"success": result.rate, "episodes": len(result.success), "failures": dict(result.failures.most_common())}
    if skill == "place":
        rolling = evaluate_skill(policy, skill, EPISODES, task=task, rolling=0.0, **options)
        scored["drag"] = {"success": rolling.rate, "failures": dict(rolling.failures.most_common())}
    return scored


def lent(scores: dict[str, dict[str, Any]], renewed: set[tuple[str, str]]) -> None:
    """How well policies that are learned on one task for all do on the others; `renewed` are (task, skill)."""
    for skill, home in LEARNED_ON.items():
        for task, seed in product(TASKS, shipped_seeds(home, skill)):
            name, path = f"{task}/{skill}/seed-{seed}", shipped_seeds(task, skill).get(seed)
            if task == home or path is None or path.parent.parent.name == task:
                continue
            if name in scores and (home, skill) not in renewed:
                continue
            scores[name] = {"learned_on": home, "shipped": True, **score(load_policy(path), task, skill)}


def main(folder: Path, seeds: list[int]) -> None:
    """Takes over, scores, prints."""
    scores = json.loads(SCORES.read_text()) if SCORES.exists() else {}
    renewed = set()
    for task, skill, seed, path in runs(folder):
        if seeds and seed not in seeds:
            continue
        policy = load_policy(path / "policy.safetensors")
        total = policy.provenance["config"]["total_steps"]
        policy = policy.without_critic().halved()
        scored = score(policy, task, skill)
        ships = skill.startswith("place") or scored["success"] >= WORTH_SHIPPING
        target = SHIPPED / task / skill / f"seed-{seed}.safetensors"
        renewed.add((task, skill))
        if ships:
            target.parent.mkdir(parents=True, exist_ok=True)
            save_policy(policy, target)
        else:
            target.unlink(missing_ok=True)
        scores[f"{task}/{skill}/seed-{seed}"] = {
            "command": policy.provenance["command"],
            "steps": total,
            "shipped": ships,
            **scored,
        }
        _write(scores)
    finish(scores, renewed)


def again(names: list[str]) -> None:
    """Scores shipped policies anew, such as "set_table/pick/seed-0"; all when none is named."""
    shipped = {
        path.relative_to(SHIPPED).with_suffix("").as_posix(): path for path in SHIPPED.glob("*/*/seed-*.safetensors")
    }
    if unknown := set(names) - shipped.keys():
        sys.exit(f"nobody ships {', '.join(sorted(unknown))}; there are {', '.join(sorted(shipped))}")
    scores, renewed = json.loads(SCORES.read_text()), set()
    for name in names or sorted(shipped):
        task, skill, _ = name.split("/")
        scores[name] |= score(load_policy(shipped[name]), task, skill)
        renewed.add((task, skill))
        _write(scores)
    finish(scores, renewed)


def finish(scores: dict[str, dict[str, Any]], renewed: set[tuple[str, str]]) -> None:
    """Scores what is lent to other tasks, writes the table."""
    lent(scores, renewed)
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
    lines = ["| task | policy | success, seed by seed | with drag |", "|---|---|---|---|"]
    for (task, policy), entries in rows.items():
        rates = ", ".join(f"{entry['success']:.3f}" for entry in entries)
        drag = ", ".join(f"{entry['drag']['success']:.3f}" for entry in entries if "drag" in entry)
        lines.append(f"| {task} | {policy} | {rates} | {drag} |")
    return "\n".join(lines)


def _write(scores: dict[str, dict[str, Any]]) -> None:
    write_atomic(SCORES, json.dumps(dict(sorted(scores.items())), indent=1) + "\n")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    if sys.argv[1] == "again":
        again(sys.argv[2:])
    else:
        main(Path(sys.argv[1]), [int(each) for each in sys.argv[2:]])
