"""Imports point one way. Every import statement of the package is read from its source; nothing is executed.

cli -> evaluate, home -> learn -> policy -> envs -> horizon, disturbances
report, runs: nothing of ours but schema and stats (report: disturbances, horizon, runs.write_atomic, runs.versions)
stats: nothing of ours; sequential: stats
film: writes files with runs.write_atomic; evaluate and home draw with it
errors: nothing of ours; schema: errors; registry: schema; everything may use errors and registry
"""

import ast
from pathlib import Path
from typing import NamedTuple

import pytest

import perdure

ROOT = Path(perdure.__file__).parent

ALLOWED = {
    "errors": set(),
    "schema": set(),
    "stats": set(),
    "sequential": {"stats"},
    "film": {"runs"},
    "registry": {"schema"},
    "horizon": set(),
    "disturbances": set(),
    "wrappers": {"horizon", "disturbances"},
    "runs": {"schema"},
    "report": {"disturbances", "horizon", "schema", "sequential", "stats", "runs"},
    "envs": {"schema", "horizon", "disturbances", "wrappers"},
    "policy": {"schema", "horizon", "envs", "runs"},
    "robots": {"schema", "policy", "runs"},
    "learn": {"schema", "horizon", "disturbances", "envs", "policy", "runs"},
    "evaluate": {
        *("schema", "horizon", "disturbances", "wrappers", "envs", "policy", "learn"),
        *("report", "stats", "film", "runs"),
    },
    "home": {"schema", "horizon", "wrappers", "envs", "policy", "learn", "report", "stats", "film", "runs"},
    "cli": {
        *("schema", "horizon", "disturbances", "envs", "policy", "learn", "evaluate", "home", "report", "film", "runs"),
        "robots",
    },
    "__init__": {"horizon", "envs", "policy", "learn", "evaluate", "report"},  # its lazy names
    "__main__": {"cli", "schema"},
}
"""Package to the packages it may import beside `EVERYWHERE`, at run time and for type checking alike."""
EVERYWHERE = {"errors", "registry"}

HOME = "perdure.home"
ROOMS = ("sim", "tasks", "skills", "agents", "evaluate")
"""The rooms of `perdure.home`, each above those before it."""
SCREENS = ("pictures", "film", "failures")
"""Files that show what happens in the rooms, each above those before it."""

ONLY = {("report", "runs"): {"versions", "write_atomic"}, ("film", "runs"): {"refuse_replacing", "write_atomic"}}
"""Where an arrow carries certain names only."""

TYPES_ONLY: set[tuple[str, str]] = set()
"""Arrows allowed under TYPE_CHECKING alone, where an annotation must name what only a caller can pass in."""


class Import(NamedTuple):
    """One imported name of ours."""

    place: str
    """File and line."""
    source: str
    target: str
    name: str
    """What is taken from the target package; "" for the whole of it."""
    for_types: bool
    """It stands under ``if TYPE_CHECKING``."""


def imports_of(root, package="perdure"):
    """Every import of one part of the package in ``root`` by another, wherever in a file it stands."""
    return [found for path in sorted(root.rglob("*.py")) for found in _imports_in(path, root, package)]


def _imports_in(path, root, package):
    parts = path.relative_to(root).with_suffix("").parts
    tree = ast.parse(path.read_text(), str(path))
    typed = {
        id(node) for guard in ast.walk(tree) if _guards_types(guard) for part in guard.body for node in ast.walk(part)
    }
    for node in ast.walk(tree):
        for module, name in _modules(node, (*package.split("."), *parts[:-1])):
            if module != package and not module.startswith(f"{package}."):
                continue
            target, _, rest = module.removeprefix(package).removeprefix(".").partition(".")
            if not target:  # from perdure import envs
                target, name = name, ""
            if target and target != parts[0]:
                where = f"{path.relative_to(root)}:{node.lineno}"
                yield Import(where, parts[0], target, name if not rest or name else rest, id(node) in typed)


def _modules(node, package):
    """(module, name) of everything of ours that an import statement takes, relative imports included."""
    if isinstance(node, ast.Import):
        taken = [(alias.name, "") for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
        module = ".".join(part for part in (base, node.module) if part)
        taken = [(module, alias.name) for alias in node.names]
    elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
        argument = node.args[0]
        taken = [(argument.value, "")] if isinstance(argument, ast.Constant) else []
    else:
        taken = []
    return [(module, name) for module, name in taken if module.split(".")[0] == "perdure"]


def _guards_types(node):
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def forbidden(imports):
    """The imports that break a rule, as sentences."""
    return [
        f"{found.place}: {found.source} must not import {found.name or 'all'} of {found.target}"
        for found in imports
        if not _is_allowed(found)
    ]


def _is_allowed(found):
    arrow = (found.source, found.target)
    if found.target not in ALLOWED.get(found.source, set()) | EVERYWHERE:
        return found.for_types and arrow in TYPES_ONLY
    return found.name in ONLY.get(arrow, {found.name})


@pytest.fixture(scope="module")
def imports():
    return imports_of(ROOT)


def test_imports_point_one_way(imports):
    assert forbidden(imports) == []


def test_every_part_of_the_package_has_its_rule():
    parts = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert parts == set(ALLOWED)


def test_the_rules_themselves_have_no_circle():
    settled = set()
    while settled != set(ALLOWED):
        next_ones = {part for part, below in ALLOWED.items() if part not in settled and below <= settled}
        assert next_ones, f"a circle among {sorted(set(ALLOWED) - settled)}"
        settled |= next_ones


def test_no_exception_is_kept_that_nobody_needs(imports):
    assert {(found.source, found.target) for found in imports if found.for_types} >= TYPES_ONLY


def test_the_known_arrows_are_seen(imports):
    """The search finds something: an empty result would pass every rule."""
    arrows = {(found.source, found.target) for found in imports}
    assert {("evaluate", "policy"), ("learn", "policy"), ("policy", "envs"), ("report", "runs")} <= arrows
    assert ("report", "runs", "write_atomic") in {(found.source, found.target, found.name) for found in imports}


def upward(imports):
    """Imports inside `perdure.home` that do not go down from room to room, as sentences."""
    floors = (*ROOMS, *SCREENS)
    below = {room: {"errors", *floors[:floor]} for floor, room in enumerate(floors)} | {"errors": set()}
    below["__init__"] = {"errors", *ROOMS}
    return [
        f"{each.place}: {each.source} must not import {each.target}"
        for each in imports
        if each.target not in below.get(each.source, set())
    ]


def test_imports_inside_home_go_down_from_room_to_room():
    found = imports_of(ROOT / "home", HOME)
    assert upward(found) == []
    assert {("film", "sim"), ("skills", "tasks"), ("evaluate", "agents")} <= {(e.source, e.target) for e in found}


def test_every_folder_of_home_with_code_is_a_room():
    folders = {path.name for path in (ROOT / "home").iterdir() if (path / "__init__.py").exists()}
    assert folders == set(ROOMS)


def circles(root, package):
    """Parts of a package that import each other in a circle."""
    below = {}
    for each in imports_of(root, package):
        below.setdefault(each.source, set()).add(each.target)
    open_parts = set(below) | {part for parts in below.values() for part in parts}
    while free := {part for part in open_parts if not below.get(part, set()) & open_parts}:
        open_parts -= free
    return open_parts - {"__init__"}


@pytest.mark.parametrize("room", ROOMS)
def test_no_two_parts_of_a_room_import_each_other(room):
    assert circles(ROOT / "home" / room, f"{HOME}.{room}") == set()
