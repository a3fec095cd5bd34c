"""The reference of the command line names every command and every flag."""

import dataclasses
from importlib import import_module

import cli_page
import pytest

COMMANDS = cli_page.commands()


def test_every_command_of_the_usage_has_a_section():
    from perdure.cli import COMMANDS as OUTER
    from perdure.cli.home import COMMANDS as HOME

    page = cli_page.page()
    wanted = [name for name in OUTER if name != "home"] + [f"home {name}" for name in HOME]
    assert [name for name in wanted if f"## perdure {name}\n" not in page] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_field_of_a_command_has_a_row(command):
    text = cli_page.section(command, COMMANDS[command])
    fields = dataclasses.fields(cli_page._flags(import_module(f"perdure.cli.{COMMANDS[command]}")))
    shown = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")]
    for field in fields:
        flag, argument = "--" + field.name.replace("_", "-"), field.name.upper()
        assert any(name.split()[0] in (flag, argument) or name.startswith(f"{flag}.") for name in shown), field.name


def test_a_row_has_value_default_and_meaning():
    text = cli_page.section("extrapolate", COMMANDS["extrapolate"])
    assert "| `--eval-seeds INT` | Start states; the same ones for every policy and clock. Default: `20`. |" in text
    assert "| `--clocks STR ...` |" in text
    assert "| `POLICIES` |" in text
