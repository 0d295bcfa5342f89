"""Commands that tests run, in this process or as the shell does, and how they refuse."""

from __future__ import annotations

import re
import subprocess
import sys

from typer.testing import CliRunner

from slam.cli import app

SQUARE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0 1.5708
VERTEX_SE2 2 1 1.2 3.1416
VERTEX_SE2 3 -0.1 1 -1.5708
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 1000
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 1000
EDGE_SE2 2 3 1 0 1.5707963 100 0 0 100 0 1000
EDGE_SE2 3 0 1 0 1.5707963 100 0 0 100 0 1000
"""


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def shell(*arguments: object, **options):
    command = [sys.executable, "-m", "slam", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def last_line(text: str) -> str:
    """The line of the error, after those of the progress."""
    return text.splitlines(keepends=True)[-1]


def assert_refused(result, saying: str = "", code: int = 1) -> None:
    assert result.exit_code == code, result.output
    assert re.fullmatch(rf"slam: [^\n]*{saying}[^\n]*\n", last_line(result.stderr)), result.stderr
    assert "Traceback" not in result.output
