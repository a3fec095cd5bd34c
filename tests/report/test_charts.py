"""Charts are drawn as their numbers say."""

import numpy as np
import pytest
from specs import by_label, rows

from perdure.report import charts
from perdure.report.charts import Axis, Bars, Curve, Level, Marker, Points, bar_chart, curve_chart, point_chart, spread

THREE = np.array([1.0, 10.0, 100.0])


def curve(n=3, label="a", **more):
    return Curve(label, THREE[:n], THREE[:n] / 2, charts.style(0), **more)


def spec(*curves, **more):
    x = Axis("steps", log=True, low=1.0, high=100.0)
    return curve_chart(curves, x, Axis("reward"), **more)


def bars(**more):
    return Bars(**{"label": "b", "rows": (0, 1), "x": THREE[:2], "texts": ("1", "10"), "style": charts.style(0)} | more)


class TestCurves:
    def test_two_points_are_not_joined(self):
        two, three = spec(curve(2)), spec(curve(3))
        assert rows(two, "line") == []
        assert [row["y"] for row in rows(two, "point", opacity=1)] == [0.5, 5.0]
        assert [row["y"] for row in rows(three, "line")] == [0.5, 5.0, 50.0]
        assert rows(three, "point", opacity=1) == []

    def test_a_band_is_drawn_where_there_are_bounds(self):
        lower = np.array([0.1, np.nan, 3.0])
        drawn = rows(spec(curve(lower=lower, upper=lower + 1.0)), "area")
        assert [(row["x"], row["lower"], row["upper"]) for row in drawn] == [(1.0, 0.1, 1.1), (100.0, 3.0, 4.0)]

    def test_members_are_thin_lines(self):
        drawn = rows(spec(curve(members=np.array([[1.0, 2.0, np.nan], [3.0, 4.0, 5.0]]))), "line", size=0.9)
        assert [(row["member"], row["y"]) for row in drawn] == [(0, 1.0), (1, 3.0), (0, 2.0), (1, 4.0), (1, 5.0)]

    def test_every_curve_is_named_where_it_ends(self):
        text = [" ".join(row["text"]) for row in rows(spec(curve(), curve(label="b")), "text")]
        assert text == ["a", "b"]

    def test_a_level_line_has_its_interval(self):
        level = Level("base", 2.0, 1.0, 3.0, charts.style(1))
        drawn = spec(curve(), levels=[level])
        assert [(row["lower"], row["upper"]) for row in rows(drawn, "rect")] == [(1.0, 3.0)]
        assert rows(spec(curve(), levels=[Level("base", 2.0, np.nan, np.nan, charts.style(1))]), "rect") == []

    def test_the_label_of_a_marker_is_on_the_side_with_room(self):
        sides = [
            next(layer["mark"]["align"] for layer in spec(curve(), markers=[Marker(at, "here")])["layer"][1:])
            for at in (2.0, 90.0)
        ]
        assert sides == ["left", "right"]

    def test_a_logarithmic_axis_has_powers_of_ten_and_its_end(self):
        axis = Axis("steps", log=True, low=1.0, high=5000.0).ticks(5000.0, grid=False)
        assert axis["values"] == [1.0, 10.0, 100.0, 1000.0, 5000.0]
        assert Axis("steps", log=True, low=1.0, high=1500.0).ticks(1500.0, grid=False)["values"][-1] == 1000.0

    def test_places_have_names(self):
        x = Axis("stage", names=("start", "pick", "place"))
        drawn = curve_chart([Curve("a", np.arange(3.0), THREE, charts.style(0))], x, Axis("share"))
        assert [row["x"] for row in rows(drawn, "line")] == ["start", "pick", "place"]


class TestNames:
    def test_names_that_are_apart_stay(self):
        np.testing.assert_allclose(spread(np.array([5.0, 1.0, 9.0]), 2.0, 0.0, 10.0), [5.0, 1.0, 9.0])

    def test_names_that_overlap_move_as_little_as_possible(self):
        np.testing.assert_allclose(spread(np.array([5.0, 5.0]), 2.0, 0.0, 10.0), [4.0, 6.0])

    def test_names_stay_beside_the_figure(self):
        np.testing.assert_allclose(spread(np.array([10.0, 10.0]), 2.0, 0.0, 10.0), [8.0, 10.0])


class TestRows:
    def test_a_bar_is_as_long_as_it_says(self):
        drawn = bar_chart(["one", "two"], [bars(whole=np.array([20.0, 30.0]))], Axis("count"))
        assert [(row["row"], row["x"], row["end"]) for row in rows(drawn, "bar", opacity=0.3)] == [
            ("one", 1.0, 20.0),
            ("two", 10.0, 30.0),
        ]

    def test_texts_name_the_bar_where_a_row_has_several(self):
        alone = bar_chart(["one", "two"], [bars()], Axis("count"))
        both = bar_chart(["one", "two"], [bars(), bars(label="c")], Axis("count"))
        assert [row["text"] for row in rows(alone, "text")] == ["1", "10"]
        assert [row["text"] for row in rows(both, "text")] == ["b: 1", "b: 10", "c: 1", "c: 10"]

    @pytest.mark.parametrize("words", [("short", "short"), ("a" * 60, "b"), ("a", "b" * 60)])
    def test_every_text_has_room_behind_its_bar(self, words):
        drawn = bar_chart(["one", "two"], [bars(texts=words)], Axis("count"))
        end = drawn["layer"][0]["encoding"]["x"]["scale"]["domain"][1]
        for row in rows(drawn, "text"):
            assert row["x"] / end * drawn["width"] + charts.text_width(len(row["text"])) <= drawn["width"]

    def test_points_have_intervals_where_there_are_bounds(self):
        bounds = np.array([0.5, np.nan])
        points = Points("p", (0, 1), THREE[:2], charts.style(0), bounds, bounds + 1.0, [[], [3.0, 4.0]])
        drawn = point_chart(["one", "two"], [points], Axis("reward"))
        assert [(row["low"], row["high"]) for row in rows(drawn, "rule")] == [(0.5, 1.5)]
        assert [row["x"] for row in rows(drawn, "point", filled=True)] == [1.0, 10.0]
        assert [(row["row"], row["x"]) for row in rows(drawn, "point", filled=False)] == [("two", 3.0), ("two", 4.0)]


class TestStyles:
    def test_no_two_of_eight_share_a_color_a_dash_or_a_shape(self):
        styles = [charts.style(k) for k in range(8)]
        for name in ("color", "dash", "shape"):
            assert len({getattr(each, name) for each in styles}) == 8

    def test_every_color_has_one_for_a_dark_page(self):
        used = {charts.style(k).color for k in range(8)} | {charts.ordered_style(k / 40).color for k in range(41)}
        assert used <= charts.DARK.keys()
        assert charts.ordered_style(0.0) != charts.ordered_style(0.1)

    def test_shares_are_marked_to_100_percent(self):
        assert Axis("share", percent=True).ticks(1.0, grid=False)["values"][-1] == 1.0
        drawn = by_label(spec(curve()), "line")
        assert drawn == {"a": [0.5, 5.0, 50.0]}
