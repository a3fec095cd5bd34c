"""Logs whose truth is known, and what a page shows."""

import html
import re
from dataclasses import replace

from home_stories import Story, good
from specs import notes, specs

from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.page import write_page

FAR = [3.0, 0.0, 0.0]


def leaves(index, target):
    """The benchmark counts it; in the settling time one object is suddenly elsewhere."""

    def meanwhile(story):
        story.objects[target] = story.objects[target] + FAR

    return Story(index=index).rest(range(3)).log(meanwhile=meanwhile)


def misses(index):
    """Object 1 is let go 0.5 m beside its goal."""
    return Story(index=index).go(0).go(1, beside=0.5).go(2).log()


def four():
    """One that stays, one whose last object leaves, one whose first object leaves, one that misses."""
    return [good(0), leaves(1, 2), leaves(2, 0), misses(3)]


def records(place, logs, train_seed=100, **run):
    """The logs as those of a release strategy; `run`: world, planner, fallback, label."""
    return [replace(log, place=place, train_seed=train_seed, **run) for log in logs]


def two_strategies():
    """`rl`: `four()`; `ik`: everything stays."""
    return records("rl", four()) + records("ik", [good(index) for index in range(4)])


def page_of(logs, folder, command="perdure home analyze logs", assignment=None, formats=()):
    return write_page(analyze(logs), folder, command, assignment, formats).read_text()


def table(page, title):
    """The rows of a table, each a dictionary by heading."""
    part = page.partition(f"<h2>{title}</h2>")[2].partition("</table>")[0]
    headings = [html.unescape(each) for each in re.findall("<th>(.*?)</th>", part)]
    rows = re.findall("<tr>(<td>.*?)</tr>", part)
    cells = [[html.unescape(each).replace("\xa0", " ") for each in re.findall("<td>(.*?)</td>", row)] for row in rows]
    return [dict(zip(headings, row, strict=True)) for row in cells]


def row(page, title, strategy):
    (found,) = (each for each in table(page, title) if next(iter(each.values())) == strategy)
    return found


def figure(page, name):
    """The specification of a figure; None when there is no such figure."""
    found = [spec for each, spec in specs(page).items() if each.endswith(f"-{name}")]
    return found[0] if found else None


def figure_note(page, name):
    (found,) = (note for each, note in notes(page).items() if each.endswith(f"-{name}"))
    return found
