"""Report the sizes of the tree beside those of main, and check the rules that keep it plain.

`python tools/rules.py` prints both and exits with 1 if a rule is broken. `--executed` also counts the modules of
perdure that four commands load (a minute). The numbers below may only fall.
"""

from __future__ import annotations

import ast
import io
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CODE = ("src", "studies", "benchmarks", "tools")
DENSE = ("src", "studies")
"""Where dense statements are counted."""
GENERATED = (
    "docs/_build",
    "docs/reference/api",
    "docs/reference/cli.md",
    "docs/reference/contract.md",
    "docs/home/skills.md",
)

TUPLE_ASSIGNMENTS = 4
"""Assignments of the form `a, b = x, y`, in DENSE."""
PER_THOUSAND_LINES = {"ternaries": 10.4, "walruses": 0.8}
"""In DENSE."""
EXEMPTIONS = 2
"""Functions or files that may break a rule of ruff in LIMITED: rows in pyproject.toml and `noqa` comments."""
LIMITED = ("C901", "PLR0913")
MEGABYTES = {"policies": 100, "tables and figures": 25}
"""In results."""
WORDS = 300
"""Words of a page that is not in PAGES, as `wc -w` counts them."""
PAGES = {
    "CONTRIBUTING.md": 1_150,
    "README.md": 750,
    "docs/explanation/architecture.md": 1_180,
    "docs/explanation/thesis.md": 450,
    "docs/explanation/verdict.md": 1_450,
    "docs/home/benchmark.md": 1_150,
    "docs/home/day.md": 400,
    "docs/home/differences.md": 1_200,
    "docs/home/index.md": 700,
    "docs/home/outcomes.md": 1_400,
    "docs/home/physics.md": 480,
    "docs/home/plan.md": 500,
    "docs/home/training.md": 1_200,
    "docs/home/world.md": 1_400,
    "docs/how-to/any-policy.md": 1_100,
    "docs/how-to/check-in-ci.md": 350,
    "docs/how-to/disturb-a-policy.md": 800,
    "docs/how-to/export-onnx.md": 350,
    "docs/explanation/verdict-changes.md": 350,
    "docs/how-to/long-runs.md": 550,
    "docs/how-to/read-the-table.md": 320,
    "docs/how-to/reproduce-the-horizon-study.md": 400,
    "docs/how-to/robot-to-verdict.md": 480,
    "docs/how-to/when-a-policy-fails.md": 740,
    "CHANGELOG.md": 400,
    "docs/index.md": 600,
    "docs/reference/glossary.md": 650,
    "docs/reference/json.md": 430,
    "docs/reference/methods.md": 600,
    "docs/reference/policy-file.md": 450,
    "docs/reference/speed.md": 500,
    "docs/tutorials/choose-a-clock.md": 750,
    "docs/tutorials/does-my-sb3-agent-hold.md": 820,
    "docs/tutorials/my-own-environment.md": 400,
    "docs/tutorials/time-to-go-in-sb3.md": 500,
    "results/agents/README.md": 780,
    "results/compare/README.md": 450,
    "results/cure/README.md": 650,
    "results/cure/registered.md": 600,
    "results/disturbance/README.md": 1_250,
    "results/horizon/README.md": 2_000,
    "results/horizon/registered.md": 600,
    "results/placement/README.md": 2_350,
    "results/robots/README.md": 400,
}

COMMANDS = {
    "train": "train InvertedPendulum-v4 --ppo.total-steps 4096 --out {0}/train",
    "extrapolate": "extrapolate Hopper-v3/geometric --steps 300 --eval-seeds 2 --disturb none --out {0}/extrapolate",
    "home run": "home run set_table --place stop --rolling 0 --episodes 1 --out {0}/home",
    "home analyze": "home analyze {0}/home --out {0}/page",
}


