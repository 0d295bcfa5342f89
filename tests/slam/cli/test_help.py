"""The texts of ``--help``."""

from __future__ import annotations

import re

import pytest
from typer.testing import CliRunner

from slam.cli import app


@pytest.mark.parametrize("command", sorted(c.name for c in app.registered_commands))
def test_several_arguments_are_shown_by_one_ellipsis(command):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout
    assert "..." not in "".join(re.findall(r"Usage.*?\{(.*?)\}", shown))


def test_the_table_of_settings_is_named_with_its_brackets():
    shown = CliRunner().invoke(app, ["estimate", "--help"], env={"COLUMNS": "200"}).stdout
    assert "those of [inertial] count" in shown
