"""What single readings would have shown: at that size it is found in nine of ten cases, well below in few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred, whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.reading_anomalies import (
    reading_anomalies,
    smallest_in_readings,
    without_dead_zone,
)
from slam.criticism.search.expansion import expand
from slam.data_quality.lost_pictures import LOST_NATS, LostPictures, smallest_share
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLAN = ["slow descent to 0.3 m and back", "square of four sides"]


@pytest.fixture(scope="module")
def record():
    model = at_lower_rates(load_model("nominal"))
    return referred(record_of(simulate_flight(model, stick_for(PLAN), 2)), filter_parameters_of(model))


def with_ranges(record, change):
    values = record.values.copy()
    rows = record.kinds == SONAR
    values[rows, 0] = change(values[rows, 0])
    return replace(record, values=values)


@pytest.mark.slow
def test_second_echoes_of_that_share_are_found_in_nine_of_ten_cases(record):
    share, unit = smallest_in_readings([record])["sonar_spikes"]
    assert unit == "1"
    rng = np.random.default_rng(0)

    def found(of: float) -> float:
        """In how many of forty draws."""
        hits = 0
        for _ in range(40):
            ill = with_ranges(record, lambda r: np.where(rng.random(len(r)) < of, 2.0 * r, r))
            odd = reading_anomalies([whole(ill, filter_parameters_of(load_model("nominal")))])
            hits += "sonar_spikes" in {o.name for o in odd}
        return hits / 40

    assert 0.75 <= found(share) <= 1.0
    assert found(share / 4) < 0.5


def test_a_dead_zone_shows_from_that_limit_on(record):
    limit, _ = smallest_in_readings([record])["sonar_dead_zone"]
    for off, names in ((0.002, ["sonar_dead_zone"]), (-0.03, [])):
        ill = with_ranges(record, lambda r, off=off: np.maximum(r, limit + off))
        assert [o.name for o in without_dead_zone([ill])[1]] == names


@pytest.mark.parametrize("taken", [150, 2000])
def test_pictures_lost_at_that_share_are_detected_in_nine_of_ten_cases(taken):
    share = smallest_share(taken)
    lost = np.random.default_rng(1).poisson(share * taken, 2000)
    reported = [
        n > 0 and LostPictures(n, taken + n).nats(n / (taken + n)) >= LOST_NATS for n in lost.tolist()
    ]
    assert np.mean(reported) == pytest.approx(0.9, abs=0.025)


@pytest.mark.slow
def test_a_limit_of_the_tilt_that_would_show_does():
    nominal = at_lower_rates(load_model("nominal"))
    parameters, plan = filter_parameters_of(nominal), ["three speeds forward: 0.1, 0.2, 0.4"] * 2

    def seen(model, seed):
        record = referred(record_of(simulate_flight(model, stick_for(plan), seed, maker=nominal)), parameters)
        return expand([record], parameters, parameters)

    limit, unit = seen(nominal, 3).detectable(3.7)["tilt_limit"]
    assert unit == "rad"
    assert 0.1 < limit < 0.4 * 0.5236
    expansion = seen(nominal.with_term("tilt_limit", limit=limit), 3)
    assert (
        max(s.z for s in expansion.score_tests([], expansion.effects) if s.effect.name == "tilt_limit") > 3.7
    )
