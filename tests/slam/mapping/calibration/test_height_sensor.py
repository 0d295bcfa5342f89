"""Which stated gain and zero of a height sensor a map refutes, and what the status says then."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from backend.bundle.problem import ScalePrior
from backend.bundle.range_evidence import RangeEvidence, RangePrior
from backend.pose_graph.solution import RangeErrors
from slam.core.flight import Flight
from slam.core.streams import Sonar
from slam.mapping.calibration import height_sensor
from slam.mapping.calibration.height_sensor import (
    range_prior,
    ranges_by_evidence,
    suspected_ranges,
    with_range_prior,
)
from slam.mapping.map import Map
from slam.mapping.warnings.refuted_ranges import refuted_ranges_warning
from slam.report.facts import gather
from tests.slam.made_estimate import made_estimate, made_flight

EXACT = RangePrior(0.0, 0.0)
ZERO_MM, GAIN_PERCENT = (0.0, 1e3), (100.0, 0.0)
EITHER_AT_A_METRE = (100.0, 100.0)
"""What a reading of a height of one metre shows of both: a gain of 1 % is a zero of 10 mm."""


def chosen(
    monkeypatch: pytest.MonkeyPatch,
    reads: tuple[float, float],
    is_off: float,
    stated: RangePrior = EXACT,
) -> tuple[RangePrior | None, RangePrior | None]:
    """The prior of the trial, and the one that the evidence frees, where the readings show one number alone.

    ``reads`` are its derivatives by the logarithm of the gain and by the zero, and it ``is_off`` by that many
    of its standard deviations.
    """
    row = np.array(reads)
    found = RangeEvidence(np.outer(row, row), is_off * row, 1e-4)
    monkeypatch.setattr(height_sensor, "range_evidence", lambda *_: found)
    measured = SimpleNamespace(ranges=(None,) * 4)
    problem = SimpleNamespace(measurements=measured, scale_prior=None)
    bundle = SimpleNamespace(optimum=SimpleNamespace(problem=problem))
    map_ = cast(Map, SimpleNamespace(bundle=bundle, inertial=None))
    return suspected_ranges(stated, map_), ranges_by_evidence(stated, map_)


def test_a_channel_is_free_where_it_alone_explains_the_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    assert chosen(monkeypatch, ZERO_MM, 30.0) == (RangePrior(0.05, 0.1), RangePrior(0.0, 0.02))
    assert chosen(monkeypatch, ZERO_MM, 100.0)[1] == RangePrior(0.0, 0.1)
    assert chosen(monkeypatch, GAIN_PERCENT, 5.0)[1] == RangePrior(0.05, 0.0)


def test_both_are_free_where_either_may_be_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    both = chosen(monkeypatch, EITHER_AT_A_METRE, 5.0)[1]
    assert both is not None
    assert both.gain_std > 0
    assert both.zero_std_m > 0


def test_what_is_as_stated_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    assert chosen(monkeypatch, ZERO_MM, 1.0) == (None, None)
    suspected, freed = chosen(monkeypatch, ZERO_MM, 3.9)
    assert suspected is not None
    assert freed is None, "strong evidence is not very strong"
    nominal = RangePrior(Sonar.scale_std, Sonar.datum_std_m)
    assert chosen(monkeypatch, ZERO_MM, 100.0, stated=nominal) == (None, None)


def test_an_error_that_no_sensor_has_is_not_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    assert chosen(monkeypatch, ZERO_MM, 400.0)[1] is None
    assert chosen(monkeypatch, GAIN_PERCENT, 20.0)[1] is None, "an accelerometer in another unit"


@pytest.mark.parametrize("used", [None, "scale_prior", "inertial"])
def test_lengths_of_an_accelerometer_count_once(monkeypatch: pytest.MonkeyPatch, used: str | None) -> None:
    given, lengths = [], ScalePrior(0.9, 0.02)

    def evidence(*arguments: object) -> RangeEvidence:
        given.append(arguments[-1])
        return RangeEvidence(np.eye(2), np.zeros(2), 1e-4)

    monkeypatch.setattr(height_sensor, "range_evidence", evidence)
    problem = SimpleNamespace(
        measurements=SimpleNamespace(ranges=(None,) * 4), scale_prior=None, inertial=None
    )
    if used is not None:
        setattr(problem, used, lengths)
    bundle = SimpleNamespace(optimum=SimpleNamespace(problem=problem))
    map_ = cast(Map, SimpleNamespace(bundle=bundle, inertial=SimpleNamespace(lengths=lengths)))
    assert suspected_ranges(EXACT, map_) is None
    assert given == [lengths if used is None else None]


def test_a_flight_has_the_prior_that_it_is_given() -> None:
    assert range_prior(with_range_prior(made_flight(), RangePrior(0.1, 0.2))) == RangePrior(0.1, 0.2)
    silent = Flight("without a sensor")
    assert range_prior(silent) is None
    assert with_range_prior(silent, EXACT) is silent


def test_the_status_names_channel_size_and_next_step() -> None:
    found = RangeErrors(1.0, 1e-5, 0.0613, 0.0042, gain_prior_std=0.0, zero_prior_std_m=0.1)
    line = refuted_ranges_warning(EXACT, found, 0.006)
    assert line.about == "sonar0"
    assert "its zero is +61 ±\N{NO-BREAK SPACE}4\N{NO-BREAK SPACE}mm (stated as exact)" in line.text
    assert "gain" not in line.text
    assert "which of both" not in line.text
    assert "known to 0.6\N{NO-BREAK SPACE}%" in line.text
    assert "as datum_std in sonar0/sensor.yaml" in line.next_step
    found = RangeErrors(1.052, 0.011, 0.0, 0.02, gain_prior_std=0.05, zero_prior_std_m=0.02)
    line = refuted_ranges_warning(RangePrior(0.01, 0.005), found, None)
    assert "its gain is 1.052 ±" in line.text
    assert "stated as ± 1\N{NO-BREAK SPACE}%" in line.text
    assert "stated as ± 5\N{NO-BREAK SPACE}mm" in line.text
    assert "it does not tell which of both is wrong" in line.text
    assert "as scale_std and datum_std" in line.next_step


def test_the_report_has_a_refuted_zero_as_estimated() -> None:
    exact = with_range_prior(made_flight(), EXACT)
    facts = gather(replace(made_estimate(), range_errors=RangeErrors(1.0, 1e-5, 0.0, 2e-4)), exact)
    assert facts.range_exact
    assert facts.sensor_zero.startswith("exact")
    freed = RangeErrors(1.0, 1e-5, 0.0613, 0.0042, gain_prior_std=0.0, zero_prior_std_m=0.1)
    facts = gather(replace(made_estimate(), range_errors=freed), exact)
    assert not facts.range_exact
    assert facts.sensor_gain.startswith("exact")
    assert facts.sensor_zero.startswith("+61")
