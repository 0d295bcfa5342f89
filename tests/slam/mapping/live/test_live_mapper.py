"""Pictures that arrive one by one: poses at once, and the post-flight map at the end."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from slam import LiveMapper
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Imu
from slam.evaluation.association import poses_at
from slam.mapping.live.loops import LiveLoops
from slam.mapping.live.mapper import LATE, MOST_WAIT_S
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown, only


@pytest.fixture(scope="module")
def flight() -> Flight:
    return only(flown(0), range(42))


@pytest.fixture(scope="module")
def mapped(flight):
    """State, keyframes and final map of the flight, of which no picture is dropped."""
    with LiveMapper(flight) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s.tolist()):
            mapper.add(flight.frames.load(k), stamp_s, wait=True)
        mapper.close()
        return mapper.state(), mapper.keyframes(), mapper.finish()


def off_m(flight: Flight, frames: np.ndarray, w_T_b: np.ndarray) -> np.ndarray:
    """Distances of the positions of frames from the true ones, both relative to the first."""
    truth = poses_at(flight.truth, flight.frames.stamps_s[frames])
    moved = np.linalg.inv(w_T_b[0]) @ w_T_b, np.linalg.inv(truth[0]) @ truth
    return np.linalg.norm(moved[0][:, :3, 3] - moved[1][:, :3, 3], axis=1)


def test_every_picture_is_placed_while_the_flight_goes_on(flight, mapped):
    state, (frames, w_T_b), _ = mapped
    assert (state.pictures, state.dropped, state.waiting) == (len(flight.frames), 0, 0)
    assert state.placed == state.keyframes == len(frames) > 4
    assert len(state.latency_s) == state.pictures
    assert off_m(flight, frames, w_T_b).max() < 0.05
    assert state.stamp_s == flight.frames.stamps_s[-1]
    last = np.array([w_T_b[0], state.w_T_b])
    assert off_m(flight, np.array([frames[0], len(flight.frames) - 1]), last).max() < 0.05


def test_the_final_map_is_that_of_the_whole_recording(flight, mapped):
    *_, final = mapped
    whole = optimize(flight)
    np.testing.assert_array_equal(final.frame_index, whole.frame_index)
    np.testing.assert_allclose(final.w_T_b, whole.w_T_b, atol=1e-12)


def test_readings_may_be_given_with_each_picture(flight):
    bare = Flight("bare", camera=flight.camera)
    angles = flight.attitude.roll_pitch_yaw_rad
    with LiveMapper(bare) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s[:24].tolist()):
            near = int(np.argmin(np.abs(flight.attitude.stamps_s - stamp_s)))
            height = int(np.argmin(np.abs(flight.sonar.stamps_s - stamp_s)))
            mapper.add(flight.frames.load(k), stamp_s, angles[near], flight.sonar.range_m[height], wait=True)
        final = mapper.finish()
        shown = mapper.flight().frames.load(int(final.frame_index[1]))
        assert mapper.flight().frames.load(int(final.frame_index[1]) + 1) is None
    assert final.metric
    assert off_m(flight, final.frame_index, final.w_T_b).max() < 0.03
    np.testing.assert_array_equal(shown, flight.frames.load(int(final.frame_index[1])))


@pytest.mark.slow
@pytest.mark.parametrize("is_recorded", [True, False])
def test_the_imu_carries_the_map_across_a_gap_in_flight(is_recorded):
    """On the last leg a lane without texture is wider than a picture. The readings come with the flight, or
    with each picture."""
    way = {"way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], [4.0, 0.7]], "cruise_m_s": 0.8}
    world = {"extent_m": [0, 0, 4.4, 1.0], "blanks_m": [[2.0, -1.0, 3.2, 2.0]]}
    flight = flown(0, maneuver=way, world=world, camera={"rate_hz": 15.0})
    stamps_s, angles, imu = flight.frames.stamps_s, flight.attitude.roll_pitch_yaw_rad, flight.imu
    given = flight if is_recorded else Flight("bare", camera=flight.camera)
    with LiveMapper(given) as mapper:
        before_s = -np.inf
        for k, stamp_s in enumerate(stamps_s.tolist()):
            image = flight.frames.load(k)
            if is_recorded:
                mapper.add(image, stamp_s, wait=True)
            else:
                rows = [int(np.argmin(np.abs(s.stamps_s - stamp_s))) for s in (flight.attitude, flight.sonar)]
                arrived = (imu.stamps_s > before_s) & (imu.stamps_s <= stamp_s + 0.01)
                before_s = stamp_s + 0.01
                read = Imu(imu.stamps_s[arrived], imu.gyro_rad_s[arrived], imu.accel_m_s2[arrived])
                ranged = float(flight.sonar.range_m[rows[1]])
                mapper.add(image, stamp_s, angles[rows[0]], ranged, wait=True, imu=read)
        mapper.close()
        state, (frames, w_T_b) = mapper.state(), mapper.keyframes()
        assert mapper.flight().imu is not None
    assert state.bridged == 1
    assert state.placed == state.keyframes == len(frames)
    assert off_m(flight, frames, w_T_b).max() < 0.15


def test_without_ranges_lengths_are_heights(flight):
    bare = Flight("bare", camera=flight.camera)
    with LiveMapper(bare) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s[:12].tolist()):
            mapper.add(flight.frames.load(k), stamp_s, wait=True)
        mapper.close()
        _, w_T_b = mapper.keyframes()
    assert len(w_T_b) > 1
    np.testing.assert_allclose(w_T_b[:, 2, 3], 1.0, atol=0.2)


class Held:
    """A mapper whose tracking has not begun, and a clock that the test sets."""

    def __init__(self, monkeypatch):
        self.now_s, self.gate, images = 0.0, threading.Event(), LiveMapper._images

        def held(mapper):
            self.gate.wait()
            yield from images(mapper)

        monkeypatch.setattr(LiveMapper, "_images", held)
        monkeypatch.setattr("slam.mapping.live.mapper.time.perf_counter", lambda: self.now_s)


def test_a_picture_that_waits_too_long_is_dropped(flight, monkeypatch):
    held, stamps_s = Held(monkeypatch), flight.frames.stamps_s.tolist()
    with LiveMapper(flight) as mapper:
        for k, stamp_s in enumerate(stamps_s[:3]):
            held.now_s = k * 0.8 * MOST_WAIT_S
            mapper.add(flight.frames.load(k), stamp_s)
        assert mapper.state().dropped == 1
        mapper.skip(stamps_s[3])
        assert mapper.state().dropped == 2
        held.gate.set()
        for k, stamp_s in list(enumerate(stamps_s))[4:20]:
            mapper.add(flight.frames.load(k), stamp_s, wait=True)
        final = mapper.finish()
    assert final.rejected[LATE] == 2
    assert final.frames == 20
    assert final.frame_index[0] == 1


def test_the_newest_picture_is_tracked_however_long_it_waited(flight, monkeypatch):
    held, stamps_s = Held(monkeypatch), flight.frames.stamps_s.tolist()
    with LiveMapper(flight) as mapper:
        for k in range(3):
            mapper.add(flight.frames.load(k), stamps_s[k])
        held.now_s = 10 * MOST_WAIT_S
        held.gate.set()
        mapper.close()
        assert mapper.state().dropped == 2
        assert mapper.keyframes()[0].tolist() == [2]


def test_pictures_that_all_wait_at_once_are_placed_where_they_were_taken(flight, monkeypatch):
    """Features of keyframes are then always late, and the pictures after them are followed without."""
    monkeypatch.setattr("slam.mapping.live.mapper.MOST_WAIT_S", np.inf)
    with LiveMapper(flight) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s[:30].tolist()):
            mapper.add(flight.frames.load(k), stamp_s)
        mapper.close()
        state, (frames, w_T_b) = mapper.state(), mapper.keyframes()
    assert state.dropped == 0
    assert state.placed == len(frames) > 2
    assert off_m(flight, frames, w_T_b).max() < 0.05


def test_a_damaged_picture_is_unreadable_and_not_late(flight):
    with LiveMapper(flight) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s[:12].tolist()):
            mapper.add(None if k == 4 else flight.frames.load(k), stamp_s, wait=True)
        assert mapper.state().dropped == 0
        final = mapper.finish()
    assert final.rejected["unreadable"] == 1
    assert LATE not in final.rejected


def test_other_pictures_than_the_recorded_ones_are_shown_where_they_were_seen(flight):
    """Every second picture is given: number k of them is not number k of the recording."""
    with LiveMapper(flight) as mapper:
        for k in range(0, 24, 2):
            mapper.add(flight.frames.load(k), float(flight.frames.stamps_s[k]), wait=True)
        mapper.close()
        frame = int(mapper.keyframes()[0][-1])
        shown = mapper.flight().frames.load(frame)
    np.testing.assert_array_equal(shown, flight.frames.load(2 * frame))


def test_pictures_must_come_in_order(flight):
    with LiveMapper(flight) as mapper:
        mapper.add(flight.frames.load(0), 5.0)
        with pytest.raises(InputError, match=r"at 5.0 s is not after the one before, at 5.0 s"):
            mapper.add(flight.frames.load(1), 5.0)


@pytest.mark.parametrize(
    ("stamp_s", "angles", "words"),
    [(np.nan, None, "the stamp of a picture is nan"), (1.0, [0.0, 0.0], r"shape \(2,\); give three angles")],
)
def test_readings_of_another_kind_are_refused(flight, stamp_s, angles, words):
    with LiveMapper(flight) as mapper, pytest.raises(InputError, match=words):
        mapper.add(flight.frames.load(0), stamp_s, angles)


def test_readings_of_an_imu_without_three_axes_are_refused(flight):
    imu = Imu(np.array([0.0, 0.1]), np.zeros((2, 2)), np.zeros((2, 3)))
    with LiveMapper(flight) as mapper, pytest.raises(InputError, match=r"gyro_rad_s has shape \(2, 2\)"):
        mapper.add(flight.frames.load(0), 0.0, imu=imu)


def test_a_flight_without_a_camera_is_refused(flight):
    with pytest.raises(InputError, match="no camera in this flight, so no live map"):
        LiveMapper(replace(flight, camera=None))
    with pytest.raises(TypeError, match="expected Flight"):
        LiveMapper("my_flight")


@pytest.mark.parametrize("part", ["LiveLoops.of_newest", "LiveGraph.add"])
def test_an_error_of_a_thread_reaches_the_caller(flight, monkeypatch, part):
    def broken(*_):
        raise OSError(28, "No space left on device", "/somewhere")

    monkeypatch.setattr(f"slam.mapping.live.mapper.{part}", broken)
    with LiveMapper(flight) as mapper:
        mapper.add(flight.frames.load(0), 0.0, wait=True)
        with pytest.raises(OSError, match="No space left"):
            mapper.finish()


def test_a_program_that_ends_without_close_waits_for_one_keyframe_at_most(flight, monkeypatch):
    at_exit, gate, search = [], threading.Event(), LiveLoops.of_newest

    def held(*arguments):
        gate.wait()
        return search(*arguments)

    monkeypatch.setattr(LiveLoops, "of_newest", held)
    monkeypatch.setattr("slam.mapping.live.mapper.atexit.register", at_exit.append)
    with LiveMapper(flight) as mapper:
        for k, stamp_s in enumerate(flight.frames.stamps_s[:20].tolist()):
            mapper.add(flight.frames.load(k), stamp_s, wait=True)
        while mapper.state().waiting < 3:
            time.sleep(0.01)
        threading.Timer(0.1, gate.set).start()
        at_exit[0]()
        assert len(mapper.keyframes()[0]) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("pictures", [0, 8])
def test_a_program_that_fails_before_close_ends(pictures):
    program = f"""
import numpy as np, slam
from frontend.camera import Camera
mapper = slam.LiveMapper(slam.Flight("live", camera=Camera((300.0, 300.0), (160.0, 120.0), (320, 240))))
for k in range({pictures}):
    mapper.add(np.random.default_rng(k).integers(0, 255, (240, 320), dtype=np.uint8), k / 10)
raise SystemExit("an error of the user")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100)
    assert ended.returncode == 1
    assert ended.stderr.strip() == "an error of the user"
