"""Fixes that repeat a place to the last digit while the pictures move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.messages import Kind
from slam.core.streams import Gps
from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.fixes import Fixes, fixes_of

COUNT = 15


def lanes(step_m: float = 9.0) -> np.ndarray:
    """Poses (15, 4, 4) of three lanes, 30 m over the floor."""
    w_T_b = np.tile(np.eye(4), (COUNT, 1, 1))
    w_T_b[:, :3, 3] = [(12.0 * (k // 5), step_m * (9 - k if k // 5 == 1 else k % 5), 30) for k in range(15)]
    return w_T_b


def compared(place_m: np.ndarray, source: list[int], seed: int = 0) -> FixComparison:
    """Fixes at ``place_m`` (15, 3) with noise, each with the place that it has from row ``source``."""
    noisy = place_m + np.random.default_rng(seed).normal(0, 2.0, (COUNT, 3))
    names, stamps_s = tuple(f"P{k:02}" for k in range(COUNT)), 4.0 * np.arange(COUNT)
    repeats = np.append(False, np.diff(source) == 0)
    none = np.zeros(COUNT, bool)
    fixes = Fixes(stamps_s, noisy[source], (5.0, 5.0, 10.0), False, names, none, repeats_place=repeats)
    return FixComparison(fixes, stamps_s)


def in_units(w_T_b: np.ndarray, unit_m: float) -> np.ndarray:
    map_ = w_T_b.copy()
    map_[:, :3, 3] /= unit_m
    return map_


@pytest.mark.parametrize("unit_m", [1.0, 30.0])
@pytest.mark.parametrize("frozen", [4, 6, 12])
def test_a_frozen_receiver_is_left_out_from_its_second_repeat_on(frozen, unit_m):
    w_T_b = lanes()
    source = [min(k, frozen) for k in range(COUNT)]
    map_ = in_units(w_T_b, unit_m)
    made = compared(w_T_b[:, :3, 3], source).without_repeats(map_, unit_m == 1.0)
    stale = np.arange(COUNT) > frozen
    assert np.array_equal(made.stale, stale)
    for agreement in (made.rough(map_, unit_m == 1.0), made.exact(w_T_b)):
        assert np.array_equal(~agreement.used, stale)
        assert np.array_equal(np.isnan(agreement.off_m[:, 0]), stale)
    messages = made.messages(made.exact(w_T_b))
    assert messages.left_out == made.fixes.names[frozen + 1 :]
    (line,) = [m for m in (*messages.warnings, *messages.remarks) if "to the last digit" in m.text]
    assert f"{14 - frozen} of 15 fixes repeat the place" in line.text
    assert "P13" in line.text
    assert (line.kind is Kind.NOTE) == (frozen == 12)
    assert ("the receiver stopped" in line.text) == (frozen < 12)


def test_a_slow_receiver_gives_one_fix_of_each_run():
    w_T_b = lanes(30.0)
    made = compared(w_T_b[:, :3, 3], [k - k % 3 for k in range(COUNT)])
    assert np.array_equal(made.without_repeats(w_T_b, False).stale, np.arange(COUNT) % 3 > 0)


@pytest.mark.parametrize("step_m", [1.0, 9.0])
def test_repeats_within_the_noise_and_of_all_fixes_stay(step_m):
    """Coarse digits of a slow vehicle, and one place for all, which gives no lengths to judge by."""
    w_T_b = lanes(step_m)
    source = [0] * COUNT if step_m > 5 else [k - k % 5 for k in range(COUNT)]
    made = compared(w_T_b[:, :3, 3], source).without_repeats(w_T_b, False)
    assert not made.stale.any()
    assert made.rough(w_T_b, False).used.all()


def test_pictures_that_the_map_does_not_place_tell_no_motion():
    w_T_b = lanes()
    made = compared(w_T_b[:, :3, 3], [min(k, 6) for k in range(COUNT)])
    covered = np.arange(COUNT) != 9
    made = replace(made, stamps_s=made.stamps_s[covered])
    assert not made.without_repeats(w_T_b[covered], False).stale[9]


def test_a_repeated_place_is_found_beside_an_altitude_that_goes_on():
    """In metres from the origin, a higher place on one vertical lies a little aside."""
    w_T_b, origin = lanes(30.0), GeoOrigin(47.0, 8.0, 400.0)
    source = np.arange(COUNT) // 3 * 3
    latitude_deg, longitude_deg, altitude_m = geodetic_from_enu(w_T_b[:, :3, 3], origin)
    stamps_s = 4.0 * np.arange(COUNT)
    gps = Gps(stamps_s, latitude_deg[source], longitude_deg[source], altitude_m + 0.3 * np.arange(COUNT))
    fixes = fixes_of(Flight("f", gps=gps), origin)
    assert fixes is not None
    made = FixComparison(fixes, stamps_s).without_repeats(w_T_b, False)
    assert np.array_equal(made.stale, source != np.arange(COUNT))
