"""Identification of noise and delays of the instruments."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from backend.significance import STRONG_NATS
from slam.core.progress import silent
from slam.inertial import noise_identification
from slam.inertial.filter_input import Adjustments
from slam.inertial.instruments import InertialTrust
from slam.inertial.zero_velocity import RestWindows
from tests.slam.inertial.made_navigation import made_flight
from tests.slam.inertial.test_filter_input import after_rest


@pytest.mark.parametrize("start_s", [0.0, 0.5, 1.7e9 + 0.7])
def test_each_delay_is_scored_by_the_same_readings(start_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readings at both limits of the time had counted or not by the rounding of their stamps."""
    at_s = start_s + 0.1 * np.arange(60)

    def inputs(
        flight: None, trust: InertialTrust, adjustments: Adjustments, from_s: float
    ) -> SimpleNamespace:
        return SimpleNamespace(start_s=start_s, end_s=start_s + 5.0, adjustments=adjustments)

    def run(inputs: SimpleNamespace) -> SimpleNamespace:
        stamps_s = at_s - inputs.adjustments.delay_s["velocity"]
        kept = (stamps_s >= start_s) & (stamps_s < start_s + 5.0)
        found = SimpleNamespace(stamps_s=stamps_s[kept], log_likelihoods=np.ones(int(kept.sum())))
        return SimpleNamespace(channels={"velocity": found})

    monkeypatch.setattr(noise_identification, "filter_input", inputs)
    trial = object.__new__(noise_identification._Trial)
    trial.flight, trial.run = None, run  # type: ignore[assignment, method-assign]
    trial.from_s, trial.rest = start_s, RestWindows(np.zeros(0), np.zeros(0, dtype=bool))
    delays_s = (0.0, *noise_identification._DELAYS_S)
    counts = {
        tuple(trial.likelihoods_at_any_delay(InertialTrust(), Adjustments(delay_s={"velocity": delay_s})))
        for delay_s in delays_s
    }
    assert counts == {(10.0, 10.0, 10.0, 10.0, 5.0)}


@pytest.mark.parametrize("seed", [0, 4, 5])
def test_the_order_of_readings_gains_no_likelihood(seed: int) -> None:
    """Without the accelerometer, which shared it, a healthy flight gained 4 to 7 nats by a delay of 20 ms."""
    trial = noise_identification._Trial(made_flight(seed), silent, np.zeros(0), (), starts_anywhere=True)
    on_time, late = (
        trial.likelihoods_at_any_delay(InertialTrust(), Adjustments(delay_s={"velocity": delay_s})).sum()
        for delay_s in (0.0, 0.02)
    )
    assert late - on_time < STRONG_NATS


def test_two_minutes_begin_where_the_vehicle_begins_to_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the ground every instrument looks ideal."""
    monkeypatch.setattr(noise_identification, "MAX_DURATION_S", 10.0)
    flight = after_rest(made_flight(0), 40.0)
    trial = noise_identification._Trial(flight, silent, np.zeros(0), (), starts_anywhere=True)
    inputs = trial.inputs(InertialTrust(), Adjustments())
    assert inputs.start_s == pytest.approx(-2.0, abs=0.6)
    assert trial.rest.moves_at(np.array([-1.5, 5.0])).tolist() == [False, True]


def test_a_delay_that_gains_no_more_than_the_scatter_is_not_kept() -> None:
    """The likelihood of the range gains 5.1 nats by a delay of 0.2 s in this healthy flight."""
    trial = noise_identification._Trial(made_flight(154), silent, np.zeros(0), (), starts_anywhere=True)
    found = noise_identification._with_delay(trial, InertialTrust(), Adjustments(), "range")
    assert found.delay_s == {}
