"""No text of a file becomes markup, a script, a file's name or a terminal's command."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from make_policy import HOPPER, random_policy
from payloads import PAYLOADS, harmless, logs, table

from perdure.cli.commands import policy_text
from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.page import read_all, write_page
from perdure.home.evaluate.page import summary_text as home_summary
from perdure.policy import load_policy, save_policy
from perdure.report import read_table, summary_text, write_report
from perdure.schema import UNSEEN

FEW = tuple(PAYLOADS[k] for k in (6, 27))
"""Of a split there is a section with figures each."""


class Structure(HTMLParser):
    """Every tag with the names of its attributes, in order, and the texts of scripts."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags, self.scripts, self._script = [], [], False
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, *(name for name, _ in attributes)))
        self._script = tag == "script"

    def handle_endtag(self, tag):
        self.tags.append((f"/{tag}",))
        self._script = False

    def handle_data(self, data):
        if self._script:
            self.scripts.append(data)

    def handle_comment(self, data):
        self.tags.append(("comment",))

    def handle_pi(self, data):
        self.tags.append(("instruction",))

    def unknown_decl(self, data):
        self.tags.append(("declaration",))


def table_page(folder, text, formats=(), **how):
    frame, notes = read_table(table(folder / "episodes.parquet", text, **how))
    return write_report(frame, folder / "page", notes["command"], formats)


def logs_page(folder, text, formats=(), **how):
    records, cast = read_all([logs(folder / "logs.parquet", text, **how)])
    return write_page(analyze(records), folder / "page", "perdure home analyze", cast, formats)


def same(text):
    return text


@pytest.fixture(params=[table_page, logs_page], ids=["table", "logs"])
def make_page(request):
    return request.param


def test_a_page_of_payloads_has_the_markup_of_a_page_of_words(make_page, tmp_path):
    pages = []
    for name, text in (("hostile", same), ("harmless", harmless)):
        (tmp_path / name).mkdir()
        pages.append(make_page(tmp_path / name, text).read_text(encoding="utf-8"))
    hostile, harmless_ = map(Structure, pages)
    assert hostile.tags == harmless_.tags
    assert len(hostile.scripts) == len(harmless_.scripts)
    assert "owned" in pages[0]
    data = [script for script in hostile.scripts if "owned" in script]
    assert data
    assert not any("<" in script for script in data)


@pytest.mark.parametrize("wrong", PAYLOADS[:17], ids=range(17))
def test_markup_in_a_page_would_be_noticed(wrong):
    """Negative control: a page that does not escape differs from one of words."""
    assert Structure(f"<p>{wrong}</p>").tags != Structure("<p>word</p>").tags


@pytest.mark.parametrize("text", FEW)
def test_files_named_after_text_stay_in_their_folder(tmp_path, text):
    inside = tmp_path / "deep" / "inside"
    inside.mkdir(parents=True)
    table_page(inside, same, ("svg",), payloads=(text,), tasks=(text,))
    (inside / "home").mkdir()
    logs_page(inside / "home", same, ("svg",), payloads=(text,), split=text[:50])
    written = [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".parquet"]
    assert len(written) > 10
    assert {path.parent for path in written} == {inside / "page", inside / "home" / "page"}
    assert all(re.fullmatch(r"[a-z0-9_-]+\.(svg|html)", path.name) for path in written)


def test_text_for_a_terminal_holds_nothing_that_acts_on_it(tmp_path):
    frame, _ = read_table(table(tmp_path / "episodes.parquet"))
    records, _ = read_all([logs(tmp_path / "logs.parquet")])
    for text in (summary_text(frame), home_summary(analyze(records))):
        assert not UNSEEN.search(text.replace("\n", ""))


@pytest.mark.parametrize("text", PAYLOADS)
def test_a_policy_of_payloads_is_shown_as_text(tmp_path, text):
    notes = {
        "method": text,
        "preset": text,
        "engine": text,
        "command": f"{text}\x1b[2J",
        "seed": 0,
        "more": {text: text},
    }
    policy = random_policy(hidden=(4,), task=replace(HOPPER, name=text), provenance=notes)
    shown = policy_text(load_policy(save_policy(policy, tmp_path / "p")))
    assert text in shown
    assert not UNSEEN.search(shown.replace("\n", ""))


@pytest.mark.parametrize("text", ["\x1b]0;owned\x07", "\x9b2J", "a\nb", "\u202eowned", "\u2028"])
def test_control_characters_in_a_name_are_refused(tmp_path, text):
    with pytest.raises(PerdureError, match="control characters"):
        save_policy(random_policy(task=replace(HOPPER, name=text)), tmp_path / "p")
    with pytest.raises(ValueError, match="control characters"):
        table(tmp_path / "t", lambda payload: text, payloads=PAYLOADS[:1])
    with pytest.raises(ValueError, match="control characters"):
        logs(tmp_path / "l", lambda payload: text, payloads=PAYLOADS[:1])
