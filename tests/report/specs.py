"""What a Vega-Lite specification draws."""

import html
import json
import re


def rows(spec, mark, **style):
    """The data of all layers with a mark, and with these properties of it; names of rows in one line."""
    found = []
    for layer in spec["layer"]:
        kind = layer["mark"]
        if kind["type"] == mark and all(kind.get(name) == value for name, value in style.items()):
            data = layer["data"]
            found += data["values"] if "values" in data else spec["datasets"][data["name"]]
    return [row | {"row": " ".join(row["row"].split())} if "row" in row else row for row in found]


def by_label(spec, mark, field="y", **style):
    """Values of a field for each label."""
    found = {}
    for row in rows(spec, mark, **style):
        found.setdefault(row["label"], []).append(row[field])
    return found


def specs(page):
    """The specifications of a page by the figure's name."""
    pattern = r"<figure id='([^']+)'.*?<script type='application/json'>(.*?)</script>"
    return {name: json.loads(text) for name, text in re.findall(pattern, page, re.DOTALL)}


def notes(page):
    """The notes of a page's figures by their names."""
    found = re.findall(r"<figure id='([^']+)'.*?<p class='note'>(.*?)</p>", page, re.DOTALL)
    return {name: html.unescape(text) for name, text in found}
