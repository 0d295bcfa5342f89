"""Flights whose GPS antenna is not where it is assumed: found where they turn, else held and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import geodetic_from_enu
from slam.core.streams import Gps
from slam.evaluation import evaluate
from slam.mapping import main_loop
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import ORIGIN, flown

STD_M = 0.01
LEFT_M = (0.0, 0.2, 0.0)
ORIGIN_M = (0.0, 0.0, 0.0)


def surveyed(heading: str, antenna_m: tuple[float, float, float], seed: int = 0) -> Flight:
    """The small flight with RTK fixes of an antenna that is at ``antenna_m`` on the body."""
    flight = flown(seed, maneuver={"heading": heading})
    truth = flight.truth
    assert truth is not None
    stamps_s, w_T_b = truth.stamps_s[::20], truth.w_T_b[::20]
    noise = np.random.default_rng(seed).normal(0, STD_M, (len(stamps_s), 3))
    w_p_a = w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ antenna_m + noise
    gps = Gps(stamps_s, *geodetic_from_enu(w_p_a, ORIGIN), noise_std_m=(STD_M,) * 3, assumed=("T_BS",))
    return replace(flight, gps=gps)


def told(flight: Flight, antenna_m: tuple[float, float, float]) -> Flight:
    assert flight.gps is not None
    mount = np.eye(4)
    mount[:3, 3] = antenna_m
    return replace(flight, gps=replace(flight.gps, b_T_s=mount, assumed=()))


def warning_of(estimate: Estimate) -> str:
    """Return what the warnings say of the place of the antenna, besides its height."""
    return next((line for line in estimate.warnings if "where the antenna is" in line), "")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_an_antenna_at_several_headings_is_found(seed: int) -> None:
    flight = surveyed("along_path", LEFT_M, seed)
    estimate = optimize(flight)
    antenna = estimate.instruments.antenna
    assert antenna is not None
    assert (np.abs(np.array(antenna.place_m) - LEFT_M)[:2] < 2 * np.array(antenna.std_m)[:2]).all()
    assert estimate.status == "ok"
    assert estimate.instruments.systematic is None
    assert "so the antenna is not at the body's origin, as assumed" in " ".join(estimate.warnings)
    assert evaluate(estimate, flight).ate_m.rmse < 0.01, "positions of the body, which the truth has"
    without_truth = evaluate(estimate, replace(flight, truth=None))
    assert without_truth.ate_m.rmse < 3 * STD_M, "the fixes are those of the antenna"


@pytest.mark.slow
def test_an_antenna_that_is_told_elsewhere_is_in_the_status() -> None:
    estimate = optimize(told(surveyed("along_path", LEFT_M), (0.0, -0.1, 0.0)))
    assert "so the antenna is not where T_BS of gps0/sensor.yaml tells" in estimate.status
    antenna = estimate.instruments.antenna
    assert antenna is not None
    assert antenna.told_m == (0.0, -0.1, 0.0)
    assert abs(antenna.place_m[1] - LEFT_M[1]) < 2 * antenna.std_m[1]


@pytest.mark.slow
def test_an_antenna_at_one_heading_is_held_and_named() -> None:
    estimate = optimize(surveyed("fixed", LEFT_M))
    assert estimate.instruments.antenna is None
    assert estimate.antenna_m[:2] == pytest.approx(ORIGIN_M[:2], abs=1e-4)
    assert "nothing tells where the antenna is on the body" in warning_of(estimate)
    assert estimate.status == "ok"


@pytest.mark.slow
def test_an_antenna_told_at_the_origin_is_told() -> None:
    at_one_heading = optimize(told(surveyed("fixed", ORIGIN_M), ORIGIN_M))
    assert "nothing tells where the antenna is" not in " ".join(at_one_heading.warnings)
    beside = optimize(told(surveyed("along_path", LEFT_M), ORIGIN_M))
    assert "so the antenna is not where T_BS of gps0/sensor.yaml tells" in beside.status


@pytest.mark.slow
def test_an_antenna_at_the_origin_keeps_every_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = surveyed("along_path", ORIGIN_M)
    estimate = optimize(flight)
    assert warning_of(estimate) == ""
    monkeypatch.setattr(main_loop, "free_refuted_calibrations", lambda *_: None)
    plain = optimize(flight)
    assert np.array_equal(estimate.w_T_b, plain.w_T_b)
    assert np.array_equal(estimate.covariances, plain.covariances)
    assert estimate.warnings == plain.warnings


@pytest.mark.slow
def test_an_offset_that_is_larger_than_a_vehicle_is_held_and_named() -> None:
    estimate = optimize(surveyed("along_path", (0.0, 0.9, 0.0)))
    assert estimate.instruments.antenna is None
    assert "the antenna's place is held, because it would be" in estimate.status
    assert "nothing tells where the antenna is" not in " ".join(estimate.warnings)
