"""The documentation site builds without network, warning or dead link, and works as local files."""

import importlib
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[1]
GENERATED = ("docs/reference/api", "docs/reference/cli.md", "docs/_build")
PAGES = [
    page
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
    if not str(page.relative_to(ROOT)).startswith(GENERATED)
]
NO_NETWORK = {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}


def anchors(page):
    """The anchors GitHub gives the headings of a page."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    heads = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def broken(page):
    """Links of a page that lead nowhere, read as GitHub shows it."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if file.is_relative_to(ROOT) and str(file.relative_to(ROOT)).startswith(GENERATED):
            continue  # the site's own test follows these
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            yield target


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_links_lead_somewhere(page):
    assert list(broken(page)) == []


def test_broken_links_are_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# One heading\n[a](#one-heading) [b](#two) [c](none.md) [d](page.md#one-heading) [e](https://x.y)\n"
    )
    assert list(broken(page)) == ["#two", "none.md"]


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


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("sphinx")
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "sphinx",
            "-q",
            "-W",
            "--keep-going",
            "-b",
            "html",
            "-d",
            out / "cache",
            "docs",
            out / "html",
        ],
        cwd=ROOT,
        env={**os.environ, **NO_NETWORK},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return out / "html"


def test_the_site_has_no_dead_link_and_loads_nothing_from_the_network(site):
    assert list(dead_links(site)) == []


def test_every_public_name_is_documented_once(site):
    """Counted in the built pages: each documented object has an anchor with its full name."""
    from test_imports import PACKAGES

    found = [
        anchor
        for path in (site / "reference" / "api").glob("*.html")
        for anchor in re.findall(r'<dt[^>]* id="([\w.]+)"', path.read_text())
    ]
    assert len(found) == len(set(found))
    by_last = {anchor.rsplit(".", 1)[-1] for anchor in found}
    offered = {name for package in PACKAGES for name in getattr(importlib.import_module(package), "__all__", [])}
    assert offered - by_last == set()


def test_every_command_and_flag_is_in_the_reference(site):
    text = (site / "reference" / "cli.html").read_text()
    for words in ("perdure train", "perdure home run", "--first-eval-seed", "--release-velocity", "--ppo.total-steps"):
        assert words in text


def test_the_search_index_is_a_script_which_local_files_may_load(site):
    index = (site / "searchindex.js").read_text()
    assert index.startswith("Search.setIndex(")
    assert "searchindex.js" in (site / "search.html").read_text()


def test_dead_links_of_a_site_are_found(tmp_path):
    (tmp_path / "one.html").write_text(
        '<h1 id="top"></h1><a href="#top"></a><a href="#end"></a><a href="two.html"></a>'
    )
    (tmp_path / "two.html").write_text("")
    (tmp_path / "three.html").write_text('<script src="https://x.y/z.js"></script><img src="none.png">')
    assert list(dead_links(tmp_path)) == [
        "one.html -> #end",
        "three.html loads https://x.y/z.js",
        "three.html -> none.png",
    ]


def lost_files(text):
    """Source files that a page names in code and that are not there; a name before a block is the block's own."""
    named = re.findall(r"`((?:[\w.-]+/)+[\w.-]+\.(?:py|pddl|json|yml))`(?!:\n)", text)
    ours = {path.name for folder in (ROOT, ROOT / "src" / "perdure") for path in folder.iterdir()}
    named = [each for each in named if each.split("/")[0] in ours]  # others are files of other projects
    return [each for each in named if not any((ROOT / base / each).exists() for base in ("", "src", "src/perdure"))]


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_source_files_that_a_page_names_exist(page):
    assert lost_files(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)) == []


def test_a_lost_source_file_is_found():
    text = "`ppo/rollout.py` `ppo/gone.py` `src/perdure/ppo/update.py` `other/gone.py`; in `ppo/new.py`:\n\n```python\n"
    assert lost_files(text) == ["ppo/gone.py"]


SCHEMAS = {"perdure.home.episodes", "perdure.home.episodes.log", "perdure.extrapolation", "perdure.policy"}
"""Names of file formats."""


def lost_names(text):
    """Dotted names of the package that a page writes in code and that do not exist."""
    named = re.findall(r"`(perdure(?:\.\w+)+)", text)
    return [each for each in named if each not in SCHEMAS and not exists(each)]


def exists(dotted):
    """Whether a dotted name is a module, or an attribute of one."""
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_names_of_the_package_that_a_page_writes_exist(page):
    assert lost_names(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)) == []


def test_a_lost_name_is_found():
    assert lost_names("`perdure.horizon.Constant` `perdure.horizon.Gone` `perdure.gone`") == [
        "perdure.horizon.Gone",
        "perdure.gone",
    ]
