from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.streams import AttitudeSeries, Frames, Gps, Scalar, Sonar
from slam.mapping.config import PipelineConfig
from slam.mapping.gps.fixes import fixes_of
from slam.mapping.keyframe_readings import (
    MAX_GAP_S,
    KeyframeReadings,
    attitudes_at,
    heights_at,
    local_value,
    ranges_at,
    row_exposure,
)

ORIGIN = GeoOrigin(47.0, 8.0, 400.0)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_a_straight_line_is_reproduced_exactly(seed, half_window_s):
    """At uneven stamps, in any order, between samples and on them, one window wide or none."""
    rng = np.random.default_rng(seed)
    stamps_s = np.cumsum(rng.uniform(0.005, 0.1, 200))
    slope, offset = rng.normal(0, 3, (2, 2))
    at_s = np.concatenate([rng.uniform(stamps_s[0], stamps_s[-1], 50), stamps_s[::7]])
    mixed = rng.permutation(200)
    values = offset + stamps_s[mixed, None] * slope
    found, factor = local_value(stamps_s[mixed], values, at_s, half_window_s)
    assert found == pytest.approx(offset + at_s[:, None] * slope, abs=1e-8)
    # Samples on both sides: never worse than the worst of them, as an extrapolation would be.
    assert (factor <= 1 + 1e-9).all()


@pytest.mark.parametrize("half_window_s", [0.0, 0.03, 0.1])
def test_the_factor_is_what_happens_to_white_noise(half_window_s):
    rng = np.random.default_rng(1)
    stamps_s = np.arange(100) / 50.0
    at_s = np.array([0.7013, 1.0, 1.2345])
    noise = rng.normal(0, 0.3, (100, 4000))
    found, factor = local_value(stamps_s, noise, at_s, half_window_s)
    assert found.std(axis=1) == pytest.approx(0.3 * factor, rel=0.05)


def test_a_height_is_the_mean_of_the_readings_around_a_keyframe():
    """Eleven readings within 0.1 s: their noise of 0.5 m averages out, down to the floor of a sensor."""
    stamps_s = np.arange(101) / 50.0
    barometer = Scalar(stamps_s, 500.0 + 2.0 * stamps_s, noise_std=0.5)
    values = np.where(stamps_s == 0.5, np.nan, barometer.value)
    found = heights_at(replace(barometer, value=values), np.array([0.5, 1.0, 9.0]), 0.1)
    assert [height.k for height in found] == [0, 1]
    assert [height.height_m for height in found] == pytest.approx([501.0, 502.0])
    assert found[1].std_m == pytest.approx(np.hypot(0.5 / np.sqrt(11), 0.1), rel=0.05)
    assert heights_at(None, stamps_s, 0.1) == ()


@pytest.mark.parametrize(("last_range_s", "is_used"), [(0.0, True), (1.0, True), (9.0, False)])
def test_the_barometer_counts_unless_ranges_reach_most_keyframes(last_range_s, is_used):
    """A height sensor of short reach measures near the take-off alone."""
    stamps_s = np.arange(101) / 10.0
    ranged = np.where(stamps_s <= last_range_s, 1.0, np.nan)
    flight = Flight("climb", sonar=Sonar(stamps_s, ranged), barometer=Scalar(stamps_s, stamps_s))
    readings = KeyframeReadings.at(flight, np.arange(0.0, 10.0), None, PipelineConfig())
    assert readings.ranges
    assert len(readings.heights) == (10 if is_used else 0)


