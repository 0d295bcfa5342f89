"""Fixes against fixes: what is too far or too fast is named, and a normal flight has no such fix."""

from dataclasses import replace

import numpy as np
import pytest

from slam.core.fix_check import check_fixes
from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, geodetic_from_enu
from slam.core.streams import Frames, Gps

ORIGIN = GeoOrigin(47.0, 8.0, 400.0)
STD = (5.0, 5.0, 10.0)


def lanes(n=12, step_m=25.0):
    return np.column_stack(
        [step_m * (np.arange(n) // 4), step_m * (np.arange(n) % 4), np.full(n, 60.0)]
    ).astype(float)


def checked(enu, stamps_s, stamp_error_s=1.0):
    return check_fixes(stamps_s, *geodetic_from_enu(enu, ORIGIN), np.tile(STD, (len(enu), 1)), stamp_error_s)


def photographs(enu, epoch_ns=10**18, step_s=2.0):
    n = len(enu)
    stamps_s = step_s * np.arange(n)
    frames = Frames(stamps_s, tuple(f"P{k:02}.jpg" for k in range(n)), lambda _: None)
    gps = Gps(stamps_s, *geodetic_from_enu(enu, ORIGIN))
    return Flight("photos", epoch_ns=epoch_ns, frames=frames, gps=gps, all_keyframes=True)


def test_fixes_that_state_another_accuracy_are_judged_by_it():
    """RTK is lost for 8 s, and the fixes then scatter as they say; a jump of 100 m is still found."""
    n, lost = 200, slice(60, 140)
    rng = np.random.default_rng(0)
    stds_m = np.tile([0.02, 0.02, 0.04], (n, 1))
    stds_m[lost] = [4.0, 4.0, 8.0]
    enu = np.column_stack([0.3 * np.arange(n), np.zeros(n), np.full(n, 60.0)]) + rng.normal(0, stds_m)
    enu[100, 1] += 100.0
    found = check_fixes(0.1 * np.arange(n), *geodetic_from_enu(enu, ORIGIN), stds_m, 0.0)
    assert np.flatnonzero(~found.consistent).tolist() == [100]
    assert found.altitude_consistent.sum() >= n - 2


@pytest.mark.parametrize("epoch_ns", [0, 10**18])
@pytest.mark.parametrize("which", [0, 5, 11])
@pytest.mark.parametrize("size_m", [443.0, 2e4, 3.3e5])
def test_a_stale_position_is_named_and_is_not_the_origin(which, size_m, epoch_ns):
    enu = lanes()
    enu[which, 0] += size_m
    flight = photographs(enu, epoch_ns)
    (line,) = [line for line in describe(flight).anomalies if line.startswith("gps0")]
    assert f"P{which:02}.jpg" in line
    assert "1 of 12 fixes" in line
    good = np.flatnonzero(np.arange(12) != which)[0]
    origin = flight.geo_origin()
    assert origin.latitude_deg == flight.gps.latitude_deg[good]
    assert origin.altitude_m == flight.gps.altitude_m[good]


def test_a_flight_without_faults_has_no_such_line():
    rng = np.random.default_rng(0)
    for n, step_m in ((3, 25.0), (12, 25.0), (75, 5.0), (400, 15.0)):
        enu = lanes(n, step_m) + rng.normal(0, [3, 3, 6], (n, 3))
        assert not any("gps0" in line for line in describe(photographs(enu)).anomalies)
    # A transit of 2 km to the place of the survey belongs to it.
    transit = np.column_stack([np.linspace(-2000, -60, 33), np.zeros(33), np.full(33, 60.0)])
    found = checked(np.vstack([transit, lanes(60)]), 2.0 * np.arange(93))
    assert found.consistent.all()


def test_fixes_out_of_reach_in_time_are_found_by_the_longest_chain():
    """Errors of 300 m within the width of a long flight; those in a row agree with each other."""
    stamps_s = np.arange(0, 60, 0.5)
    enu = np.column_stack([20 * stamps_s, 0 * stamps_s, 60 + 0 * stamps_s])
    bad = np.array([0, 1, 2, 3, 40, 41, 42, 77, 119])
    enu[bad, 1] += 300.0
    found = checked(enu, stamps_s, 0.0)
    assert np.flatnonzero(found.fast).tolist() == bad.tolist()
    assert not found.far.any()


def test_thirty_percent_of_all_fixes_may_be_anywhere():
    rng = np.random.default_rng(3)
    for n in (10, 30, 300):
        enu = lanes(n)
        bad = np.sort(rng.choice(n, int(0.3 * n), replace=False))
        enu[bad, :2] += rng.normal(0, 5e4, (len(bad), 2))
        assert np.flatnonzero(~checked(enu, 2.0 * np.arange(n)).consistent).tolist() == bad.tolist()


def test_a_step_in_the_altitudes_is_named():
    enu = lanes()
    enu[5:, 2] += 400.0
    flight = photographs(enu)
    (line,) = [line for line in describe(flight).anomalies if line.startswith("gps0")]
    assert "5 of 12 fixes lie at an altitude out of reach" in line
    assert "P00.jpg, P01.jpg" in line
    assert flight.geo_origin().altitude_m == pytest.approx(860.0)


def test_photographs_in_assumed_order_are_not_judged_by_speed():
    flight = photographs(lanes(12, 90.0), epoch_ns=0, step_s=1.0)
    assert describe(flight).anomalies == ()
    assert replace(flight, epoch_ns=10**18).fix_check().fast.any()


def test_no_fix_and_few_fixes_are_no_trouble():
    assert Flight("f").fix_check() is None
    nothing = Gps(*(np.full(3, np.nan) for _ in range(4)))
    assert Flight("f", gps=nothing).geo_origin() is None
    none = Gps(*(np.zeros(0) for _ in range(4)))
    assert Flight("f", gps=none).geo_origin() is None
    for n in (1, 2, 3):
        assert photographs(lanes(n)).geo_origin().latitude_deg == pytest.approx(47.0)
        enu = enu_from_geodetic(*geodetic_from_enu(lanes(n), ORIGIN), ORIGIN)
        assert checked(enu, np.arange(n) * 1.0).consistent.all()