def present_files(root: Path) -> dict[str, Path]:
    """Return the files that git does not ignore, by name; every file where the folder is no clone."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    names = listed.stdout.split("\0")
    if listed.returncode:
        names = [str(path.relative_to(root)) for path in root.rglob("*")]
    return {name: root / name for name in names if (root / name).is_file() and not name.startswith(GENERATED)}


def sources(root: Path) -> dict[str, str]:
    """Return the text of the code and the pages by name."""
    return {
        name: path.read_text(encoding="utf-8")
        for name, path in present_files(root).items()
        if is_code(name) or is_page(name)
    }


def sources_on_main(root: Path) -> dict[str, str] | None:
    """Return the same for the last commit on main; None where git does not know it."""
    command = ["git", "archive", "main", "--", ":(glob)**/*.py", ":(glob)**/*.md"]
    archive = subprocess.run(command, cwd=root, capture_output=True, check=False)
    if archive.returncode:
        return None
    texts = {}
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
        for member in tar:
            if member.isfile() and (is_code(member.name) or is_page(member.name)):
                texts[member.name] = tar.extractfile(member).read().decode()
    return texts


def is_code(name: str) -> bool:
    """Whether the file counts as code."""
    return name.endswith(".py") and name.split("/")[0] in CODE


def is_page(name: str) -> bool:
    """Whether the file is a page that a user reads."""
    if name.startswith(GENERATED):
        return False
    return name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md") or (
        name.endswith(".md") and name.split("/")[0] in ("docs", "results")
    )


def dense_statements(text: str) -> Counter[str]:
    """Count the statements that a reader has to decode."""
    found: Counter[str] = Counter()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Assign) and isinstance(node.value, (ast.Tuple, ast.List)):
            targets = [target for target in node.targets if isinstance(target, (ast.Tuple, ast.List))]
            found["tuple assignments"] += any(len(target.elts) == len(node.value.elts) for target in targets)
        found["ternaries"] += isinstance(node, ast.IfExp)
        found["walruses"] += isinstance(node, ast.NamedExpr)
    return found


def words(text: str) -> int:
    """Count words as `wc -w` does."""
    return len(text.split())


def sizes(texts: dict[str, str]) -> dict[str, float]:
    """Return what is reported, by name."""
    code = {name: text for name, text in texts.items() if is_code(name)}
    dense = {name: text for name, text in code.items() if name.split("/")[0] in DENSE}
    dense_lines = max(1, sum(text.count("\n") for text in dense.values()))
    found = sum((dense_statements(text) for text in dense.values()), Counter())
    return {
        "lines of Python": sum(text.count("\n") for text in code.values()),
        "files of Python": len(code),
        "words of pages": sum(words(text) for name, text in texts.items() if is_page(name)),
        "tuple assignments": found["tuple assignments"],
        "ternaries": round(1000 * found["ternaries"] / dense_lines, 1),
        "walruses": round(1000 * found["walruses"] / dense_lines, 1),
    }


def exemptions(root: Path, texts: dict[str, str]) -> int:
    """Count the rows of pyproject.toml and the `noqa` comments that switch a rule in LIMITED off."""
    ruff = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["ruff"]["lint"]
    count = sum(len({*LIMITED}.intersection(rules)) for rules in ruff["per-file-ignores"].values())
    comment = re.compile(r"#\s*noqa:.*\b(" + "|".join(LIMITED) + r")\b")
    return count + sum(len(comment.findall(text)) for name, text in texts.items() if is_code(name))


def megabytes_of_results(root: Path) -> dict[str, float]:
    """Return the megabytes of policies, and of tables and figures, in results."""
    ends = {"policies": (".safetensors",), "tables and figures": (".csv", ".parquet", ".svg", ".json", ".png")}
    results = [path for name, path in present_files(root).items() if name.startswith("results/")]
    return {
        kind: sum(path.stat().st_size for path in results if path.name.endswith(kinds)) / 1e6
        for kind, kinds in ends.items()
    }


def broken_rules(root: Path = ROOT) -> list[str]:
    """Return one line for each rule that the tree breaks: what, how much, and how much may be."""
    texts = sources(root)
    counts = sizes(texts)
    checks = [("tuple assignments (a, b = x, y)", counts["tuple assignments"], TUPLE_ASSIGNMENTS)]
    checks += [(f"{kind} in 1,000 lines", counts[kind], limit) for kind, limit in PER_THOUSAND_LINES.items()]
    checks += [(f"exemptions from {' and '.join(LIMITED)}", exemptions(root, texts), EXEMPTIONS)]
    checks += [
        (f"words in {name}", words(text), PAGES.get(name, WORDS)) for name, text in texts.items() if is_page(name)
    ]
    checks += [(f"MB of {kind} in results", size, MEGABYTES[kind]) for kind, size in megabytes_of_results(root).items()]
    return [f"{what}: {found:,.5g}, at most {limit:,}" for what, found, limit in checks if found > limit]


def executed_modules(command: str, folder: str) -> int:
    """Run a command of perdure and return how many of perdure's modules it loads, its child processes included."""
    environment = {**os.environ, "PYTHONPROFILEIMPORTTIME": "1"}
    arguments = [sys.executable, "-m", "perdure", *command.format(folder).split()]
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=True)
    return len(set(re.findall(r"\| +(perdure(?:\.\w+)*)$", done.stderr, re.MULTILINE)))


def report(root: Path = ROOT) -> None:
    """Print the sizes of the tree beside those of main."""
    main = sources_on_main(root)
    now = sizes(sources(root))
    if main is None:
        before = now
        print("git knows no branch main to compare with")
    else:
        before = sizes(main)
    for what, size in now.items():
        print(f"{what:18} {size:>8,.5g}  ({size - before[what]:+,.5g} against main)")


def main() -> None:
    """Report, and exit with 1 if a rule is broken."""
    report()
    if "--executed" in sys.argv:
        with tempfile.TemporaryDirectory() as folder:
            for name, command in COMMANDS.items():
                print(f"modules that `{name}` loads: {executed_modules(command, folder)}")
    broken = broken_rules()
    for line in broken:
        print(line, file=sys.stderr)
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
