"""Clocks hours apart: aligned where the turns tie them, with honest deviations, and refused elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from backend.clocks.alignment import AlignmentResult, Turns, align_turns
from backend.measurements import InertialReadings

IMU_S, PICTURE_S = 0.01, 0.1
AWAY_S = 7000.0
"""Distance of the two clocks."""


def motion(rng: np.random.Generator, lasts_s: float, size_rad: np.ndarray, bandwidth_hz: float):
    """Return the attitude of a vehicle whose angles are random up to a frequency, as a function of time."""
    step_s = 0.02
    count = int(lasts_s / step_s)
    frequency = np.fft.rfftfreq(count, step_s)
    shape = np.where(frequency < bandwidth_hz, np.sqrt(frequency + 0.02), 0.0)
    waves = np.fft.irfft(shape[:, None] * np.fft.rfft(rng.normal(size=(count, 3)), axis=0), count, axis=0)
    angles = size_rad * waves / waves.std(axis=0)

    curve = CubicSpline(step_s * np.arange(count), angles)
    return lambda at_s: Rotation.from_euler("xyz", curve(at_s))


def aligned(
    seed: int,
    *,
    size_deg: tuple[float, float, float] = (2.0, 2.0, 5.0),
    bandwidth_hz: float = 1.0,
    log_s: float = 200.0,
    video_s: tuple[float, float] = (80.0, 130.0),
    drift: float = 0.0,
    mount: Rotation = Rotation.identity(),
    noise_rad: float = 2e-3,
    other: bool = False,
    period_s: float = 0.0,
) -> AlignmentResult:
    """Align pictures of a part of a logged flight, whose clock is ``AWAY_S`` ahead at their middle.

    ``other`` makes them those of another flight, and ``period_s`` repeats the motion.
    """
    rng = np.random.default_rng(seed)
    attitude = motion(rng, log_s, np.radians(size_deg), bandwidth_hz)
    seen_by = motion(rng, log_s, np.radians(size_deg), bandwidth_hz) if other else attitude
    imu_s = np.arange(0.0, log_s - 1.0, IMU_S)
    of_s = imu_s % period_s if period_s else imu_s
    rate = (attitude(of_s).inv() * attitude(of_s + 1e-4)).as_rotvec() / 1e-4
    gyro = rate + [0.01, -0.02, 0.01] + rng.normal(0.0, 1.5e-3 / np.sqrt(IMU_S), rate.shape)
    seen_s = np.arange(*video_s, PICTURE_S)
    at_s = seen_s % period_s if period_s else seen_s
    seen = seen_by(at_s) * Rotation.from_rotvec(rng.normal(0.0, noise_rad, (len(seen_s), 3))) * mount.inv()
    stamps_s = seen_s + AWAY_S + drift * (seen_s - np.mean(video_s))
    turns = Turns(stamps_s, seen.as_matrix(), np.arange(len(seen_s)) // 300)
    return align_turns(turns, InertialReadings(imu_s, gyro, np.zeros_like(gyro)))


@pytest.mark.slow
def test_clocks_hours_apart_are_aligned_with_honest_deviations():
    found = [aligned(seed, drift=8e-5).found for seed in range(6)]
    off = np.array([((f.lag_s - AWAY_S) / f.lag_std_s, (f.drift - 8e-5) / f.drift_std) for f in found])
    assert max(f.lag_std_s for f in found) < 0.005
    assert max(f.drift_std for f in found) < 2e-4
    for column in off.T:
        assert chi2.ppf(1e-4, 6) < (column**2).sum() < chi2.ppf(1 - 1e-4, 6)


def test_a_wrong_rate_of_the_pictures_is_found():
    """29.97 pictures a second that are called 30 drift by ten times what crystals do."""
    found = aligned(2, drift=1e-3).found
    assert found.drift == pytest.approx(1e-3, abs=4 * found.drift_std)
    assert found.drift_std < 2e-4


def test_pictures_that_show_little_of_the_drift_leave_it_at_what_crystals_have():
    """What the windows of such a short video ask for is mostly noise."""
    found = [aligned(seed, video_s=(80.0, 100.0), noise_rad=8e-3).found for seed in (0, 1)]
    assert [abs(f.drift) < 2e-4 and f.drift_std <= 1e-4 for f in found] == [True, True]


def test_the_mount_need_not_be_known():
    mount = Rotation.from_euler("zyx", [90.0, 10.0, -5.0], degrees=True)
    found = aligned(1, mount=mount).found
    assert found.lag_s == pytest.approx(AWAY_S, abs=4 * found.lag_std_s)
    off = (Rotation.from_matrix(found.b_R_m) * mount).as_rotvec()
    assert np.abs(off / found.mount_std_rad).max() < 4


def test_a_flight_that_only_yaws_leaves_the_other_axes_alone():
    found = aligned(2, size_deg=(0.0, 0.0, 5.0)).found
    assert found.lag_s == pytest.approx(AWAY_S, abs=4 * found.lag_std_s)
    assert Rotation.from_matrix(found.b_R_m).magnitude() < 0.2


def test_a_video_that_begins_before_the_log_is_aligned():
    found = aligned(3, video_s=(0.0, 60.0), log_s=80.0).found
    assert found.lag_s == pytest.approx(AWAY_S, abs=4 * found.lag_std_s)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_another_flight_is_not_aligned(seed: int):
    result = aligned(seed, other=True)
    assert result.found is None
    assert not result.rivals_s


@pytest.mark.slow
def test_a_vehicle_that_hovers_is_not_aligned():
    assert aligned(4, size_deg=(0.0, 0.0, 0.0)).found is None


@pytest.mark.slow
def test_a_motion_that_repeats_names_the_lags_that_are_as_good():
    result = aligned(5, period_s=25.0, video_s=(80.0, 130.0))
    assert result.found is None
    assert len(result.rivals_s) > 1
    apart = np.abs(np.diff(sorted(result.rivals_s)))
    assert apart == pytest.approx(np.round(apart / 25.0) * 25.0, abs=0.05)


def test_a_video_of_seconds_is_not_aligned_with_a_long_log():
    assert aligned(6, video_s=(80.0, 81.5)).found is None
