"""Charts refuse what cannot be drawn; bars are drawn where their numbers say."""

import numpy as np
import pytest

from perdure.report import ReportError
from perdure.report.charts import Axis, Bars, Chart
from perdure.report.palette import INK
from perdure.report.plotly_renderer import render_plotly
from perdure.report.png_renderer import render_png

TWO = np.array([0.0, 1.0])


def chart(**bars):
    drawn = Bars(**{"label": "b", "rows": TWO, "start": 0.0 * TWO, "end": TWO, "colour": INK} | bars)
    return Chart(
        "c", "title", Axis("share", percent=True, low=0.0, high=1.0), Axis("", rows=("a", "b")), (), (), (drawn,)
    )


@pytest.mark.parametrize(
    ("wrong", "message"), [({"end": np.zeros(3)}, "end and rows"), ({"texts": ("one",)}, "1 texts for 2 bars")]
)
def test_bars_that_do_not_fit_together_are_refused(wrong, message):
    with pytest.raises(ReportError, match=message):
        chart(**wrong)


def test_a_bar_begins_at_its_base_and_is_as_long_as_it_says():
    (drawn,) = render_plotly(chart(start=np.array([0.2, 0.5]), end=np.array([0.7, 0.6])), dark=False)["data"]
    assert drawn["base"] == [0.2, 0.5]
    assert drawn["x"] == pytest.approx([0.5, 0.1])
    assert drawn["y"] == [0.0, 1.0]


def test_a_text_with_no_room_in_its_bar_is_left_out_of_the_picture():
    wide = render_png(chart(end=np.array([0.9, 0.9]), texts=("word", "word"), inside=True))
    narrow = render_png(chart(end=np.array([0.01, 0.01]), texts=("word", "word"), inside=True))
    assert narrow == render_png(chart(end=np.array([0.01, 0.01])))
    assert wide != render_png(chart(end=np.array([0.9, 0.9])))


def test_a_long_note_gets_lines_of_its_own():
    from dataclasses import replace
    from io import BytesIO

    from PIL import Image

    heights = [Image.open(BytesIO(render_png(replace(chart(), note="word " * n)))).height for n in (1, 60)]
    assert heights[1] > heights[0] + 20


def test_columns_have_names_from_left_to_right():
    named = Chart("c", "t", Axis("stage", rows=("first", "second", "third")), Axis("share"), ())
    axis = render_plotly(named, dark=False)["layout"]["xaxis"]
    assert axis["ticktext"] == ["first", "second", "third"]
    assert axis["range"][0] < 0.0 < 2.0 < axis["range"][1]


def test_shares_have_no_marks_beyond_100_percent_though_the_axis_goes_on_for_texts():
    assert Axis("share", percent=True, high=1.4).ticks[-1] == 1.0
    assert Axis("share", percent=True, high=0.8).ticks is None
    assert Axis("metres", high=1.4).ticks is None
