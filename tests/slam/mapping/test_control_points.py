"""Maps of photographs with control points: made pictures over painted ground, GPS with errors of metres."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from backend.measurements import ControlPoint
from slam.core.control_points import PictureView, Role, SurveyedPoint
from slam.core.estimate import Estimate
from slam.core.geodesy import enu_from_geodetic
from slam.core.summary import summarise
from slam.core.surveyed_flight import with_surveyed
from slam.mapping.control_points import ControlComparison, Surveyed
from slam.mapping.pipeline import optimize
from slam.mapping.warnings.control_points import control_warnings
from slam.report.optimize_report import Accuracy, render
from slam.report.tables.control import control_tables
from tests.backend.bundle.made_control import DATUM_M as DATUM
from tests.backend.bundle.made_control import refined
from tests.slam.photo_survey import ORIGIN, Survey, moved, survey

DATUM_M = (0.5, -1.0, 47.0)
"""GPS over the ellipsoid, control points over the sea."""


@lru_cache
def small() -> Survey:
    return survey(rows=2, columns=2, points=5, datum_m=DATUM_M)


@lru_cache
def large() -> Survey:
    return survey(points=8, datum_m=DATUM_M)


def off_m(made: Survey, estimate: Estimate) -> np.ndarray:
    """Camera positions minus the true ones, nothing aligned."""
    assert estimate.origin is not None
    here = (ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m)
    shift = enu_from_geodetic(*here, estimate.origin)
    return estimate.w_T_b[:, :3, 3] - (made.w_T_c[:, :3, 3] + shift)


def rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def told(point: ControlPoint, role: Role = "control") -> Surveyed:
    views = tuple(PictureView(f"{k}", 0.0, 0.0) for k in point.keyframe)
    return Surveyed(SurveyedPoint(point.name, 47.0, 8.0, 400.0, views, role=role), point)


def test_a_wrong_point_is_named_and_left_out():
    _, bundle, points, places = refined(0, wrong_m=10.0)
    here = [told(p) for p in points[:6]] + [told(p, "check") for p in points[6:]]
    unseen = replace(points[0], name="unseen", keyframe=points[0].keyframe[:1], pixel=points[0].pixel[:1])
    comparison = ControlComparison((*here, told(unseen)))
    used = comparison.candidates
    assert used.tolist() == [True] * 6 + [False] * 3
    verdict = comparison.judge(bundle, used)
    assert verdict.used.tolist() == [False] + [True] * 5 + [False] * 3
    report = verdict.report(bundle, verdict.used)
    (line,) = control_warnings(report)
    assert "1 of 6 contradicts the others and the pictures, and is not used: P0 by 9.9" in str(line)
    wrong, *_, check, last = report.points
    assert wrong.residual_m == pytest.approx((-10.0, 0.0, 0.0), abs=0.3)
    assert check.residual_m == pytest.approx(tuple(places[7] - points[7].w_p_m), abs=0.1)
    assert last.reason == "pictures on the map that show it: 1, and 2 are needed"
    assert report.gps_offset_m == pytest.approx(DATUM, abs=5.0)
    (table,) = control_tables(report)
    assert table.rows[0][0] == "P0"
    assert table.rows[0][-1].startswith("no: 9.9")
    assert "m from where the pictures show it" in table.rows[0][-1]
    assert table.rows[7][-1] == "held out"
    assert [row[0] for row in table.rows[9:]] == [
        "RMS of 5 control points", "RMS of 2 check points", "GPS minus control points",
    ]  # fmt: skip


def test_too_few_points_are_not_used_and_said():
    _, bundle, points, _ = refined(0)
    comparison = ControlComparison(tuple(told(p) for p in points[:2]))
    assert not comparison.candidates.any()
    verdict = comparison.judge(bundle, comparison.candidates)
    assert not verdict.used.any()
    report = verdict.report(bundle, verdict.used)
    assert [p.reason for p in report.points] == ["2 can be used, and 3 are needed"] * 2
    (line,) = control_warnings(report)
    assert "none is used: 2 of 2 can be placed, and 3 are needed" in str(line)


def test_a_point_with_a_fault_is_said_to_contradict_nothing():
    """Its fault is a warning already, and its place may be that of another point."""
    _, bundle, points, _ = refined(0)
    first = told(points[0])
    faulty = replace(first, survey=replace(first.survey, fault="one place has 2 names (P0, gate)"))
    verdict = ControlComparison((faulty, *(told(p) for p in points[1:6]))).judge(bundle, np.ones(6, bool))
    assert verdict.used.tolist() == [False] + [True] * 5
    report = verdict.report(bundle, verdict.used)
    assert control_warnings(report) == []
    assert (report.points[0].reason, report.points[0].residual_m) == (faulty.survey.fault, None)


@pytest.mark.slow
def test_a_wrong_point_is_harmless_in_a_small_map():
    made = small()
    wrong = replace(made.flight, surveyed=(moved(made.flight.surveyed[0], 10.0), *made.flight.surveyed[1:]))
    estimate = optimize(wrong)
    assert rms(off_m(made, estimate)) < 0.3
    assert "1 of 5 contradicts the others and the pictures, and is not used: P0 by 10 m" in estimate.status
    assert [p.used for p in estimate.control.points] == [False, True, True, True, True]
    record = summarise(estimate).to_json()
    assert record["control_points"][0]["residual_m"] == pytest.approx((-10.0, 0.0, 0.0), abs=0.3)
    assert record["gps_against_control"]["offset_m"] == pytest.approx(DATUM_M, abs=6.0)
    (table,) = control_tables(estimate.control)
    page = render(estimate, summarise(estimate), wrong, accuracy=Accuracy((table,)))
    assert "RMS of 4 control points" in page


@pytest.mark.slow
def test_control_points_bring_errors_of_metres_down_to_centimetres():
    made = large()
    with_gps = optimize(replace(made.flight, surveyed=()))
    assert rms(off_m(made, with_gps)[:, :2]) > 0.5
    estimate = optimize(with_surveyed(made.flight, (), ("P6", "P7")))
    assert estimate.status == "ok"
    assert rms(off_m(made, estimate)) < 0.12
    checks = estimate.control.of_role("check")
    assert [p.name for p in checks] == ["P6", "P7"]
    for point in checks:
        assert not point.used
        assert np.hypot(*point.residual_m[:2]) < 0.05
        assert np.abs(np.array(point.residual_m) / point.std_m).max() < 3
    assert estimate.information_shares["x"]["control"] > 0.5


@pytest.mark.slow
def test_a_map_without_gps_is_placed_by_control_points():
    made = large()
    estimate = optimize(replace(made.flight, gps=None))
    assert estimate.status == "ok"
    assert estimate.metric
    assert rms(off_m(made, estimate)) < 0.12
    assert "control points alone" in estimate.accuracy_basis


@pytest.mark.slow
def test_two_points_are_too_few_and_compared_all_the_same():
    made = survey(rows=2, columns=2, points=2)
    estimate = optimize(made.flight)
    assert "none is used: 2 of 2 can be placed, and 3 are needed" in estimate.status
    assert [p.used for p in estimate.control.points] == [False, False]
    assert all(p.residual_m is not None for p in estimate.control.points)
    without = optimize(replace(made.flight, surveyed=()))
    np.testing.assert_allclose(estimate.w_T_b, without.w_T_b, atol=1e-6)


@pytest.mark.slow
def test_a_wrong_check_point_is_told():
    made = large()
    flight = with_surveyed(made.flight, (), ("P6", "P7"))
    points = [moved(p, 1.0) if p.name == "P6" else p for p in flight.surveyed]
    estimate = optimize(replace(flight, surveyed=tuple(points)))
    assert "check points lie up to 0.9" in estimate.status
    assert rms(off_m(made, estimate)) < 0.12


@pytest.mark.slow
def test_deviations_that_are_told_hold_over_several_surveys():
    """Squared errors of held-out points over their variances: chi-square, but for pooled prior noise."""
    squares = []
    for seed in range(6):
        made = survey(rows=3, columns=3, points=8, std_px=1.0, seed=seed)
        estimate = optimize(with_surveyed(made.flight, (), ("P6", "P7")))
        for point in estimate.control.of_role("check"):
            squares += (np.array(point.residual_m) / point.std_m).tolist()
    assert 0.3 < np.mean(np.square(squares)) < 2.0
