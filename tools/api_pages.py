"""Write one page of the API reference for each public module: every public name once, from its docstring."""

from __future__ import annotations

import inspect
import pkgutil
import textwrap
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import docstrings
from marks import write_changed
from sphinx.pycode import ModuleAnalyzer

import perdure

FIRST = ("perdure", "horizon", "wrappers", "envs", "policy", "learn", "evaluate", "stats", "report", "runs", "errors")
"""Parts of the package in the order of their pages; the others follow."""

ALSO = (
    *("errors", "film", "policy.onnx", "learn.advantages", "evaluate.compare"),
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


@cache
def public_modules() -> list[str]:
    """Return the names of all packages and modules directly in perdure that have `__all__`, and of `ALSO`."""
    found = ["perdure"]
    found += [
        each.name
        for each in pkgutil.walk_packages(perdure.__path__, "perdure.")
        if each.ispkg or (each.name.count(".") == 1 and not each.name.endswith("__main__"))
    ]
    also = [f"perdure.{name}" for name in ALSO]
    return [*(name for name in found if hasattr(import_module(name), "__all__")), *also]


@cache
def public_names(module: str) -> list[str]:
    """Return `__all__` of a module, or else the classes and functions that it defines."""
    values = vars(import_module(module))
    defined = [name for name, value in values.items() if getattr(value, "__module__", "") == module]
    return list(values.get("__all__", [name for name in defined if not name.startswith("_")]))


def owner(name: str, value: object) -> str:
    """Return the module that documents a public object, among those that offer it.

    That is the one nearest to the definition of a class or function, and the deepest for a constant.
    """
    home = getattr(value, "__module__", "") or ""

    def nearness(module: str) -> tuple[bool, int]:
        return f"{home}.".startswith(f"{module}."), module.count(".")

    modules = (each for each in public_modules() if name in public_names(each))
    return max((each for each in modules if getattr(import_module(each), name) is value), key=nearness)


def _place(package: str) -> tuple[int, str]:
    part = package.split(".")[:2][-1]
    if part in FIRST:
        return FIRST.index(part), package
    return len(FIRST), package


def page(package: str) -> str:
    """Return the page of a package in Markdown, with its directives in reStructuredText."""
    module = import_module(package)
    places = {name: owner(name, getattr(module, name)) for name in public_names(package)}
    parts = [f".. automodule:: {package}\n   :no-members:\n"]
    links = [f"* :py:obj:`{name} <{at}.{name}>`" for name, at in places.items() if at != package]
    if links:
        parts.append("Names documented with the package that defines them:\n\n" + "\n".join(links) + "\n")
    parts += [_entry(module, name) for name, at in places.items() if at == package]
    return f"# {package}\n\n```{{eval-rst}}\n" + "\n".join(parts) + "```\n"


def _entry(module: ModuleType, name: str) -> str:
    value = getattr(module, name)
    target = f"{module.__name__}.{name}"
    if inspect.isclass(value) and value.__name__ == name:
        kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
        directive = f".. {kind}:: {target}\n   :members:\n"
        if value.__bases__ != (object,):
            directive += "   :show-inheritance:\n"
        return directive
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
    files = [file]
    if file.name == "__init__.py":
        files = sorted(file.parent.rglob("*.py"))
    for path in files:
        found = _constant_texts(path).get(("", name))
        if found:
            return "\n".join(found).strip()
    return ""


@cache
def _constant_texts(path: Path) -> Mapping[tuple[str, str], list[str]]:
    return ModuleAnalyzer.for_file(str(path), path.stem).find_attr_docs()


def write(folder: Path) -> None:
    """Write all pages into a folder; remove pages of packages that are gone."""
    folder.mkdir(parents=True, exist_ok=True)
    packages = public_modules()
    pages = {f"{package}.md": page(package) for package in packages}
    pages["index.md"] = INDEX.format(pages="\n".join(sorted(packages, key=_place)))
    for path in folder.glob("*.md"):
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        write_changed(folder / name, text)
