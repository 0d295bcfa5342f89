"""The place of an output, a pose graph, and a tiny flight with its map."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.slam.cli.commands import SQUARE, run
from tests.slam.cli.tiny_flight import simulated


@pytest.fixture
def target(tmp_path):
    return tmp_path / "place" / "out"


@pytest.fixture
def graph(tmp_path) -> Path:
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


@pytest.fixture(scope="package")
def flight(tmp_path_factory) -> Path:
    return simulated(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="package")
def done(flight, tmp_path_factory) -> Path:
    """An output of the whole job; tests copy it before they change it."""
    out = tmp_path_factory.mktemp("done") / "out"
    result = run("optimize", flight, "--out", out)
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture
def own(flight, tmp_path) -> Path:
    """A copy of the flight to damage."""
    return shutil.copytree(flight, tmp_path / "own")
