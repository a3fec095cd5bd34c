"""Pages name only what exists, and the documentation site builds without network, warning or dead link."""

import importlib
import os
import re
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import api_pages
import cli_page
import pytest

from perdure.disturbances import Effect
from perdure.home.agents.release import ReleaseStrategy
from perdure.horizon import Clock
from perdure.learn.presets import METHODS

ROOT = Path(__file__).parents[1]
OWN_CLOCKS = [name for name, kind in Clock.kinds().items() if kind.__module__ == "perdure.horizon"]
OWN_DISTURBANCES = [name for name, kind in Effect.kinds().items() if kind.__module__.startswith("perdure.")]
GENERATED = (
    "docs/reference/api",
    "docs/reference/cli.md",
    "docs/reference/contract.md",
    "docs/home/skills.md",
    "docs/_build",
)
PAGES = {
    name: path.read_text()
    for path in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
    if not (name := str(path.relative_to(ROOT))).startswith(GENERATED)
}
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)


def anchors(text):
    """The anchors GitHub gives the headings of a page."""
    heads = re.findall(r"^#+ (.*)$", FENCE.sub("", text), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def broken_links(text, folder):
    """Links of a page that lead nowhere, read as GitHub shows it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", text)):
        path, _, anchor = target.partition("#")
        file = (folder / path).resolve()
        generated = file.is_relative_to(ROOT) and str(file.relative_to(ROOT)).startswith(GENERATED)
        if re.match(r"[a-z]+:", target) or generated:  # the site's own test follows the generated pages
            continue
        headed = anchor and file.suffix in ("", ".md")
        if not file.exists() or (headed and anchor not in anchors(file.read_text() if path else text)):
            yield f"dead link: {target}"


SCHEMAS = ("perdure.home.episodes", "perdure.home.episodes.log", "perdure.extrapolation", "perdure.policy")
"""Names of file formats."""


def unknown_names(text):
    """Dotted names of the package that a page writes in code and that do not exist."""
    for name in re.findall(r"`(perdure(?:\.\w+)+)", FENCE.sub("", text)):
        if name not in SCHEMAS and not exists(name):
            yield f"no such name: {name}"


def exists(dotted):
    """Whether a dotted name is a module, or an attribute of one."""
    module, _, name = dotted.rpartition(".")
    try:
        importlib.import_module(dotted)
    except ModuleNotFoundError:
        return bool(module) and exists(module) and hasattr(sys.modules.get(module), name)
    return True


@cache
def known_flags():
    return {name: cli_page.flags(name) for name in cli_page.commands()}


def unknown_flags(text):
    """Commands of the package in a text, in blocks and in sentences, with an unknown name or flag."""
    joined = re.sub(r"\\\n", " ", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
    for line in re.findall(r"\bperdure (?=[a-z-])([^`#\n]*)", joined):
        words = line.split()
        command = " ".join(words[: 2 if words[0] == "home" and len(words) > 1 else 1])
        flags = re.findall(r"(?<!\S)--[a-z][\w.-]*", line)
        if flags and command not in known_flags():
            yield f"no such command: {command}"
        for flag in flags:
            if flag not in known_flags().get(command, {flag}) and not flag.startswith("--ppo.") and flag != "--help":
                yield f"perdure {command} has no {flag}"


def bad_python(text):
    """Python blocks of a page that do not compile."""
    for language, code in FENCE.findall(text):
        if language == "python":
            try:
                compile(code if not code.startswith('"') else f"{{{code}}}", "block", "exec")
            except SyntaxError as error:
                yield f"{error.msg}: {error.text}"


def faults(text, folder):
    return [*broken_links(text, folder), *unknown_names(text), *unknown_flags(text), *bad_python(text)]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_only_what_exists(name):
    assert faults(PAGES[name], (ROOT / name).parent) == []


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("reference/clocks.md", OWN_CLOCKS),
        ("reference/methods.md", METHODS),
        ("how-to/disturb-a-policy.md", OWN_DISTURBANCES),
        ("home/world.md", ReleaseStrategy.kinds()),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_a_page_about_names_has_them_all(page, names):
    text = (ROOT / "docs" / page).read_text()
    assert [name for name in names if not re.search(rf"`{name}\b", text)] == []


def test_every_page_is_listed_in_the_index():
    folder = ROOT / "docs"
    indexes = [(folder / name, (folder / name).read_text()) for name in ("index.md", "home/index.md")]
    listed = {(page.parent / each).resolve() for page, text in indexes for each in re.findall(r"\]\(([^)#]+)", text)}
    assert [name for name in PAGES if name.startswith("docs/") and (ROOT / name) not in listed] == ["docs/index.md"]


class Html(HTMLParser):
    """Anchors of a page, what it links to, and what a browser loads for it."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.loaded = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.anchors |= {values[key] for key in ("id", "name") if values.get(key)}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if "src" in values:
            self.loaded.append(values["src"])
        if tag == "link" and values.get("rel") in ("stylesheet", "preload", "icon"):
            self.loaded.append(values["href"])


def dead_links(folder):
    """Links and loaded files of a built site that are not there, or that need a network to load."""
    pages = {
        path.resolve(): Html(path.read_text(errors="replace"))
        for path in sorted(folder.rglob("*.html"))
        if "_static" not in path.parts
    }
    for path, page in pages.items():
        where = path.relative_to(folder.resolve())
        yield from (f"{where} loads {each}" for each in page.loaded if re.match(r"(https?:)?//", each))
        for link in [*page.links, *page.loaded]:
            if re.match(r"([a-z]+:|//)", link):
                continue
            target, _, anchor = link.partition("#")
            file = (path.parent / unquote(target.partition("?")[0])).resolve() if target else path
            known = pages[file].anchors if file in pages else set()
            if not file.is_file() or (anchor and file in pages and unquote(anchor) not in known):
                yield f"{where} -> {link}"


def test_sphinx_can_read_every_module():
    """It refuses a generator in an annotation, which Python and the type checker take."""
    reader = pytest.importorskip("sphinx.pycode").ModuleAnalyzer
    for path in sorted((ROOT / "src").rglob("*.py")):
        reader.for_file(path, ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)).analyze()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("sphinx")
    out = tmp_path_factory.mktemp("site")
    command = [*(sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going"), "-d", out / "cache", "docs", out / "html"]
    nowhere = {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **nowhere}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out / "html"


@pytest.mark.verify
def test_the_site_has_no_dead_link_and_loads_nothing_from_the_network(site):
    assert list(dead_links(site)) == []


@pytest.mark.verify
def test_every_public_name_and_flag_is_in_the_reference(site):
    """Counted in the built pages: each documented object has an anchor with its full name, once."""
    text = "".join(path.read_text() for path in (site / "reference" / "api").glob("*.html"))
    found = re.findall(r'<dt[^>]* id="([\w.]+)"', text)
    assert len(found) == len(set(found))
    offered = {name for each in api_pages.public_modules() for name in api_pages.public_names(each)}
    assert offered - {anchor.rsplit(".", 1)[-1] for anchor in found} == set()
    commands = (site / "reference" / "cli.html").read_text()
    for words in ("perdure train", "perdure home run", "--first-eval-seed", "--physics-hz", "--ppo.total-steps"):
        assert words in commands
