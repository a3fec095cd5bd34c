"""Markdown of docstrings as reStructuredText."""

import docstrings
import pytest


def spans(text):
    return "\n".join(docstrings.spans(text.split("\n")))


@pytest.mark.parametrize(
    ("markdown", "expected"),
    [
        ("a `seed` of 3", "a ``seed`` of 3"),  # plain code
        ("see `Policy.act`", "see `Policy.act`"),  # may be a name: the default role links it
        ("see `load_policy`s", "see `load_policy`\\ s"),  # a letter may not follow at once
        ("``x * y``", "``x * y``"),
        ("shape (*batch, 1)", "shape (\\*batch, 1)"),  # no emphasis
        ("**options", "\\*\\*options"),
        ("* an item", "* an item"),
        (":meth:`without_critic`", ":meth:`without_critic`"),  # reStructuredText already
    ],
)
def test_spans(markdown, expected):
    assert spans(markdown) == expected


def test_a_table_becomes_a_list_table():
    lines = ["Head.", "", "| a | b |", "|---|---|", "| 1 | 2 |", "", "Tail."]
    table = "\n".join(docstrings.tables(lines))
    assert ".. list-table::\n   :header-rows: 1\n\n   * - a\n     - b\n   * - 1\n     - 2\n" in table
    assert table.endswith("Tail.\n")
    assert docstrings.tables(["no | table"]) == ["no | table", ""]


def test_a_colon_in_the_text_of_an_attribute_survives_napoleon():
    from sphinx.ext.napoleon import Config, GoogleDocstring

    lines = ["Method, seed. No time stamps: the same run, the same file."]
    swallowed = str(GoogleDocstring(lines, Config(), what="attribute", name="x"))
    assert ":type:" in swallowed  # what happens without the handler
    kept = list(lines)
    docstrings.plain_attribute(None, "attribute", "x", None, None, kept)
    kept = str(GoogleDocstring(kept, Config(), what="attribute", name="x")).split("\n")
    docstrings.process(None, "attribute", "x", None, None, kept)
    assert "\n".join(kept).strip() == lines[0]


def test_a_default_that_is_no_python_is_left_out():
    assert docstrings.signature(None, "class", "x", None, None, "(a: int = <factory>, b=2)", None) == (
        "(a: int =..., b=2)",
        None,
    )


def test_array_types_are_shortened_and_tags_stay_in_balance():
    def token(text):
        word = f'<span class="pre">{text}</span>'
        return word if text.isalnum() else f'<span class="p">{word}</span>'  # as Sphinx writes them

    def array(kind):
        words = ["ndarray", "[", "tuple", "[", "Any", ",", "...", "]", ",", "dtype", "[", *kind, "]", "]"]
        return "".join(map(token, words))

    for kind in (["float64"], ["floating", "[", "Any", "]"]):
        context = {"body": f"<em>{array(kind)}</em>"}
        docstrings.short_arrays(None, "reference/api/perdure.policy", "page.html", context, None)
        body = context["body"]
        assert body == "<em>" + "".join(map(token, ["NDArray", "[", *kind, "]"])) + "</em>"


def test_other_pages_keep_their_text():
    context = {"body": "ndarray[tuple[Any, ...], dtype[float64]]"}
    docstrings.short_arrays(None, "tutorials/x", "page.html", context, None)
    assert context["body"] == "ndarray[tuple[Any, ...], dtype[float64]]"
