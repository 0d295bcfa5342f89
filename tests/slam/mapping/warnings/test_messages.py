"""Instruments that the map must not be trusted with: the status names them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam import optimize
from slam.core.messages import Kind, Message
from slam.core.stream_anomalies import stuck_ranges
from slam.core.streams import Gps, Sonar
from slam.mapping.calibration.attitude_floor_tilt import AttitudeFloorTilt
from slam.mapping.warnings.accuracy_basis import VAGUE_SCALE_STD, scale_warning, vague_lengths_warning
from slam.mapping.warnings.messages import MOST_STUCK, judged_anomalies
from tests.slam.small_flight import flown


def ranges(stuck: int, count: int = 200) -> Sonar:
    """Ten readings a second, of which the first ones are equal."""
    range_m = 1.0 + np.random.default_rng(0).normal(0, 0.01, count)
    range_m[:stuck] = 0.9
    return replace(flown(0).sonar, stamps_s=0.1 * np.arange(count), range_m=range_m)


@pytest.mark.parametrize(("stuck", "in_status"), [(10, False), (90, False), (110, True), (200, True)])
def test_a_sonar_that_is_stuck_for_half_of_a_flight_carries_the_scale(stuck: int, in_status: bool) -> None:
    sonar = ranges(stuck)
    assert bool(stuck_ranges(sonar, MOST_STUCK)) == in_status
    assert ("0.9 m" in str(stuck_ranges(sonar))) == (stuck >= 90)


@pytest.mark.parametrize(
    ("tilt_rad", "std_rad", "too_large"), [(0.1, 0.001, False), (0.2, 0.001, True), (0.2, 0.05, False)]
)
def test_ground_and_mounts_lean_only_so_far(tilt_rad: float, std_rad: float, too_large: bool) -> None:
    found = AttitudeFloorTilt(np.array([tilt_rad, 0.0]), np.array([tilt_rad, 0.0]), std_rad, std_rad, 0.001)
    assert found.is_too_large == too_large


def test_a_suspect_fix_that_the_map_leaves_out_needs_no_action() -> None:
    n = 12
    east_deg = 1e-5 * np.arange(n)
    east_deg[5] += 0.1
    gps = Gps(2.0 * np.arange(n), np.full(n, 52.0), 4.0 + east_deg, np.zeros(n), (1.0, 1.0, 2.0))
    flight = replace(flown(0), gps=gps)
    suspect = tuple(flight.picture_names(gps.stamps_s))[5]

    def of_fixes(*left_out: str) -> list[Message]:
        context, map_ = SimpleNamespace(flight=flight), SimpleNamespace(fixes_left_out=left_out)
        lines = judged_anomalies(context, map_, None)
        return [line for line in lines if "farther from the others" in line.text]

    (warning,), (note,) = of_fixes(), of_fixes(suspect)
    assert warning.kind is not Kind.NOTE
    assert warning.text.endswith("check them")
    assert note.kind is Kind.NOTE
    assert note.text == warning.text


@pytest.mark.parametrize(
    ("velocity", "accelerometer", "barometer", "told"),
    [
        (True, True, True, "the vehicle's own velocity, the accelerometer and the barometer's changes"),
        (False, True, True, "the accelerometer and the barometer's changes of height and are known to"),
        (True, False, False, "no metric scale but that of the vehicle's own velocity, known to 3 %"),
        (False, True, False, "lengths come from the accelerometer and are known to 3 %"),
    ],
)
def test_all_instruments_that_tell_lengths_are_named(velocity, accelerometer, barometer, told) -> None:
    bundle = SimpleNamespace(scale_std=0.03, uses_reported_motion=velocity, uses_barometer=barometer)
    map_ = SimpleNamespace(bundle=bundle, inertial=SimpleNamespace(helps=accelerometer))
    assert told in str(scale_warning(SimpleNamespace(sonar=None), map_, {}))


@pytest.mark.parametrize(("std", "told"), [(None, ""), (VAGUE_SCALE_STD, ""), (0.29, "known to 29 % only")])
def test_lengths_too_vague_to_measure_with_are_in_the_status(std, told) -> None:
    line = vague_lengths_warning(SimpleNamespace(bundle=SimpleNamespace(scale_std=std)))
    assert told in str(line or "")
    assert bool(line) == bool(told)


@pytest.mark.slow
def test_a_stuck_sonar_is_in_the_status() -> None:
    flight = flown(4)
    stuck = replace(flight.sonar, range_m=np.full_like(flight.sonar.range_m, flight.sonar.range_m[5]))
    estimate = optimize(replace(flight, sonar=stuck))
    assert "sonar0: reads exactly" in estimate.status


@pytest.mark.slow
def test_a_mount_that_leans_far_is_in_the_status() -> None:
    flight = flown(4)
    b_T_c = flight.camera.b_T_c.copy()
    b_T_c[:3, :3] = Rotation.from_euler("y", 20, degrees=True).as_matrix() @ b_T_c[:3, :3]
    estimate = optimize(replace(flight, camera=replace(flight.camera, b_T_c=b_T_c)))
    assert "attitude0 is tilted by" in estimate.status
