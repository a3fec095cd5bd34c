"""Code blocks of the documentation, and how the tests run them.

The comment above a block says what becomes of it. Blocks of a page run in order, in one folder, as a reader would:

    <!-- test: run -->                       always; python in one namespace for the page, sh in bash
    <!-- test: verify; 1e5 => 500 -->        only in `make verify`, here with a shorter setting
    <!-- test: file corridor.py -->          the reader saves the block under this name
    <!-- test: elsewhere; tests/test_x.py --> that test runs it
    <!-- test: skip; reason -->              cannot run here

`A => B` replaces A, which must occur in the block; `needs MODULE` leaves the block out, visibly, where a module is
not installed.
"""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
CODE = {"python", "sh", "console", "bash", "shell", "pycon"}
TEXT = {"text", "json", "bibtex", "yaml", "toml"}
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
GENERATED = ("docs/reference/api/", "docs/reference/cli.md", "docs/_build/")
FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>[^\n`]*)\n(?P<body>.*?)^(?P=indent)```[ ]*$", re.MULTILINE | re.DOTALL
)
MARK = re.compile(r"<!-- test: ((?:(?!-->).)*) -->\s*$", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """One code block of a page."""

    where: str
    """Page and line."""
    language: str
    text: str
    """As printed."""
    verb: str
    """run, verify, file, elsewhere or skip; "" where there is no mark."""
    details: tuple[str, ...] = ()

    @property
    def code(self):
        """What the tests run: the text with its replacements."""
        code = self.text
        for old, new in self.replacements:
            code = code.replace(old, new)
        return code

    @property
    def replacements(self):
        return [tuple(part.strip() for part in each.split("=>")) for each in self.details if "=>" in each]

    @property
    def modules(self):
        return [each.removeprefix("needs ") for each in self.details if each.startswith("needs ")]


def pages():
    """Every page with code that a person wrote."""
    return [path for path in PAGES if not str(path.relative_to(ROOT)).startswith(GENERATED)]


def blocks(text, where):
    """The code blocks of a page, in order; blocks of plain text and directives of the site are left out."""
    for found in FENCE.finditer(text):
        language = found["language"].strip().split(" ")[0]
        if language in TEXT or language.startswith("{"):
            continue
        mark = MARK.search(text[: found.start()])
        verb, *details = [part.strip() for part in mark[1].split(";")] if mark else [""]
        indent = re.compile(f"^{found['indent']}", re.MULTILINE)
        line = text[: found.start()].count("\n") + 1
        yield Block(f"{where}:{line}", language, indent.sub("", found["body"]), verb, tuple(details))


def faults(block):
    """What is wrong with a block's language or mark, as sentences."""
    verb = block.verb.split(" ")[0]
    if block.language not in CODE:
        yield f"{block.where}: name the language of the block ({', '.join(sorted(CODE | TEXT))})"
    elif not block.verb:
        yield f"{block.where}: say how the block is tested, e.g. <!-- test: run -->"
    elif verb not in ("run", "verify", "file", "elsewhere", "skip"):
        yield f"{block.where}: no such mark: {block.verb}"
    if verb == "skip" and not block.details:
        yield f"{block.where}: a skipped block needs a reason"
    if verb == "elsewhere" and not any((ROOT / each).is_file() for each in block.details):
        yield f"{block.where}: no test file in {block.details}"
    for old, _ in block.replacements:
        if old not in block.text:
            yield f"{block.where}: {old!r} is not in the block"


def indented_commands(text):
    """Commands in indented code, which no mark can stand for."""
    return re.findall(r"^ {4,}((?:perdure|pip|python|make|\$) .*)$", FENCE.sub("", text), re.MULTILINE)


def commands(block):
    """The commands of a shell block; in a console block those after a prompt."""
    if block.language not in ("console", "pycon"):
        return block.code
    return "\n".join(line[2:] for line in block.code.splitlines() if line.startswith(("$ ", "> ")))
