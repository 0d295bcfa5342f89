"""Sources that are one recording in several files: parts of a bag, and subtitles under another name."""

from __future__ import annotations

import numpy as np
import pytest

from slam.cli.one_flight import open_one_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording
from tests.slam.io.recordings.ros.made_bag import ROS1, Maker, a_flight, ros1
from tests.slam.io.recordings.video.made_video import video


def opened(*paths, **topics):
    return open_one_flight(paths, silent, Request(topics), {})


def test_parts_of_a_bag_are_one_flight_in_any_order(tmp_path):
    messages = sorted(a_flight(Maker(ROS1)), key=lambda each: each[1])
    whole = flight_of(open_recording(ros1(tmp_path / "whole.bag", messages)))
    first, second = ros1(tmp_path / "x_0.bag", messages[:9]), ros1(tmp_path / "x_1.bag", messages[9:])
    for parts in ((first, second), (second, first)):
        flight = opened(*parts)
        assert "x_0.bag, x_1.bag are read as the parts of one recording" in flight.warnings
        assert flight.epoch_ns == whole.epoch_ns
        assert np.array_equal(flight.imu.accel_m_s2, whole.imu.accel_m_s2)
        assert [flight.frames[k].read().tolist() for k in range(5)] == [
            whole.frames[k].read().tolist() for k in range(5)
        ]


def test_bags_that_overlap_are_no_parts(tmp_path):
    messages = sorted(a_flight(Maker(ROS1)), key=lambda each: each[1])
    with pytest.raises(InputError, match=r"nothing ties its clock|fits that of"):
        opened(
            ros1(tmp_path / "a.bag", [each for each in messages if each[0] != "/imu"]),
            ros1(tmp_path / "b.bag", [each for each in messages if each[0] == "/imu"]),
        )


def cues(seconds: float) -> str:
    """Subtitles of a moving drone, ten a second, with a lens of 24 mm."""
    lines = []
    for k in range(round(10 * seconds)):
        begin, end = (f"00:00:{n // 10:02d},{n % 10}00" for n in (k, k + 1))
        place = f"[latitude: {47.5 + 1e-5 * k:.6f}] [longitude: 8.25] [focal_len: 24.00]"
        lines.append(f"{k + 1}\n{begin} --> {end}\n{place}\n")
    return "\n".join(lines)


def test_subtitles_of_another_name_are_those_of_the_video(tmp_path):
    (tmp_path / "renamed").mkdir()
    beside, apart = video(tmp_path / "a.mp4", 50), tmp_path / "renamed" / "track.srt"
    lasts_s = float(flight_of(open_recording(beside)).frames.stamps_s[-1])
    apart.write_text(cues(lasts_s))
    flight = opened(beside, apart)
    assert any(line.startswith("a.mp4, track.srt are read as the parts") for line in flight.warnings)
    assert opened(beside, apart, gps0="track.srt").gps is not None
    (tmp_path / "a.srt").write_text(cues(lasts_s))
    expected = flight_of(open_recording(beside))
    assert flight.camera.focal_px == expected.camera.focal_px, "the lens is that of the subtitles too"
    assert np.array_equal(flight.gps.stamps_s, expected.gps.stamps_s)


def test_subtitles_of_another_length_have_a_clock_of_their_own(tmp_path):
    (tmp_path / "renamed").mkdir()
    apart = tmp_path / "renamed" / "track.srt"
    apart.write_text(cues(9.0))
    with pytest.raises(InputError, match="nothing ties its clock"):
        opened(video(tmp_path / "a.mp4", 50), apart)
