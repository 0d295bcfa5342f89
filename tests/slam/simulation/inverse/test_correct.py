"""Correction of readings: compared with the same flight simulated without the terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.evaluation.map_gain import can_be_compared, map_gain
from slam.simulation.inverse.correct import correct_flight, corrections
from slam.simulation.recipe import recipe_from
from slam.simulation.terms import CATALOGUE
from tests.slam.io.made_flight import made_flight
from tests.slam.small_flight import flown, recipe

TERMS = {
    "clock_drift": {"ppm": 900.0},
    "gyro_bias": {"x": 0.02, "y": -0.03, "z": 0.05},
    "gyro_scale": {"eps": 0.05},
    "accel_bias": {"x": 0.3, "y": -0.2, "z": 0.1},
    "accel_scale": {"eps": -0.04},
    "imu_misalignment": {"x": 0.04, "y": -0.03, "z": 0.05},
    "sonar_bias": {"b": 0.06},
    "sonar_scale": {"eps": -0.08},
    "sonar_temperature": {"rise": 15.0},
    "sonar_slant": {"c": 0.0},
    "sonar_lag": {"T": 0.12},
    "flow_scale": {"eps": -0.15},
    "flow_derotation": {"kappa": 0.8},
}
"""Those of the instruments without pictures, in a size that is easily seen."""
LEFT = 0.15
"""Largest remaining share of a term's effect on readings, because gyro and sonar sample at their own
times."""
MOVED = {
    "maneuver": {"cruise_m_s": 0.8, "heading": "along_path"},
    "camera": {"rate_hz": 1.0},
    "imu": {"gyro_noise_density": 1e-6, "accel_noise_density": 1e-5},
    "sonar": {"noise_std_m": 1e-5},
    "velocity": {"noise_std_m_s": 1e-5},
    "attitude": {"noise_std_deg": 1e-3},
}
"""Brisk, and nearly without noise: what a term does is seen as it is."""


def readings(flight):
    """Stamps and values of each instrument that terms change."""
    imu, sonar, velocity = flight.imu, flight.sonar, flight.velocity
    return {
        "gyro": (imu.stamps_s, imu.gyro_rad_s),
        "accel": (imu.stamps_s, imu.accel_m_s2),
        "sonar": (sonar.stamps_s, sonar.range_m[:, None]),
        "velocity": (velocity.stamps_s, velocity.v_m_s),
    }


def difference(a, b):
    """Return the difference of the readings of two flights with the same stamps, summed over all instruments'
    units:
    only one of them differs."""
    off = 0.0
    for name, (stamps_s, values) in readings(a).items():
        other_s, other = readings(b)[name]
        np.testing.assert_allclose(stamps_s, other_s, atol=2e-9)
        off += float(np.sqrt(np.nanmean((values - other) ** 2)))
    return off


@pytest.fixture(scope="module")
def healthy():
    return flown(2, **MOVED)


@pytest.mark.parametrize("term", TERMS)
def test_readings_are_those_of_healthy_instruments(term, healthy):
    faulty = flown(2, terms={term: TERMS[term]}, **MOVED)
    fixed = correct_flight(faulty, recipe(terms={term: TERMS[term]}, **MOVED).model)
    assert [line.split()[0] for line in fixed.corrected_terms] == [term]
    assert fixed.uncorrected == ()
    if term in ("clock_drift", "sonar_lag"):
        stream = "imu" if term == "clock_drift" else "sonar"
        late_s = TERMS[term].get("T", 0.0)
        true_s = getattr(healthy, stream).stamps_s - late_s
        np.testing.assert_allclose(getattr(fixed.flight, stream).stamps_s, true_s, atol=2e-9)
        return
    assert difference(fixed.flight, healthy) < LEFT * difference(faulty, healthy)


def test_clock_drift_is_corrected_in_all_streams_of_the_vehicle():
    flight, model = made_flight(), recipe(terms={"clock_drift": {"ppm": 500.0}}).model
    fixed = correct_flight(flight, model).flight
    for name in ("imu", "attitude", "velocity", "sonar", "battery", "motor", "gps", "barometer"):
        as_stamped = getattr(fixed, name).stamps_s * (1 + 500e-6)
        np.testing.assert_allclose(as_stamped, getattr(flight, name).stamps_s, rtol=1e-12)
    for name in ("command", "frames", "truth"):
        assert getattr(fixed, name) is getattr(flight, name)


def test_ranges_in_the_dead_zone_become_missing(healthy):
    limit = float(np.nanquantile(healthy.sonar.range_m, 0.4))
    terms = {"sonar_dead_zone": {"limit": limit}}
    faulty = flown(2, terms=terms, **MOVED)
    stuck = faulty.sonar.range_m == limit
    assert 0.3 < stuck.mean() < 0.5
    range_m = correct_flight(faulty, recipe(terms=terms, **MOVED).model).flight.sonar.range_m
    assert np.isnan(range_m[stuck]).all()
    far = healthy.sonar.range_m > limit + 1e-3
    np.testing.assert_array_equal(range_m[far], healthy.sonar.range_m[far])


def test_quantisation_increases_the_noise(healthy):
    model = recipe(terms={"sonar_quantisation": {"step": 0.06}}).model
    noise_std_m = correct_flight(healthy, model).flight.sonar.noise_std_m
    assert noise_std_m == pytest.approx(0.06 / np.sqrt(12), rel=1e-3)


@pytest.mark.parametrize(
    ("term", "change"),
    [
        ({"focal_length": {"eps": 0.05}}, "focal"),
        ({"radial_distortion": {"k1": -0.12}}, "distortion"),
        ({"vignetting": {"a": 0.4}}, "light"),
        ({"camera_time_offset": {"offset": 0.06}}, "clock"),
    ],
)
def test_pictures_match_the_corrected_camera(term, change):
    quiet = {"rate_hz": 2.0, "noise_std": 0.0}
    faulty = flown(2, terms=term, camera=quiet)
    fixed = correct_flight(faulty, recipe(terms=term).model).flight
    if change == "clock":
        np.testing.assert_allclose(fixed.frames.stamps_s, faulty.frames.stamps_s - 0.06, atol=1e-12)
        return
    if change == "focal":
        (focal, _), (width, _) = fixed.camera.focal_px, fixed.camera.size_px
        quiet["horizontal_fov_deg"] = float(np.degrees(2 * np.arctan(width / 2 / focal)))
    if change == "distortion":
        quiet["distortion"] = list(fixed.camera.distortion)
    same = flown(2, camera=quiet)
    for k in (3, 9):
        np.testing.assert_allclose(fixed.camera.focal_px, same.camera.focal_px)
        off = np.abs(fixed.frames.load(k).astype(int) - same.frames.load(k))
        assert np.percentile(off, 99) <= 2
        assert change != "light" or np.abs(faulty.frames.load(k).astype(int) - same.frames.load(k)).max() > 20


def test_every_instrument_term_is_corrected_or_reported_as_uncorrected():
    every = {
        n: {p.name: p.low if p.high == p.neutral else p.high for p in t.parameters}
        for n, t in CATALOGUE.items()
    }
    model = recipe_from({**_plain(), "terms": every}, "test").model
    flight = flown(2, camera={"rate_hz": 1.0})
    fixed = correct_flight(flight, model)
    of_instruments = {name for name, term in CATALOGUE.items() if term.is_of_instrument}
    assert {line.split()[0] for line in fixed.corrected_terms} | set(fixed.uncorrected) == of_instruments
    assert {term.name for term in corrections()} <= of_instruments
    assert "motion_blur" in fixed.uncorrected
    alone = correct_flight(
        replace(flight, sonar=None, imu=None, velocity=None, camera=None, frames=None), model
    )
    assert [line.split()[0] for line in alone.corrected_terms] == ["clock_drift"]


def test_a_healthy_model_changes_nothing():
    flight = flown(2, camera={"rate_hz": 1.0})
    assert correct_flight(flight, recipe().model).flight is flight


def test_standard_deviations_of_the_model_reach_the_flight():
    terms = {"sonar_scale": {"eps": 0.05}, "focal_length": {"eps": 0.01}, "sonar_bias": {"b": 0.01}}
    model = recipe(terms=terms).model
    flight = flown(2, camera={"rate_hz": 1.0})
    plain = correct_flight(flight, model).flight
    assert (plain.sonar.scale_std, plain.camera.focal_std_ratio) == (0.0, 0.0)
    sure = model.with_std("sonar_scale", eps=0.004).with_std("focal_length", eps=0.002)
    known = correct_flight(flight, sure.with_std("sonar_bias", b=0.003)).flight
    assert (known.sonar.scale_std, known.sonar.datum_std_m) == (0.004, 0.003)
    assert known.camera.focal_std_ratio == 0.002


@pytest.mark.slow
def test_map_from_corrected_readings_matches_that_of_healthy_instruments():
    terms = {"sonar_scale": {"eps": 0.08}, "focal_length": {"eps": -0.03}, "camera_tilt": {"x": 0.05}}
    faulty = flown(2, terms=terms)
    assert can_be_compared(faulty)
    fixed = correct_flight(faulty, recipe(terms=terms).model).flight
    gain = map_gain(faulty, fixed)
    assert gain.after.position_m < 0.1 * gain.before.position_m
    assert abs(gain.after.scale - 1) < 0.005 < abs(gain.before.scale - 1)
    assert gain.after.nees < 20 < gain.before.nees
    assert gain.after.landmarks_percent < 0.5 < gain.before.landmarks_percent
    assert set(gain.to_json()) == {"flight", "before", "after"}


@pytest.mark.slow
def test_rolling_shutter_is_corrected():
    """The map of the flight as recorded estimates the read-out time itself, and is as exact."""
    terms = {"rolling_shutter": {"readout": 0.04}}
    faulty = flown(2, terms=terms, maneuver={"cruise_m_s": 0.8})
    corrected = correct_flight(faulty, recipe(terms=terms).model).flight
    assert (faulty.camera.readout_s, corrected.camera.readout_s) == (0.0, 0.04)
    gain = map_gain(faulty, corrected)
    assert gain.after.position_m < 0.004
    assert gain.before.position_m < 0.004


def test_failed_map_has_no_errors():
    flight = flown(2, camera={"rate_hz": 1.0})
    dark = replace(flight, frames=replace(flight.frames, load=lambda k: None))
    gain = map_gain(dark, dark)
    assert np.isnan([gain.before.position_m, gain.after.nees]).all()
    assert gain.to_json()["before"]["position_m"] is None
    assert not can_be_compared(replace(flight, truth=None))


def _plain():
    return {"name": "all", "maneuver": {"way_points": [[0.3, 0.3], [1.0, 0.3]]}}
