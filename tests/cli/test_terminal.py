"""Commands work in terminals of any width and encoding, with paths of any bytes."""

import os

import pytest

from perdure.cli import _plain, command_line

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
MEMORY_KB = 4 * 2**20


@pytest.mark.parametrize("columns", ["1", "1000000000"])
def test_help_ends_in_a_terminal_of_any_width(process, tmp_path, columns):
    done = process("report", "--help", cwd=tmp_path, most_memory_kb=MEMORY_KB, COLUMNS=columns)
    assert (done.returncode, done.stderr) == (0, "")
    assert "report.html" in done.stdout
    assert len(done.stdout) < 100_000


def test_a_policy_and_a_folder_of_any_bytes_go_through_an_evaluation(command, process, tmp_path):
    from perdure.policy.files import find_policy

    policy, out = (os.fsencode(tmp_path) + name for name in (b"/p\xff.safetensors", b"/out\xff"))
    os.symlink(os.fsencode(find_policy("Hopper-v3/geometric")), policy)
    flags = ("--steps", "20", "--eval-seeds", "1", "--disturb", "none", "--on", "here", "--out", out)
    done = command("extrapolate", os.fsdecode(policy), *map(os.fsdecode, flags), cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    with open(out + b"/report.html", encoding="utf-8") as page:
        assert "out\\xff" in page.read()
    again = os.fsencode(tmp_path) + "/\u00fc".encode()
    done = process("report", out + b"/episodes.parquet", "--out", again, cwd=tmp_path, **ASCII)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Report: " in done.stdout
    assert done.stdout.isascii()
    assert os.path.exists(again + b"/report.html")


def test_a_command_is_text_whatever_its_bytes():
    words = [os.fsdecode(each) for each in (b"a b", "\u00fc".encode(), b"\xff")]
    assert command_line("perdure", *words) == "perdure 'a b' '\u00fc' '\\xff'"


def test_what_an_encoding_lacks_is_written_plainly():
    text = "\u2212 \u00b1 \u2013 \u221e \u00fc \udcff"
    assert [_plain(UnicodeEncodeError("ascii", text, k, k + 1, ""))[0] for k in range(0, len(text), 2)] == [
        *("-", "+-", "-", "inf"),
        *(r"\xfc", r"\xff"),
    ]
