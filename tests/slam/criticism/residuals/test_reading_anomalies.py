"""Terms of single sonar readings: seen where they are, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from slam.criticism.cause import Cause
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.reading_anomalies import (
    _dropped,
    _highlights,
    nats_by_others,
    predicted_by_others,
    reading_anomalies,
    without_dead_zone,
)
from slam.criticism.verdict.criticism import Criticism
from slam.data_quality.pictures.bilinear_weights import COUNT
from slam.data_quality.pictures.cells import Cells
from slam.data_quality.pictures.feature_matches import FeatureMatches
from slam.data_quality.pictures.lens_distortion_map import LensDistortionMap
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


@pytest.fixture(scope="module")
def record():
    return record_of(simulate_flight(load_model("nominal"), stick_for(["climb and descend by 0.6 m"] * 2), 4))


def changed(record, change):
    values = record.values.copy()
    rows = np.flatnonzero(record.kinds == SONAR)
    values[rows, 0] = change(values[rows, 0])
    return replace(record, values=values)


def found(record):
    kept, dead = without_dead_zone([record])
    passes = [whole(kept[0], filter_parameters_of(load_model("nominal")))]
    return {o.name: o for o in [*dead, *reading_anomalies(passes)]}


def test_a_healthy_sonar_is_not_odd(record):
    assert found(record) == {}


def seen(taken: int, missing: int) -> FeatureMatches:
    """Pictures without matches."""
    none, stamps = np.zeros(0, dtype=np.int64), 0.25 * np.arange(taken)
    camera = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))
    at, tone = np.zeros((0, 2)), np.zeros((0, 4))
    return FeatureMatches(
        camera, stamps, none, none, at, at, np.zeros(0), tone, tone, missing, taken,
        LensDistortionMap(camera, taken, np.zeros((2, COUNT, 2)), 0.0), Cells.of(()),
    )  # fmt: skip


@pytest.mark.parametrize(("missing", "reported"), [(0, False), (2, False), (14, True)])
def test_lost_pictures_are_reported_where_they_are_many(record, missing, reported):
    odd = _dropped([replace(record, matches=seen(480 - missing, missing))])
    assert [o.name for o in odd] == ["dropped_frames"] * reported
    if reported:
        share = odd[0].parameters["share"]
        assert share.value == pytest.approx(missing / 480)
        assert share.low < missing / 480 < share.high
        assert odd[0].probability > 0.99


@pytest.mark.parametrize(("bent_px", "reported"), [(0.03, ["specular_highlights"]), (0.3, [])])
def test_spots_are_lamps_unless_something_sits_on_the_lens(record, bent_px, reported):
    matches = seen(100, 0)
    spots = np.tile([1.0, 0.0, 0.3], (20, 1))
    bent = replace(matches, spots=spots, lens_distortion=replace(matches.lens_distortion, size_px=bent_px))
    assert [odd.name for odd in _highlights([replace(record, matches=bent)])] == reported
    assert bent.glares == bool(reported)


def test_spikes_are_counted(record):
    def spiked(r):
        r = r.copy()
        r[[40, 90, 200]] *= 2.02
        return r

    share = found(changed(record, spiked))["sonar_spikes"].parameters["share"]
    assert share.low < 3 / np.sum(record.kinds == SONAR) < share.high


@pytest.mark.parametrize("step", [0.01, 0.02, 0.043])
def test_the_step_of_a_comb_is_found(record, step):
    odd = found(changed(record, lambda r: step * np.round(r / step)))
    assert list(odd) == ["sonar_quantisation"]
    assert odd["sonar_quantisation"].parameters["step"].value == pytest.approx(step, abs=2e-4)


def test_a_dead_zone_is_found_and_its_readings_left_out(record):
    limit = float(np.nanquantile(record.values[record.kinds == SONAR, 0], 0.2))
    odd = found(changed(record, lambda r: np.maximum(r, limit)))
    assert "sonar_dead_zone" in odd
    assert odd["sonar_dead_zone"].parameters["limit"].value == pytest.approx(limit, abs=1e-6)


def test_a_share_of_lost_pictures_is_held_out_by_flight(record):
    """A flight that lost none tells against the share of the others, one that lost as many for it."""
    flights = [replace(record, matches=seen(480 - n, n)) for n in (14, 14, 0)]
    (odd,) = _dropped(flights)
    gain = odd.gain
    assert gain.by == "flight"
    assert gain.parts[0] == gain.parts[1] > 0 > gain.parts[2]
    assert gain.nats < 0.5 * odd.z**2
    assert _dropped(flights[:1])[0].gain.by is None


def test_a_step_is_held_out_by_flight(record):
    alike = [changed(record, lambda r: 0.02 * np.round(r / 0.02))] * 2
    passes = [whole(r, filter_parameters_of(load_model("nominal"))) for r in alike]
    (odd,) = reading_anomalies(passes)
    assert odd.gain.nats == pytest.approx(0.5 * odd.z**2)
    other = [alike[0], changed(record, lambda r: 0.031 * np.round(r / 0.031))]
    assert sum(predicted_by_others(other, nats_by_others)) < 0.2 * 0.5 * odd.z**2


def test_second_echoes_are_not_reported_as_held_out(record):
    def spiked(r):
        r = r.copy()
        r[[40, 90, 200]] *= 2.02
        return r

    gain = found(changed(record, spiked))["sonar_spikes"].gain
    assert gain.by is None
    assert (
        Criticism("named", "", (Cause("sonar_spikes", 1.0, {}, gain, 7.0, 20.0),)).to_json()["gain"][
            "held_out_by"
        ]
        is None
    )
