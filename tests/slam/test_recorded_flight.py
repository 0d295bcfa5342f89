"""The recorded figure eight: small, readable, as its README says it was made, and its loop closes."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from slam import evaluate, optimize
from slam.experiments.stitching import with_pictures
from slam.io.flight_folder import read_flight

FOLDER = Path(__file__).parents[2] / "datasets" / "figure_eight_recorded"
FLIGHT = FOLDER / "flight"


def assert_loop_closes(flight, below_a_tenth=0):
    """``below_a_tenth`` pairs may be kept that share just less than the tenth below which a loop is false."""
    evaluation = evaluate(optimize(flight), flight)
    (gap,) = evaluation.loop_gaps
    assert gap.name == "A-E"
    assert gap.error_m.loops < 0.005
    assert gap.error_m.chain > 5 * gap.error_m.loops
    errors = [row.error_percent for row in evaluation.landmarks]
    assert max(error.loops for error in errors) < 0.5
    assert max(error.chain for error in errors) > 1.0
    assert evaluation.ate_m.rmse < 0.01
    assert evaluation.loops.false_kept <= below_a_tenth
    assert evaluation.loops.recall > 0.9
    return evaluation


def test_it_is_small():
    sizes = [path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()]
    assert sum(sizes) < 8e6
    assert max(sizes) < 1e6


def test_it_has_all_streams_and_the_papers_landmarks():
    flight = read_flight(FLIGHT)
    assert list(flight.landmarks) == list("ABCDEFGH")
    assert len(flight.landmark_pairs) == 9
    for stream in (
        flight.imu,
        flight.sonar,
        flight.attitude,
        flight.velocity,
        flight.command,
        flight.battery,
    ):
        assert stream is not None
        assert 52 < np.ptp(stream.stamps_s) < 55
    assert flight.camera.size_px == (176, 144)
    assert 5 < 1 / np.diff(flight.frames.stamps_s).mean() < 7
    assert not flight.warnings


@pytest.mark.slow
def test_every_other_picture_is_enough_to_close_the_loop():
    flight = read_flight(FLIGHT)
    # Pictures 76 and 148 share 9.97 %, and are matched rightly.
    assert_loop_closes(with_pictures(flight, np.arange(0, len(flight.frames), 2)), below_a_tenth=1)


@pytest.mark.slow
def test_all_pictures_close_it():
    evaluation = assert_loop_closes(read_flight(FLIGHT))
    assert evaluation.nees.pose.lower95 < evaluation.nees.pose.mean < evaluation.nees.pose.upper95


@pytest.mark.slow
def test_the_command_of_its_readme_makes_it_again(tmp_path, monkeypatch):
    """But for pictures, whose compression is up to the build of OpenCV, and for the last digits of numbers.

    The recording may lack what a newer simulator states of its instruments.
    """
    (command,) = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(command, "README.md", "exec"), {})
    again = tmp_path / "datasets" / "figure_eight_recorded" / "flight"
    for folder, _, names in os.walk(FLIGHT):
        for name in names:
            made = again / Path(folder).relative_to(FLIGHT) / name
            assert made.exists(), made
            if made.suffix == ".csv":
                assert numbers(made) == pytest.approx(numbers(Path(folder) / name), rel=1e-9, abs=1e-12), name
            elif made.suffix == ".yaml":
                stated, now = (yaml.safe_load(each.read_text()) for each in (Path(folder) / name, made))
                assert {**now, **stated} == now, name
            elif made.suffix != ".jpg":
                assert made.read_bytes() == (Path(folder) / name).read_bytes(), name


def numbers(table):
    """Return the numbers of a CSV file in a row; each text is -1."""
    return np.nan_to_num(np.genfromtxt(table, delimiter=",", comments="#").ravel(), nan=-1.0)
