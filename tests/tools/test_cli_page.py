"""The reference of the command line names every command and every flag."""

import cli_page
import pytest


@pytest.mark.parametrize("command", cli_page.commands())
def test_a_section_has_a_row_for_every_flag(command):
    shown = {line.split("`")[1].split()[0] for line in cli_page.section(command).splitlines() if line.startswith("| `")}
    named = {action.option_strings[0] for action in cli_page.parser(command)._actions if action.option_strings}
    assert named - {"-h"} <= shown
    assert f"## perdure {command}\n" in cli_page.page()


def test_a_row_has_value_default_and_meaning():
    text = cli_page.section("extrapolate")
    assert "| `--first-eval-seed INT` | First start state" in text
    assert "| `--clocks STR ...` |" in text
    assert "| `POLICIES` |" in text
    assert "| `--ppo.total-steps INT` |" in cli_page.section("train")