def test_gaps_and_ends_have_no_value():
    stamps_s = np.concatenate([np.arange(0, 1, 0.02), np.arange(3, 4, 0.02)])
    at_s = np.array([-0.1, -1.0, 0.5, 1.9, 3.5, 4.2, 5.0])
    found, _ = local_value(stamps_s, stamps_s[:, None], at_s, 0.05)
    known = np.isfinite(found[:, 0])
    assert known[[2, 4]].all()
    assert not known[[1, 3, 6]].any()
    assert found[2, 0] == pytest.approx(0.5)


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 200.0])
@pytest.mark.parametrize("side", [-1, 1])
def test_beyond_an_end_noise_is_not_carried_off(rate_hz, side):
    """A picture 0.22 s before the first attitude: the noise of its readings stays about what it is."""
    stamps_s = np.arange(0, 2, 1 / rate_hz)
    at_s = np.array([-0.22 if side < 0 else stamps_s[-1] + 0.22])
    noise = np.random.default_rng(0).normal(0.0, 1.0, (len(stamps_s), 2000))
    value, factor = local_value(stamps_s, noise, at_s, 0.05)
    assert value.std() == pytest.approx(factor[0], rel=0.1)
    assert factor[0] < 1.5


def test_slow_streams_count_while_their_gaps_are_short():
    for interval_s, expected in ((0.9 * MAX_GAP_S, True), (5 * MAX_GAP_S, False)):
        stamps_s = np.arange(0, 10, interval_s)
        found, _ = local_value(stamps_s, stamps_s[:, None], np.array([4.03 * interval_s]), 0.02)
        assert np.isfinite(found).all() == expected


def test_photographs_keep_their_angles_however_far_apart_they_are():
    stamps_s = np.array([0.0, 4.0, 11.0, 300.0])
    angles = np.random.default_rng(0).normal(0, 0.1, (4, 3))
    found = attitudes_at(AttitudeSeries(stamps_s, angles, (0.03, 0.03, 0.1)), stamps_s, 0.0)
    assert [a.k for a in found] == [0, 1, 2, 3]
    assert np.array([a.roll_pitch_yaw_rad for a in found]) == pytest.approx(angles)
    assert np.array([a.std_rad for a in found]) == pytest.approx(np.tile([0.03, 0.03, 0.1], (4, 1)))
    between = attitudes_at(AttitudeSeries(stamps_s, angles, (0.03, 0.03, 0.1)), stamps_s[:3] + 0.5, 0.0)
    assert [a.k for a in between] == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_any_samples_are_no_trouble(count):
    stamps_s = np.arange(count) * 0.1
    found, _ = local_value(stamps_s, np.ones((count, 1)), np.array([0.05, 7.0]), 0.05)
    assert np.isnan(found[1]).all()
    assert np.isfinite(found[0]).all() == (count > 0)


def test_a_heading_that_passes_half_a_turn_is_not_averaged_away():
    stamps_s = np.arange(0, 2, 0.02)
    yaw = np.pi - 0.3 + 0.4 * stamps_s
    wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
    angles = np.column_stack([0 * yaw, 0 * yaw + 0.1, wrapped])
    at_s = np.linspace(0.1, 1.9, 40)
    for a in attitudes_at(AttitudeSeries(stamps_s, angles), at_s, 0.0):
        turn = a.roll_pitch_yaw_rad[2] - (np.pi - 0.3 + 0.4 * at_s[a.k])
        assert np.cos(turn) == pytest.approx(1.0, abs=1e-12)
        assert a.roll_pitch_yaw_rad[1] == pytest.approx(0.1)


def test_an_attitude_that_is_missing_for_a_moment_is_missing_then_only():
    """One NaN must not reach beyond its neighbourhood, nor one NaN stamp row turn the rest to NaN."""
    stamps_s = np.arange(0, 10, 0.02)
    angles = np.tile([0.01, -0.02, 0.5], (500, 1))
    angles[200:210] = np.nan
    at_s = np.array([1.0, 3.5, 4.1, 6.0, 9.0])
    found = attitudes_at(AttitudeSeries(stamps_s, angles), at_s, 0.005)
    assert {a.k for a in found} >= {0, 1, 3, 4}
    for a in found:
        assert a.roll_pitch_yaw_rad == pytest.approx([0.01, -0.02, 0.5])


def test_a_heading_that_was_never_measured_does_not_cost_the_tilt():
    stamps_s = np.arange(0, 2, 0.02)
    angles = np.tile([0.01, -0.02, np.nan], (100, 1))
    (a,) = attitudes_at(AttitudeSeries(stamps_s, angles), np.array([1.0]), 0.005)
    assert a.roll_pitch_yaw_rad == pytest.approx([0.01, -0.02, 0.0])
    assert np.isfinite(a.std_rad).tolist() == [True, True, False]


