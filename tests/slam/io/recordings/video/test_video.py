"""Videos: pictures by their times in any order, variable rates, damage; and subtitles of all dialects."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.core.errors import InputError
from slam.io.flight_folder import read_flight, write_flight
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording
from slam.io.recordings.video.mp4 import read_tracks
from slam.io.recordings.video.pictures import packet_times
from tests.slam.io.recordings.video.made_video import (
    SIZE_PX,
    grey_of,
    video,
    with_durations,
    with_edits,
    with_quarter_turn,
    zero_pictures,
)


def read(path: Path, picture_rate_hz: float | None = None):
    return flight_of(open_recording(path), Request(picture_rate_hz=picture_rate_hz))


def number_in(picture: np.ndarray) -> int:
    step = grey_of(1) - grey_of(0)
    return int((float(picture.mean()) - grey_of(0) + 0.8 * step) // step)  # the codec darkens by half a step


def test_every_picture_is_read_in_any_order(tmp_path):
    flight = read(video(tmp_path / "a.mp4"))
    assert flight.camera.size_px == SIZE_PX
    assert flight.frames.stamps_s == pytest.approx(np.arange(40) / 10)
    for k in (0, 1, 2, 30, 31, 5, 39, 0, 0, 20, 19):
        assert number_in(flight.frames[k].read()) == k


def test_stamps_of_a_variable_rate_come_from_the_index(tmp_path):
    path = video(tmp_path / "a.mp4")
    ticks = ticks_per_picture(path)
    with_durations(path, [step * ticks for step in [1, 3, 2, 7] * 10])
    flight = read(path)
    expected = np.concatenate([[0], np.cumsum([1, 3, 2, 7] * 10)[:-1]]) / 10
    assert flight.frames.stamps_s == pytest.approx(expected)
    for k in (0, 3, 4, 25, 7, 39):
        assert number_in(flight.frames[k].read()) == k


def test_fewer_pictures_are_taken_on_request(tmp_path):
    flight = read(video(tmp_path / "a.mp4"), picture_rate_hz=4.0)
    assert flight.frames.stamps_s[:5] == pytest.approx([0.0, 0.3, 0.5, 0.8, 1.0]), "each 0.25 s"
    assert [number_in(frame.read()) for frame in flight.frames][:5] == [0, 3, 5, 8, 10]
    assert any("16 of 40 pictures are used, at most 4 a second" in line for line in flight.warnings)


def test_import_takes_the_picture_rate_too(tmp_path):
    command = ["import", str(video(tmp_path / "a.mp4")), "--out", str(tmp_path / "flight")]
    result = CliRunner().invoke(app, [*command, "--picture-rate", "4"])
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "flight" / "mav0" / "cam0" / "data").iterdir())) == 16


def test_import_reduces_pictures_with_their_camera(tmp_path):
    source = video(tmp_path / "a.mp4")
    whole = read(source)
    width, height = whole.camera.size_px
    command = ["import", str(source), "--out", str(tmp_path / "flight"), "--width", "32"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    flight = read_flight(tmp_path / "flight")
    size = (32, round(32 * height / width))
    assert flight.camera.size_px == size
    assert flight.camera.focal_px[0] == pytest.approx(32 / width * whole.camera.focal_px[0])
    assert {path.suffix for path in (tmp_path / "flight/mav0/cam0/data").iterdir()} == {".jpg"}
    assert flight.frames[0].read().shape[1::-1] == size
    assert any(f"reduced from {width} x {height} to 32 x {size[1]} pixels" in w for w in flight.warnings)


def ticks_per_picture(path: Path) -> int:
    data = path.read_bytes()
    at = data.index(b"stts") + 16
    return int.from_bytes(data[at : at + 4], "big")


def test_an_import_writes_the_pictures_as_jpeg(tmp_path):
    write_flight(read(video(tmp_path / "a.mp4", count=5)), tmp_path / "flight")
    again = read_flight(tmp_path / "flight")
    assert again.frames.names == tuple(f"{k:06d}.jpg" for k in range(5))
    assert [number_in(frame.read()) for frame in again.frames] == [0, 1, 2, 3, 4]
    content = (tmp_path / "flight/mav0/cam0/data/000000.jpg").read_bytes()
    brightness = content[content.index(b"\xff\xc0") + 10 :][:2]  # component 1 of the frame's header
    assert brightness == b"\x01\x22", "one colour for each 2 x 2 pixels, as in the video"


def test_a_video_without_its_index_is_one_line(tmp_path):
    path = video(tmp_path / "a.mp4")
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"moov") - 4])
    with pytest.raises(InputError, match=r"without its index \(moov\), as after a power loss"):
        read(path)


def test_an_index_that_contradicts_itself_is_one_line(tmp_path):
    path = video(tmp_path / "a.mp4")
    content = bytearray(path.read_bytes())
    at = content.index(b"stts") + 12
    content[at : at + 4] = (1_000_000).to_bytes(4, "big")
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match=r"damaged index \((1000000 times of 40|1,000,000) samples\)"):
        read(path)


def test_a_video_without_a_picture_that_can_be_decoded_is_refused(tmp_path):
    path = video(tmp_path / "a.mp4")
    zero_pictures(path, range(40))
    with pytest.raises(InputError, match=r"no picture can be decoded \(codec 'FMP4'\); copy it again"):
        read(path)


def test_pictures_that_an_edit_list_cuts_off_are_not_counted(tmp_path):
    path = video(tmp_path / "a.mp4")
    with_edits(path, [(500, -1), (1500, 12_000)])  # milliseconds; a pause, then from 1.2 s of 10 240 units on
    flight = read(path)
    kept = range(12, 27)
    assert flight.frames.stamps_s == pytest.approx(0.1 * np.arange(len(kept)))
    assert [number_in(frame.read()) for frame in flight.frames] == list(kept)


def test_a_picture_with_the_time_of_another_one_is_left_out(tmp_path):
    path = video(tmp_path / "a.mp4", count=6)
    with_durations(path, [1024, 1024, 0, 1024, 1024, 1024])
    flight = read(path)
    assert flight.frames.stamps_s == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert [number_in(frame.read()) for frame in flight.frames] == [0, 1, 2, 4, 5]


@pytest.mark.parametrize("durations", [[1024] * 40, list(range(500, 540))])
def test_times_of_packets_are_those_of_the_index(tmp_path, durations):
    path = video(tmp_path / "a.mp4")
    with_durations(path, durations)
    (track,) = read_tracks(path)
    assert packet_times(path) == pytest.approx(track.stamps_s, abs=1e-4)


def test_a_flag_to_turn_the_pictures_is_not_applied(tmp_path):
    path = video(tmp_path / "a.mp4")
    with_quarter_turn(path)
    assert cv2.VideoCapture(str(path)).read()[1].shape[:2] == SIZE_PX, "a player turns them"
    flight = read(path)
    assert flight.camera.size_px == SIZE_PX
    assert flight.frames[5].read().shape[:2] == SIZE_PX[::-1]


@pytest.mark.parametrize("name", ["a.mkv", "a.avi"])
def test_other_containers(tmp_path, name):
    flight = read(video(tmp_path / name))
    assert flight.frames.stamps_s == pytest.approx(0.1 * np.arange(40), abs=1e-3)
    assert [number_in(flight.frames[k].read()) for k in (39, 3, 4, 20)] == [39, 3, 4, 20]


def test_an_avi_file_whose_pictures_are_predicted_from_later_ones(tmp_path):
    """MPEG-2 with such pictures: each is decoded one packet late, and the file has the packets' times."""
    path = video(tmp_path / "a.avi", codec="mpg2")
    flight = read(path)
    assert flight.frames.stamps_s == pytest.approx(0.1 * np.arange(40), abs=1e-3)
    for k in (0, 1, 2, 30, 31, 5, 39, 0, 38, 39, 20):
        assert number_in(flight.frames[k].read()) == k


@pytest.mark.parametrize("content", [b"", b"hello"])
def test_a_file_that_is_no_video_is_one_line(tmp_path, content):
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.mp4: (is empty|has the name of a video)"):
        read(tmp_path / "a.mp4")


def test_damage_in_the_middle_does_not_shift_later_pictures(tmp_path):
    path = video(tmp_path / "a.mp4")
    zero_pictures(path, (20, 21))
    flight = read(path)
    pictures = {k: flight.frames[k].read() for k in range(40)}
    assert {k for k in range(40) if pictures[k] is None} == set(flight.frames.failures) <= {20, 21}
    for k in (*range(20), *range(36, 40)):  # a key picture follows within a dozen pictures
        assert number_in(pictures[k]) == k
