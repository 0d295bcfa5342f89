"""Offsets between GPS and surveyed points: which are told, where, and with what cause."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.control_points import ControlReport, PointResidual
from slam.core.messages import Kind
from slam.core.summary import _control_record
from slam.core.units import SPACE
from slam.mapping.warnings.control_points import control_warnings
from slam.mapping.warnings.gps_offset import offset_remarks, offset_warnings

ASSUMED_M, RTK_M = (5.0, 5.0, 10.0), (0.012, 0.012, 0.025)


def spoken(line: str) -> str:
    return line.replace(SPACE, " ")


def controlled(offset_m, altitude_m=400.0, stated=False) -> ControlReport:
    point = PointResidual(name="P", role="control", used=True, reason="", views=3)
    return ControlReport(
        points=(point,),
        gps_offset_m=offset_m,
        gps_offset_std_m=(0.02, 0.02, 0.05) if stated else (0.6, 0.6, 0.4),
        gps_std_m=RTK_M if stated else ASSUMED_M,
        gps_is_stated=stated,
        altitude_m=altitude_m,
    )


@pytest.mark.parametrize(
    ("altitude_m", "up_m", "words"),
    [
        (5249.4, -3649.0, "are in feet"),
        (1312.4, -912.0, "are in feet"),
        (122.0, 278.0, "are in metres, not in feet"),
        (-400.0, 800.0, "wrong sign"),
        (2.0, 398.0, "check unit, sign and reference"),
        (None, 398.0, "check unit, sign and reference"),
    ],
)
def test_heights_of_another_unit_or_sign_are_in_the_status(altitude_m, up_m, words):
    report = controlled((-0.4, -0.2, up_m), altitude_m)
    (line,) = control_warnings(report)
    assert words in str(line)
    assert f"{abs(up_m):.0f}" in str(line)
    assert ("below them" if up_m < 0 else "above them") in str(line)
    assert offset_remarks(report) == []


def test_a_datum_and_another_reference_of_heights_are_none():
    assert offset_warnings(controlled((3.0, -4.0, -105.0))) == []
    assert offset_warnings(controlled((float("nan"),) * 3)) == []
    assert offset_remarks(controlled((3.0, -4.0, 47.0))) == []


def test_a_shift_is_told_with_its_size_and_direction():
    (line,) = offset_warnings(controlled((-100.0, -60.0, -47.0)))
    assert "the GPS lies 117 m off all of them alike (100 m west and 60.0 m south of them)" in spoken(
        str(line)
    )


def test_an_offset_beyond_what_fixes_state_is_told_in_words():
    report = controlled((1.574, 3.063, 47.0), stated=True)
    assert offset_warnings(report) == []
    line, of_heights = offset_remarks(report)
    assert "the GPS lies 3.44 m off" in spoken(line.text)
    assert "1.57 m east and 3.06 m north" in spoken(line.text)
    assert of_heights.kind is Kind.NOTE
    assert line.kind is not Kind.NOTE
    assert offset_remarks(controlled((0.02, -0.01, 0.05), stated=True)) == []


def checked(residuals_m, std_m=(0.04, 0.04, 0.1), fix_m=RTK_M) -> ControlReport:
    points = tuple(
        PointResidual(
            name=f"P{k}", role="check", used=False, reason="", views=3, residual_m=tuple(each), std_m=std_m
        )
        for k, each in enumerate(np.asarray(residuals_m, dtype=float).tolist())
    )
    return ControlReport(
        points=points,
        gps_offset_m=tuple(np.mean(residuals_m, axis=0).tolist()),
        gps_offset_std_m=std_m,
        gps_std_m=fix_m,
        gps_is_stated=fix_m is RTK_M,
        altitude_m=400.0,
    )


def test_check_points_alone_are_judged():
    noise_m = np.random.default_rng(0).normal(0, (0.02, 0.02, 0.05), (6, 3))
    assert control_warnings(checked(noise_m)) == []
    level, high = control_warnings(checked(noise_m + [1.2, -0.8, 2.5]))
    assert "the map lies 1.4" in str(level)
    assert "2.49" in str(high)
    assert "above all of them alike" in str(high)
    # What the fixes share is no contradiction of fixes without corrections.
    assert control_warnings(checked(noise_m + [1.2, -0.8, 2.5], fix_m=ASSUMED_M)) == []
    bent_m = noise_m.copy()
    bent_m[0, 2] += 1.0
    (line,) = control_warnings(checked(bent_m))
    assert "check points lie up to" in str(line)


def test_the_summary_says_what_the_gps_is_compared_with():
    assert "gps_against_control" in _control_record(controlled((0.0, 0.0, 0.0)))
    record = _control_record(checked([[1.2, -0.8, 2.5]] * 3))
    assert record["gps_against_check_points"]["offset_m"] == pytest.approx((1.2, -0.8, 2.5))
