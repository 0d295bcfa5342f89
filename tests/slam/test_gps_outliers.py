"""The whole job on photographs with wrong positions: the outlier is named, the map is as without it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic, geodetic_from_enu
from slam.core.streams import Gps
from slam.core.units import SPACE
from slam.mapping.gps.consensus import Agreement
from slam.mapping.pipeline import optimize
from tests.benchmarks.gps_outliers import matched, named_fixes
from tests.benchmarks.metric import Skipped
from tests.slam.small_flight import ORIGIN, flown, photographs

STD_M = 0.03


@lru_cache
def survey() -> tuple[Flight, np.ndarray]:
    """Fourteen photographs of the small flight with positions, and where they were taken about ``ORIGIN``."""
    flight = flown(0)
    chosen = np.arange(0, 70, 5)
    photos = photographs([(flight, int(k)) for k in chosen])
    return replace(photos, epoch_ns=10**18), true_places(flight, chosen)


def true_places(flight: Flight, chosen: np.ndarray) -> np.ndarray:
    """Where some pictures (n,) of a simulated flight were taken, (n, 3)."""
    truth, taken_s = flight.truth, flight.frames.stamps_s[chosen]
    return np.column_stack([np.interp(taken_s, truth.stamps_s, truth.w_T_b[:, k, 3]) for k in range(3)])


def with_positions(moved_m: np.ndarray, std_m: float = STD_M) -> Flight:
    """The photographs with errors ``moved_m`` (14, 3) of their positions beside noise."""
    photos, place = survey()
    fixes = place + np.random.default_rng(1).normal(0, STD_M, place.shape) + moved_m
    return replace(
        photos, gps=Gps(photos.frames.stamps_s, *geodetic_from_enu(fixes, ORIGIN), noise_std_m=(std_m,) * 3)
    )


def error_m(estimate: Estimate) -> float:
    """RMS distance from the true places, nothing aligned."""
    there = enu_from_geodetic(*geodetic_from_enu(survey()[1], ORIGIN), estimate.origin)
    return float(np.sqrt(np.mean(np.sum((estimate.w_T_b[:, :3, 3] - there) ** 2, axis=1))))


def test_a_stale_tag_is_named_and_changes_nothing():
    """The first photograph lies 443 m off; one more only 1.5 m, as far as the others are apart."""
    moved = np.zeros((14, 3))
    moved[0], moved[6] = [443.0, 0, 0], [0, 1.5, 0]
    estimate = optimize(with_positions(moved))
    lines = [line for line in estimate.warnings if "contradict the pictures" in line]
    assert len(lines) == 1
    assert "2 of 14 fixes" in lines[0]
    assert "photo_00.jpg (443 m), photo_06.jpg (1." in lines[0].replace(SPACE, " ")
    assert estimate.status == "ok"
    assert error_m(estimate) < 3 * STD_M
    assert estimate.scale_std < 0.03


def test_two_altitude_references_are_told():
    moved = np.zeros((14, 3))
    moved[7:, 2] = 40.0
    estimate = optimize(with_positions(moved))
    assert "7 fixes from photo_07.jpg to photo_13.jpg lie 40." in estimate.status
    assert error_m(estimate) < 3 * STD_M


def test_a_selection_that_does_not_settle_is_told(monkeypatch):
    monkeypatch.setattr(Agreement, "same", lambda self, other: False)
    estimate = optimize(with_positions(np.zeros((14, 3))))
    assert any("still changed after 4 refinements" in line for line in estimate.warnings)


@lru_cache
def strip() -> tuple[Flight, np.ndarray]:
    """Twelve photographs along one line, 30 m apart, and where they were taken about ``ORIGIN``."""
    flight = flown(
        0,
        maneuver={"way_points": [[0.3, 0.3], [4.3, 0.3]], "cruise_m_s": 0.5},
        landmarks={"A": [0.3, 0.3], "B": [4.3, 0.3]},
        world={"extent_m": [0, 0, 4.6, 1.0]},
    )
    chosen = np.arange(8, 64, 5)
    photos = photographs([(flight, int(k)) for k in chosen])
    return replace(photos, epoch_ns=10**18), 100.0 * true_places(flight, chosen)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moved", "m"),
    [
        ([0], [60, 0, 0]),
        ([0, 1, 2], [60, 0, 0]),
        ([4, 5, 6], [-60, 0, 0]),
        ([9, 10, 11], [0, 60, 0]),
        ([2, 6, 9], [60, 0, 0]),
    ],
)
def test_tags_that_are_moved_alike_along_one_line_change_nothing(moved, m):
    estimate, far_m, scale = along_the_strip(moved, m)
    assert estimate.status == "ok"
    assert far_m < 2.0
    assert abs(scale - 1) < 0.02
    (line,) = (line for line in estimate.warnings if "the pictures and the other fixes" in line)
    assert f"{len(moved)} of 12 fixes" in line
    assert all(f"photo_{k:02}.jpg" in line for k in moved)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [range(6, 12), range(0, 12, 2)])
@pytest.mark.parametrize("m", [[60, 0, 0], [0, 60, 0]])
def test_half_of_the_tags_moved_alike_are_told_and_leave_the_scale(moved, m):
    """Which half is right nobody can tell; the map on both of them had a scale that was 24 % off."""
    estimate, _, scale = along_the_strip(list(moved), m)
    assert "6 of 12 fixes contradict the pictures" in estimate.status
    assert "so many may be right and the others wrong" in estimate.status
    assert abs(scale - 1) < 0.02


def along_the_strip(moved: list[int], m: list[float]) -> tuple[Estimate, float, float]:
    """The map of the strip with some tags moved, its RMS position error [m], and its scale."""
    photos, place = strip()
    fixes = place + np.random.default_rng(1).normal(0, [1.0, 1.0, 1.5], place.shape)
    fixes[moved] += m
    estimate = optimize(replace(photos, gps=Gps(photos.frames.stamps_s, *geodetic_from_enu(fixes, ORIGIN))))
    there = enu_from_geodetic(*geodetic_from_enu(place, ORIGIN), estimate.origin)
    here = estimate.w_T_b[:, :3, 3]
    far_m = float(np.sqrt(np.mean(np.sum((here - there) ** 2, axis=1))))
    return estimate, far_m, float(np.linalg.norm(here[-1] - here[0]) / np.linalg.norm(there[-1] - there[0]))


@pytest.mark.slow
def test_a_receiver_that_states_too_much_is_contradicted():
    estimate = optimize(with_positions(np.zeros((14, 3)), std_m=0.002))
    assert "gps0: states 0.002 m" in estimate.status
    assert "the stated accuracy is doubted" in estimate.status


@pytest.mark.slow
def test_a_precise_tag_that_is_wrong_does_not_hold_its_photograph():
    """The first photograph of `isfm` is 14 m aside by its RTK tag: the map bends until it agrees with it."""
    try:
        made = matched("isfm")
    except Skipped as reason:
        pytest.skip(str(reason))
    moved = made.fixes_m.copy()
    moved[0] += [9.5, -10.0, 14.5]
    everything = np.ones(len(moved), bool)
    flight, found, _ = made.solved(moved, everything)
    other_flight, without, _ = made.solved(moved, np.arange(len(moved)) > 0)
    assert np.flatnonzero(named_fixes(flight, found)).tolist() == [0]
    off_m = np.linalg.norm(made.errors_m(found, flight), axis=1)
    off_without_m = np.linalg.norm(made.errors_m(without, other_flight), axis=1)
    assert np.sqrt(np.mean(off_m[1:] ** 2)) < 1.1 * np.sqrt(np.mean(off_without_m[1:] ** 2))
    # Pictures alone place the photograph itself: its height and side hang on the lens.
    assert off_m[0] < 2.0 * np.sqrt(np.trace(found.covariances[0, 3:, 3:]))
    assert off_m[0] < 0.06
