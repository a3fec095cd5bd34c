"""Write one page of the API reference for each public module: every public name once, from its docstring."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import textwrap
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import docstrings

import perdure

FIRST = ("perdure", "horizon", "wrappers", "envs", "policy", "learn", "evaluate", "stats", "report", "runs", "errors")
"""Parts of the package in the order of their pages; the others follow."""

ALSO = (
    *("errors", "film", "policy.onnx", "learn.advantages"),
    *("home.agents.learned", "home.agents.release", "home.sim.scene", "home.tasks.episodes", "home.tasks.tasks"),
    *("home.skills.gym", "home.skills.train"),
    *(f"home.evaluate.{name}" for name in ("analysis", "execute", "files", "log", "outcomes", "page", "policies")),
    "home.evaluate.protocol",
)
"""Modules that users import from and that `public_modules` would not find."""

INDEX = """# Python API

Each public name is documented once, on the page of the module that defines it. The names that most programs need can
be imported from `perdure` itself.

```{{toctree}}
:maxdepth: 1

{pages}
```
"""


def public_modules() -> list[str]:
    """Return the names of all packages and modules directly in perdure that have `__all__`, and of `ALSO`."""
    found = ["perdure"]
    found += [
        each.name
        for each in pkgutil.walk_packages(perdure.__path__, "perdure.")
        if each.ispkg or (each.name.count(".") == 1 and not each.name.endswith("__main__"))
    ]
    also = [f"perdure.{name}" for name in ALSO]
    return [*(name for name in found if hasattr(importlib.import_module(name), "__all__")), *also]


def public_names(module: str) -> list[str]:
    """Return `__all__` of a module, or else the classes and functions that it defines."""
    values = vars(importlib.import_module(module))
    defined = [name for name, value in values.items() if getattr(value, "__module__", "") == module]
    return list(values.get("__all__", [name for name in defined if not name.startswith("_")]))


def owners(packages: list[str]) -> dict[tuple[str, int], str]:
    """Return the package that documents each public object, by its name and id: equal numbers share an id.

    That is the deepest package that offers it, or for a class or function the one that is nearest to its definition.
    """
    owner: dict[tuple[str, int], str] = {}
    for package in packages:
        for name in public_names(package):
            value = getattr(importlib.import_module(package), name)
            key = name, id(value)
            if key not in owner or _nearness(value, package) >= _nearness(value, owner[key]):
                owner[key] = package
    return owner


def _nearness(value: Any, package: str) -> tuple[bool, int]:
    home = getattr(value, "__module__", "") or ""
    return home == package or home.startswith(f"{package}."), package.count(".")


def _place(package: str) -> tuple[int, str]:
    part = package.split(".")[:2][-1]
    return (FIRST.index(part) if part in FIRST else len(FIRST)), package


def page(package: str, owner: dict[tuple[str, int], str]) -> str:
    """Return the page of a package in Markdown, with its directives in reStructuredText."""
    module = importlib.import_module(package)
    names = public_names(package)
    own = [name for name in names if owner[name, id(getattr(module, name))] == package]
    others = [name for name in names if name not in own]
    parts = [f".. automodule:: {package}\n   :no-members:\n"]
    if others:
        links = [f"* :py:obj:`{name} <{owner[name, id(getattr(module, name))]}.{name}>`" for name in others]
        parts.append("Names documented with the package that defines them:\n\n" + "\n".join(links) + "\n")
    parts += [_entry(module, name) for name in own]
    return f"# {package}\n\n```{{eval-rst}}\n" + "\n".join(parts) + "```\n"


def _entry(module: ModuleType, name: str) -> str:
    value, target = getattr(module, name), f"{module.__name__}.{name}"
    if inspect.isclass(value) and value.__name__ == name:
        kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
        bases = "   :show-inheritance:\n" if value.__bases__ != (object,) else ""
        return f".. {kind}:: {target}\n   :members:\n{bases}"
    if inspect.isroutine(value):
        return f".. autofunction:: {target}\n"
    text = constant_text(module, name) or "A constant."
    return (
        f".. py:data:: {target}\n\n"
        + textwrap.indent("\n".join(docstrings.spans(docstrings.tables(text.splitlines()))), "   ")
        + "\n"
    )


def constant_text(package: ModuleType, name: str) -> str:
    """Return the docstring below the assignment of a constant, searched in all files of the package or module."""
    file = Path(str(package.__file__))
    for path in sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]:
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for statement, after in pairwise(body):
            if name in _assigned(statement) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                return inspect.cleandoc(str(after.value.value))
    return ""


def _assigned(statement: ast.stmt) -> list[str]:
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    else:
        targets = [statement.target] if isinstance(statement, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def write(folder: Path) -> None:
    """Write all pages into a folder; remove pages of packages that are gone."""
    folder.mkdir(parents=True, exist_ok=True)
    packages = public_modules()
    owner = owners(packages)
    pages = {f"{package}.md": page(package, owner) for package in packages}
    pages["index.md"] = INDEX.format(pages="\n".join(sorted(packages, key=_place)))
    for path in folder.glob("*.md"):
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:  # an unchanged page is not read again
            path.write_text(text, encoding="utf-8")
