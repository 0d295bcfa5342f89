"""``--quiet``, ``--json`` and ``--verbose``: what goes to standard output and what to standard error."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from slam.cli import app
from slam.core.flight import Flight
from slam.core.streams import Imu
from slam.io.flight_writer import write_flight
from tests.slam.cli.commands import SQUARE
from tests.slam.cli.tiny_flight import RECIPE

LONG = {
    "demo", "optimize", "estimate", "evaluate", "locate", "loops", "simulate", "replay", "reproduce",
    "criticise", "import", "export", "live",
}  # fmt: skip
TABLES = {
    "optimize", "live", "estimate", "evaluate", "locate", "loops", "replay", "reproduce", "criticise", "info",
}  # fmt: skip


def run(*arguments: object):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture
def graph(tmp_path) -> Path:
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


@pytest.fixture
def still(tmp_path) -> Path:
    """A flight that stands still, with an IMU alone."""
    stamps_s = np.arange(0.0, 10.0, 0.01)
    noise = np.random.default_rng(1).normal(0.0, 0.01, (2, len(stamps_s), 3))
    imu = Imu(stamps_s, noise[0], noise[1] + [0.0, 0.0, 9.81], 1e-3, 1e-2)
    write_flight(Flight("still", imu=imu), tmp_path / "still")
    return tmp_path / "still"


def test_commands_have_the_options_that_fit_them():
    options = {
        name: {option for p in command.params for option in p.opts}
        for name, command in get_command(app).commands.items()
    }
    assert {name for name, held in options.items() if "--quiet" in held} == LONG
    assert {name for name, held in options.items() if "--json" in held} == TABLES


def test_progress_goes_to_standard_error_and_tables_to_standard_output(graph, tmp_path):
    result = run("optimize", graph, "--out", tmp_path / "out")
    assert "solve" in result.stderr.splitlines()
    assert "solve" not in result.stdout.splitlines()
    assert "keyframes" in result.stdout or "poses" in result.stdout


def test_quiet_prints_nothing(graph, still, tmp_path):
    (tmp_path / "tiny.toml").write_text(RECIPE.format(texture="plain"))
    for command in (
        ("optimize", graph, "--out", tmp_path / "map"),
        ("criticise", still, "--out", tmp_path / "verdict"),
        ("simulate", tmp_path / "tiny.toml", "--out", tmp_path / "flight"),
    ):
        result = run(*command, "--quiet")
        assert (result.stdout, result.stderr) == ("", "")


def test_quiet_still_prints_errors(tmp_path):
    result = CliRunner().invoke(app, ["optimize", "none.g2o", "--out", str(tmp_path / "out"), "--quiet"])
    assert result.exit_code == 1
    assert result.stderr.startswith("slam: none.g2o: does not exist")


def test_json_is_the_summary_and_nothing_else(graph, still, tmp_path):
    printed = run("optimize", graph, "--out", tmp_path / "map", "--json").stdout
    assert json.loads(printed) == json.loads((tmp_path / "map" / "summary.json").read_text())
    printed = run("criticise", still, "--out", tmp_path / "verdict", "--json").stdout
    assert json.loads(printed)["status"] == "unusable"


def test_info_as_json(graph, still):
    assert json.loads(run("info", graph, "--json").stdout)["vertices"] == 4
    record = json.loads(run("info", still, "--json").stdout)
    assert [stream["name"] for stream in record["streams"]] == ["imu0"]
    assert record["streams"][0]["count"] == 1000


def test_verbose_prints_the_log_on_standard_error(graph, tmp_path):
    out = tmp_path / "out"
    log = run("--verbose", "optimize", graph, "--out", out).stderr
    assert "backend.pose_graph.solve: 4 poses in 1 parts, 4 of 4 edges kept" in log
    assert "backend.pose_graph" not in run("optimize", graph, "--out", out).stderr


def test_the_library_is_silent_on_its_own(graph):
    code = f"import backend; backend.solve_pose_graph(backend.read_g2o({str(graph)!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_the_shell_completes_commands_and_options():
    def completed(words: str) -> str:
        wanted = {"_SLAM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        command = [
            sys.executable,
            "-c",
            "import sys; sys.argv[0] = 'slam'; from slam.cli import main; main()",
        ]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, **wanted}
        ).stdout

    assert "optimize" in completed("slam opt")
    assert "--features" in completed("slam optimize --fea")
    assert "--install-completion" in run("--help").stdout
