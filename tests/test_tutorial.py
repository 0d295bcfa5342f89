"""Every command of docs/tutorial.md runs, in its order, and gives what the page promises."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.cli import app

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A folder in which the whole tutorial was done."""
    home, text = tmp_path_factory.mktemp("tutorial"), PAGE.read_text(encoding="utf-8")
    name = re.search(r"Create the file `(\w+\.toml)`", text)[1]
    (home / name).write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1])
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    assert len(lines) >= 8
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        for line in lines:
            program, *arguments = shlex.split(line)
            assert program == "slam"
            done = CliRunner().invoke(app, arguments)
            assert done.exit_code == 0, (line, done.output)
    return home


def test_the_map_is_right(finished):
    """The tutorial says that the landmarks and the covariances are right."""
    evaluation = json.loads((finished / "map" / "evaluation.json").read_text())
    assert max(pair["error_percent"] for pair in evaluation["landmarks"].values()) < 0.5
    assert evaluation["nees"]["lower95"] < evaluation["nees"]["mean"] < evaluation["nees"]["upper95"]


def test_the_verdict_names_the_hidden_effect(finished):
    verdict = json.loads((finished / "verdict" / "verdict.json").read_text())
    assert verdict["verdict"] == "named"
    (cause,) = verdict["causes"]
    assert cause["name"] == "quadratic_drag"
    low, high = cause["parameters"]["c"]["ci95"]
    assert low < 0.4 < high


def test_the_extended_model_flies_closer_to_the_recording(finished):
    rms = [
        json.loads((finished / folder / "summary.json").read_text())["channels"]["truth.x"]["rms"]["10"]
        for folder in ("replay_nominal", "replay_extended")
    ]
    assert rms[1] < 0.5 * rms[0]


def test_each_file_that_the_page_names_is_there(finished):
    text = PAGE.read_text(encoding="utf-8")
    files = set(re.findall(r"`((?:map|verdict|replay_\w+)/[\w.]+)`", text))
    assert len(files) >= 6
    assert [name for name in sorted(files) if not (finished / name).exists()] == []