def test_the_maker_s_figure_is_bounded_from_below():
    stamps_s = np.arange(0, 2, 0.01)
    series = AttitudeSeries(stamps_s, np.zeros((200, 3)), (0.0, 0.0, 0.02))
    (a,) = attitudes_at(series, np.array([1.0]), 0.005)
    assert a.std_rad[:2] == pytest.approx([0.005, 0.005])
    assert 0.005 < a.std_rad[2] < 0.01
    assert attitudes_at(None, np.array([1.0]), 0.005) == ()


def test_ranges_outside_the_sensor_s_limits_are_skipped():
    """Missing, negative, too near, too far: the fit goes through what is left."""
    stamps_s = np.arange(0, 2, 0.04)
    range_m = 1.0 + 0.1 * stamps_s
    for k, bad in ((20, np.nan), (22, -1.0), (24, 0.05), (26, 9.0)):
        range_m[k] = bad
    at_s = np.array([0.8, 0.88, 0.96, 1.04])
    found = ranges_at(Sonar(stamps_s, range_m, max_range_m=6.0), at_s, 0.005)
    assert [r.k for r in found] == [0, 1, 2, 3]
    assert [r.range_m for r in found] == pytest.approx(1.0 + 0.1 * at_s, abs=1e-9)
    assert all(0.005 < r.std_m < 0.01 for r in found)


def test_a_sonar_without_one_good_reading_gives_none():
    stamps_s = np.arange(0, 2, 0.04)
    assert ranges_at(Sonar(stamps_s, np.full(50, np.nan)), stamps_s, 0.005) == ()
    assert ranges_at(Sonar(stamps_s, np.full(50, 7.0), max_range_m=6.0), stamps_s, 0.005) == ()
    assert ranges_at(None, stamps_s, 0.005) == ()


def positions_at(flight, at_s):
    fixes = fixes_of(flight, ORIGIN)
    return () if fixes is None else fixes.at(at_s)


def gps(stamps_s: np.ndarray, enu: np.ndarray) -> Gps:
    latitude, longitude, altitude = geodetic_from_enu(enu, ORIGIN)
    return Gps(stamps_s, latitude, longitude, altitude)


def test_a_geotag_is_taken_as_it_is_and_fixes_are_joined_by_a_line():
    stamps_s = np.arange(0, 10, 0.5)
    enu = np.column_stack([3 * stamps_s, -2 * stamps_s, 50 + stamps_s])
    at_s = np.array([2.0, 3.3, 9.5, 12.0, -0.2])
    found = positions_at(Flight("f", gps=gps(stamps_s, enu)), at_s)
    assert [p.k for p in found] == [0, 1, 2]
    for p in found:
        assert p.w_p_antenna_m == pytest.approx(at_s[p.k] * np.array([3, -2, 1]) + [0, 0, 50], abs=1e-3)
        assert p.std_m == pytest.approx([5, 5, 10])


def test_fixes_that_lie_too_far_apart_are_not_joined():
    stamps_s = np.array([0.0, 1.0, 5.0, 6.0])
    flight = Flight("f", gps=gps(stamps_s, np.zeros((4, 3))))
    assert [p.k for p in positions_at(flight, np.array([0.5, 3.0, 5.5]))] == [0, 2]


def test_a_fix_without_altitude_says_nothing_of_the_height():
    stamps_s = np.arange(4.0)
    there = gps(stamps_s, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]))
    there.altitude_m[2] = np.nan
    there.latitude_deg[3] = np.nan
    found = positions_at(Flight("f", gps=there), stamps_s)
    assert [p.k for p in found] == [0, 1, 2]
    assert found[1].std_m[2] == 10
    assert found[2].std_m[2] >= 1e3
    assert found[2].w_p_antenna_m[:2] == pytest.approx([2, 0], abs=1e-3)


