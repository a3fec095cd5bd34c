"""One specification as PNG, SVG, PDF and in a page."""

import json
import re

import altair
import jsonschema
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.report import charts
from perdure.report.charts import FORMATS, Axis, Curve, Figure, curve_chart, render, save, script_json, slug, unique

STARTS = {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}


@pytest.fixture(scope="module")
def figure():
    steps = np.array([1.0, 2.0, 3.0])
    chart = curve_chart([Curve("method & <clock>", steps, steps, charts.style(0))], Axis("steps"), Axis("reward"))
    return Figure("my-figure", "What is seen", chart, "The note. " * 30, heading="Task")


def test_every_format_is_written(figure, tmp_path):
    save([figure], tmp_path, FORMATS)
    assert {path.name for path in tmp_path.iterdir()} == {f"my-figure.{kind}" for kind in STARTS}
    for kind, start in STARTS.items():
        assert (tmp_path / f"my-figure.{kind}").read_bytes().startswith(start)


def test_the_same_figure_gives_the_same_bytes(figure):
    assert render(figure, "svg") == render(figure, "svg")


def test_the_specification_is_valid(figure):
    """By the schema of Vega-Lite that Altair has; pages and files take it unchecked."""
    altair.Chart.from_dict(figure.spec)
    wrong = figure.spec | {"layer": [{"mark": "cloud"}]}
    with pytest.raises(jsonschema.ValidationError):
        altair.Chart.from_dict(wrong)


def test_the_picture_holds_title_note_and_labels(figure):
    svg = render(figure, "svg").decode()
    for words in ("Task: What is seen", "The note.", "method &amp; &lt;clock&gt;", "steps", "reward"):
        assert words in svg


@pytest.mark.parametrize("end", ["top", "bottom"])
def test_a_name_of_several_lines_stays_beside_the_area_between_the_axes(end):
    steps = np.array([1.0, 2.0, 3.0])
    name = "a method with a long name of several lines"
    look = charts.style(0)
    curve = Curve(name, steps, steps if end == "top" else -steps, look)
    svg = render(Figure("f", "t", curve_chart([curve], Axis("steps"), Axis("reward"))), "svg").decode()
    pattern = rf'translate\([\d.]+,([\d.]+)\)"[^>]*fill="{look.color}"><tspan>(.*?)</text>'
    ((first, lines),) = re.findall(pattern, svg)
    below = [float(each) for each in re.findall(r'dy="([\d.]+)"', lines)]
    assert below
    assert 0 < float(first) < float(first) + sum(below) <= charts.HEIGHT


@pytest.mark.parametrize(("width", "left_out"), [(900, 0), (150, 1)])
def test_numbers_at_risk_do_not_touch_each_other(width, left_out):
    steps = np.array([1.0, 10.0, 100.0, 300.0])
    watched = Curve("a", steps, steps, charts.style(0), watched=np.full(77, 300.0))
    chart = curve_chart([watched], Axis("steps", log=True, low=1.0, high=300.0), Axis("reward"), width=width)
    svg = render(Figure("f", "t", chart), "svg").decode()
    numbers = re.findall(r"<text[^>]*>77</text>", svg)
    assert len(numbers) == 4
    assert sum('opacity="0"' in each for each in numbers) == left_out


def test_an_unknown_format_is_refused(figure):
    with pytest.raises(PerdureError, match="'gif'; formats are png, svg, pdf"):
        render(figure, "gif")


@pytest.mark.parametrize("name", ["", "../up", "a b", "A", "-a", "a.b", "a--b"])
def test_a_name_that_is_no_file_name_is_refused(figure, name):
    with pytest.raises(PerdureError, match="cannot be named"):
        Figure(name, "t", figure.chart)


@pytest.mark.parametrize("words", ["Hopper-v3", "../../etc/passwd", "<script>", "", "é", "x" * 300, "a--b", "CON.txt "])
def test_a_slug_is_such_a_name(figure, words):
    assert Figure(slug(words), "t", figure.chart).name


def test_figures_of_one_name_are_told_apart(figure):
    taken = {"other"}
    assert [each.name for each in unique([figure, figure, figure], taken)] == [
        *("my-figure", "my-figure-2", "my-figure-3")
    ]
    assert taken == {"other", "my-figure", "my-figure-2", "my-figure-3"}


def test_json_in_a_script_cannot_end_it():
    value = {"label": "</script><!--<script>", "value": 0.5}
    text = script_json(value)
    assert "<" not in text
    assert json.loads(text) == value
