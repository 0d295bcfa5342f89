"""Pictures of a flight that is only planned tell as much as those of the flight, once it is filmed."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.readings import ATTITUDE, IMU, SONAR, VELOCITY
from slam.criticism.kalman.record import record_of
from slam.criticism.next_flight import next_motion, planned_matches, telling_flight
from slam.criticism.search.effects import effects_for
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.criticism.without_commands.sensor_comparison import SensorComparison
from slam.data_quality.pictures.feature_matches import match_all_pictures
from slam.simulation.camera.optics import CameraModel
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.handheld_motions import HANDHELD_MOTIONS
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import load_model
from tests.slam.criticism.camera.camera_flight import camera_flight

TURNS = "yaw steps at 0.3, 0.6 and 1"
PLACED = ("focal_length.eps", "radial_distortion.k1", "camera_tilt.x", "camera_tilt.y",
          "camera_time_offset.offset", "rolling_shutter.readout")  # fmt: skip
"""What shows in where points lie."""
TONED = ("vignetting.a", "motion_blur.exposure", "exposure_variation.gamma")
"""What shows in tones, which are drawn: of another floor they are others."""


@pytest.fixture(scope="module")
def filmed():
    """Record and matches of rotations over a floor, and the parameters."""
    model = load_model("nominal")
    parameters = filter_parameters_of(model)
    flight = simulate_flight(at_lower_rates(model), stick_for([TURNS]), 1, camera=CameraModel(rate_hz=4.0))
    matches = match_all_pictures([flight])[0]
    return referred(replace(record_of(flight), matches=matches), parameters), matches, parameters


@pytest.mark.slow
def test_a_plan_predicts_the_standard_deviation_of_each_term(filmed):
    record, matches, parameters = filmed
    perturbations = [p for e in effects_for([record], parameters) for p in e.perturbations]
    directions = [p for p in perturbations if p.name in PLACED + TONED]
    real, predicted_by_others = (
        np.sqrt(np.diag(reprojection_score(record, s, parameters, directions).information))
        for s in (matches, planned_matches(record, parameters, matches))
    )
    ratio = {d.name: r for d, r in zip(directions, predicted_by_others / real, strict=True)}
    assert set(ratio) == {*PLACED, *TONED}
    for name in PLACED:
        assert 0.8 < ratio[name] < 1.25, name
    for name in TONED:
        assert 0.5 < ratio[name] < 2.0, name


@pytest.mark.slow
def test_rotations_distinguish_rolling_shutter_from_late_pictures(filmed, monkeypatch):
    record, matches, parameters = filmed
    for name in set(MANOEUVRES) - {TURNS}:
        monkeypatch.delitem(MANOEUVRES, name)
    known = {e.name: e for e in effects_for([record], parameters)}
    pair = known["rolling_shutter"], known["camera_time_offset"]
    kinds = {IMU, ATTITUDE, VELOCITY, SONAR}
    model = load_model("nominal")
    said = telling_flight(model, *pair, np.array([0.01]), kinds, matches)
    assert TURNS in said
    assert float(re.search(r": (.*) sigma", said)[1]) > 5.0
    assert "another sensor" in telling_flight(model, *pair, np.array([0.01]), kinds)


@pytest.mark.slow
def test_without_commands_the_camera_is_on_board_too(monkeypatch):
    for name in set(MANOEUVRES) - {TURNS}:
        monkeypatch.delitem(MANOEUVRES, name)
    for name in list(HANDHELD_MOTIONS):
        monkeypatch.delitem(HANDHELD_MOTIONS, name)
    model, pair = load_model("nominal"), ("rolling_shutter", "camera_time_offset")
    found = SensorComparison.of(
        [replace(camera_flight({"rolling_shutter": {"readout": 0.03}}, 3), command=None)], model
    )
    rows = found.rows({})
    searched = likelihood_of(rows, found.parameters)
    chosen = tuple(e for e in searched.last.effects if e.name == pair[0])
    searched = replace(searched, chosen=chosen)
    said = next_motion(model, searched, rows, pair, found.matches)
    assert TURNS in said
    assert float(re.search(r": (.*) sigma", said)[1]) > 5.0
    assert "another sensor" in next_motion(model, searched, rows, pair)