def test_no_gps_no_positions():
    assert positions_at(Flight("f"), np.array([1.0])) == ()
    nothing = Gps(*(np.full(3, np.nan) for _ in range(4)))
    assert positions_at(Flight("f", gps=nothing), np.array([1.0])) == ()


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_false_echoes_around_a_keyframe_do_not_enter_its_range(share: float):
    """Where most readings around a keyframe are right, the range is theirs; healthy ones are all used."""
    rng = np.random.default_rng(1)
    stamps_s = np.arange(0, 40, 0.04)
    right_m = 1.5 + 0.3 * np.sin(stamps_s)
    range_m, false = right_m + rng.normal(0, 0.01, 1000), rng.random(1000) < share
    healthy = ranges_at(Sonar(stamps_s, range_m), stamps_s, 0.005)
    range_m[false] = rng.uniform(0.3, 5.9, false.sum())
    found = ranges_at(Sonar(stamps_s, range_m), stamps_s, 0.005)
    around = np.abs(stamps_s - stamps_s[:, None]) < 0.1 + 1e-9
    wrong, count = (false & around).sum(axis=1), around.sum(axis=1)
    clean = wrong == 0
    assert np.array([f.range_m for f in found])[clean] == pytest.approx(
        np.array([h.range_m for h in healthy])[clean], abs=1e-12
    )
    off = np.abs([f.range_m for f in found] - right_m)
    outvoted = (2 * wrong < count) & (count >= 5)
    assert np.mean(off[outvoted] > 0.1) < 0.01
    # Where no majority agrees, the range says that it is not known.
    split = (2 * wrong == count + 1) & (off > 0.3)
    assert np.mean([f.std_m > 0.1 for f, is_split in zip(found, split, strict=True) if is_split]) > 0.5


def test_a_wild_attitude_does_not_enter_that_of_a_keyframe():
    stamps_s = np.arange(0, 2, 0.02)
    angles = np.tile([0.02, -0.03, 0.5], (100, 1))
    angles[::7] += [0.8, 0.3, -0.4]
    for a in attitudes_at(AttitudeSeries(stamps_s, angles), np.arange(0.2, 1.8, 0.05), 0.005):
        assert a.roll_pitch_yaw_rad == pytest.approx([0.02, -0.03, 0.5])


def test_photographs_have_the_velocity_of_their_picture():
    """The keyframes are some of the pictures, and a clock's correction has moved their stamps."""
    w_v_m_s = np.arange(15.0).reshape(5, 3)
    frames = Frames(2.0 * np.arange(5), tuple("abcde"), lambda k: None, w_v_m_s=w_v_m_s)
    flight = Flight("photographs", camera=Camera((80.0, 80.0), (50.0, 40.0), (101, 81)), frames=frames)
    assert row_exposure(flight, frames.stamps_s) is None, "a video"
    found = row_exposure(replace(flight, all_keyframes=True), np.array([2.3, 3.7, 8.3]))
    assert (found.rows, found.readout_s) == (81, None)
    np.testing.assert_array_equal(found.w_v_m_s, w_v_m_s[[1, 2, 4]])


def test_photographs_are_named_and_frames_of_a_video_are_not():
    frames = Frames(2.0 * np.arange(5), tuple("abcde"), lambda k: None)
    photographs = Flight("photographs", frames=frames, all_keyframes=True)
    corrected_s = np.array([2.3, 3.7, 8.3])  # a clock's correction has moved their stamps
    assert KeyframeReadings.at(photographs, corrected_s, None, PipelineConfig()).names == ("b", "c", "e")
    video = replace(photographs, all_keyframes=False)
    assert KeyframeReadings.at(video, corrected_s, None, PipelineConfig()).names == ()


def test_a_stated_read_out_time_and_unknown_velocities_of_photographs():
    camera = Camera((80.0, 80.0), (50.0, 40.0), (101, 81), readout_s=0.02)
    frames = Frames(2.0 * np.arange(5), tuple("abcde"), lambda k: None)
    found = row_exposure(Flight("p", camera=camera, frames=frames, all_keyframes=True), frames.stamps_s[1:3])
    assert found.readout_s == 0.02
    np.testing.assert_array_equal(found.w_v_m_s, np.full((2, 3), np.nan))
