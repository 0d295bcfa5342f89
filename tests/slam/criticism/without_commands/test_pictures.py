"""Pictures against the path of the other instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism import criticise
from slam.criticism.without_commands.likelihood import PATTERNS
from slam.criticism.without_commands.sensor_comparison import SensorComparison
from slam.simulation.model import load_model
from tests.slam.criticism.camera.camera_flight import camera_flight
from tests.slam.criticism.without_commands.unsteered import expansion_of


def seen(terms):
    """Three flights of ten seconds with pictures, of which nobody knows the sticks."""
    return [replace(camera_flight(terms, seed), name=f"seen {seed}", command=None) for seed in (5, 6, 7)]


@pytest.mark.slow
def test_healthy_pictures_agree_with_the_other_instruments():
    found = criticise(seen({}))
    assert found.verdict == "nothing_wrong", found.sentence
    assert "focal_length" in found.detectable


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "parameter", "size"),
    [
        ("focal_length", "eps", 0.06),
        ("rolling_shutter", "readout", 0.03),
    ],
)
def test_pictures_are_held_against_the_other_instruments(term, parameter, size):
    found = criticise(seen({term: {parameter: size}}))
    cause = found.causes[0]
    assert cause.name == term, found.sentence
    reported = cause.parameters[parameter]
    assert reported.low < size < reported.high
    assert abs(reported.value - size) < 0.25 * size
    missed = next(c for c in cause.gain.channels if c.unit == "px")
    assert missed.after < missed.before


@pytest.mark.slow
def test_what_was_found_counts_once_however_often_pictures_are_made_linear_about_it():
    found = SensorComparison.of(seen({}), load_model("nominal"))
    plain = expansion_of(found.rows({}))
    # No filter parameters hold a pattern, or a variance below 0: rows about them are rows about none.
    shape = PATTERNS[0]
    about = expansion_of(found.rows({shape: 2.0, "motion_blur.exposure": -1e-4}))
    np.testing.assert_allclose(about.fisher.score, plain.fisher.score)
    # About a size that the parameters do hold, what is off is the same, whatever has been taken out.
    near = expansion_of(found.rows({"focal_length.eps": 0.01}))
    whole = [e for e in plain.effects if e.name in ("focal_length", "sonar_scale", "camera_tilt")]
    first, second = plain.sizes(whole), near.sizes(whole)
    assert abs(second["focal_length.eps"] - first["focal_length.eps"]) < 0.002


def test_pictures_that_nothing_agrees_with_are_reported_and_name_no_cause():
    flight = replace(camera_flight({}, 5, rate_hz=2.0), command=None)
    wild = replace(flight.velocity, v_m_s=100.0 * flight.velocity.v_m_s)
    found = criticise([replace(flight, velocity=wild)])
    assert (found.verdict, found.causes) == ("unknown", ())
    assert "pictures disagree" in found.remainder
    # A height alone makes no path.
    assert criticise([replace(flight, imu=None, attitude=None, velocity=None)]).verdict == "unusable"
