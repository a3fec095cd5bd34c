"""One specification as PNG, SVG, PDF and in a page."""

import io
import json

import numpy as np
import pytest

from perdure.report import ReportError, theme
from perdure.report.axes import Axis
from perdure.report.curves import Curve, curve_chart
from perdure.report.render import FORMATS, Figure, render, save, script_json, slug, unique

STARTS = {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}


@pytest.fixture(scope="module")
def figure():
    steps = np.array([1.0, 2.0, 3.0])
    chart = curve_chart([Curve("method & <clock>", steps, steps, theme.style(0))], Axis("steps"), Axis("reward"))
    return Figure("my-figure", "What is seen", chart, "The note. " * 30, heading="Task")


def test_every_format_is_written(figure, tmp_path):
    save([figure], tmp_path, FORMATS)
    assert {path.name for path in tmp_path.iterdir()} == {f"my-figure.{kind}" for kind in STARTS}
    for kind, start in STARTS.items():
        assert (tmp_path / f"my-figure.{kind}").read_bytes().startswith(start)


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_same_figure_gives_the_same_bytes(figure, kind):
    assert render(figure, kind) == render(figure, kind)


def test_the_picture_holds_title_note_and_labels(figure):
    svg = render(figure, "svg").decode()
    for words in ("Task: What is seen", "The note.", "method &amp; &lt;clock&gt;", "steps", "reward"):
        assert words in svg


def test_compressing_again_changes_no_pixel(figure):
    import vl_convert
    from PIL import Image

    plain = vl_convert.vegalite_to_png(figure.standalone(), scale=theme.PNG_SCALE)
    ours = render(figure)
    pixels = [np.asarray(Image.open(io.BytesIO(png))) for png in (plain, ours)]
    np.testing.assert_array_equal(*pixels)
    assert len(ours) < 0.7 * len(plain)


def test_pictures_are_drawn_by_the_newest_vega_lite_that_is_not_too_new(figure, monkeypatch):
    import altair
    import vl_convert

    monkeypatch.setattr(altair, "SCHEMA_VERSION", "v6.30.1")  # newer than any that is installed
    assert b"The note." in render(figure, "svg")
    monkeypatch.setattr(vl_convert, "get_vegalite_versions", lambda: ["7.0"])
    with pytest.raises(ReportError, match=r"altair writes for Vega-Lite v6\.30\.1; vl-convert-python holds 7\.0"):
        render(figure, "svg")


def test_an_unknown_format_is_refused(figure):
    with pytest.raises(ReportError, match="'gif'; formats are png, svg, pdf"):
        render(figure, "gif")


@pytest.mark.parametrize("name", ["", "../up", "a b", "A", "-a", "a.b", "a--b"])
def test_a_name_that_is_no_file_name_is_refused(figure, name):
    with pytest.raises(ReportError, match="cannot be named"):
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
