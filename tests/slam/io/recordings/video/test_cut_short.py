"""Videos that are damaged or cut short: the time of each picture that is left, and what is said about it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.recordings.video.mp4 import read_tracks
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.video.made_video import CONTAINERS, box, grey_of, video

RATE_HZ = 10.0


def numbers_and_stamps(flight) -> list[tuple[int, float]]:
    """Return the number that the brightness of each picture shows, and its stamp."""
    found = []
    for k, stamp_s in enumerate(flight.frames.stamps_s):
        if (picture := flight.frames[k].read()) is not None:
            found.append((number_in(picture), float(stamp_s)))
    return found


def number_in(picture: np.ndarray) -> int:
    return int((float(np.median(picture)) + 4 - grey_of(0)) // 5)  # MPEG-4 darkens by up to 4


def is_in_time(found: list[tuple[int, float]]) -> bool:
    return all(stamp_s == pytest.approx(number / RATE_HZ, abs=1e-3) for number, stamp_s in found)


def places_of_pictures(content: bytes) -> list[int]:
    """Return where the chunks of the pictures of an AVI file are."""
    at, places = content.index(b"movi") + 4, []
    while content[at : at + 4] == b"00dc":
        places.append(at)
        size = struct.unpack_from("<I", content, at + 4)[0]
        at += 8 + size + size % 2
    return places


def test_pictures_behind_damage_of_an_avi_file_keep_their_times(tmp_path):
    path = video(tmp_path / "a.avi", codec="MJPG")
    content = bytearray(path.read_bytes())
    places = places_of_pictures(bytes(content))
    content[places[15] : places[18]] = b"U" * (places[18] - places[15])
    path.write_bytes(content)
    flight = read(path)
    found = numbers_and_stamps(flight)
    assert is_in_time(found)
    assert {number for number, _ in found} == set(range(40)) - {15, 16, 17}
    assert [number_in(flight.frames[k].read()) for k in (39, 3, 19)] == [39, 3, 19]


@pytest.mark.parametrize("share", [0.5, 0.0])
def test_an_avi_file_that_is_cut_short_is_told_and_loses_its_incomplete_picture(tmp_path, share):
    path = video(tmp_path / "a.avi", codec="MJPG")
    content = path.read_bytes()
    first, second = places_of_pictures(content)[20:22]
    path.write_bytes(content[: first + 8 + int(share * (second - first - 8))])
    flight = read(path)
    found = numbers_and_stamps(flight)
    assert is_in_time(found)
    assert [number for number, _ in found] == list(range(len(found)))
    assert 19 <= len(found) <= 20
    assert any("the file is cut short" in line and "counts 40 pictures" in line for line in flight.warnings)


def test_an_mp4_file_that_is_cut_behind_its_index_is_told_and_loses_its_incomplete_picture(tmp_path):
    path = with_index_first(video(tmp_path / "a.mp4"))
    whole = read(path)
    assert len(numbers_and_stamps(whole)) == 40
    assert not any("cut short" in line for line in whole.warnings)
    content = path.read_bytes()
    path.write_bytes(content[: int(0.8 * len(content))])
    flight = read(path)
    found = numbers_and_stamps(flight)
    lost = 40 - len(flight.frames.stamps_s)
    assert 0 < lost < 40
    assert is_in_time(found)
    said = f"the file is cut short: {lost} of 40 pictures of its index lie beyond its end"
    assert any(said in line for line in flight.warnings)


def test_a_video_that_is_cut_within_its_first_picture_is_refused(tmp_path):
    path = video(tmp_path / "a.avi", codec="MJPG")
    content = path.read_bytes()
    path.write_bytes(content[: places_of_pictures(content)[1] - 20])
    with pytest.raises(InputError, match=r"a\.avi: is a video that is cut short within its first picture"):
        read(path)


def test_an_mp4_file_that_ends_within_its_first_picture_is_refused(tmp_path):
    path = with_index_first(video(tmp_path / "a.mp4"))
    (track,) = read_tracks(path)
    path.write_bytes(path.read_bytes()[: int(track.offsets[0] + track.sizes[0]) - 1])
    with pytest.raises(InputError, match=r"a\.mp4: is a video that is cut short within its first picture"):
        read(path)


@pytest.mark.parametrize("length", [0, 0xFFFFFFFF])
def test_an_avi_file_that_was_streamed_states_no_count_and_no_length(tmp_path, length):
    path = video(tmp_path / "a.avi", codec="MJPG")
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, 4, length)
    struct.pack_into("<I", content, content.index(b"vids") - 8 + 40, 1 << 30)
    path.write_bytes(content)
    flight = read(path)
    assert [number for number, _ in numbers_and_stamps(flight)] == list(range(40))
    assert not any("cut short" in line or "missing" in line for line in flight.warnings)


def with_index_first(path: Path) -> Path:
    """Move ``moov`` before the pictures, as for the web, so that a cut file keeps its index."""
    content, parts, at = path.read_bytes(), {}, 0
    while at < len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        parts[kind] = content[at : at + size]
        at += size
    moov = moved(parts[b"moov"], len(parts[b"moov"]))
    rest = [part for kind, part in parts.items() if kind not in (b"ftyp", b"moov")]
    path.write_bytes(b"".join((parts[b"ftyp"], moov, *rest)))
    return path


def moved(boxes: bytes, shift: int) -> bytes:
    """Return boxes with the places of the pictures moved by some bytes."""
    found, at = [], 0
    while at < len(boxes):
        size, kind = struct.unpack_from(">I4s", boxes, at)
        body = boxes[at + 8 : at + size]
        if kind in CONTAINERS:
            body = moved(body, shift)
        elif kind == b"stco":
            places = np.frombuffer(body[8:], ">u4") + shift
            body = body[:8] + places.astype(">u4").tobytes()
        found.append(box(kind, body))
        at += size
    return b"".join(found)


def test_a_matroska_file_that_is_cut_short_is_told(tmp_path):
    path = video(tmp_path / "a.mkv", codec="MJPG")
    assert not any("cut short" in line for line in read(path).warnings)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    flight = read(path)
    assert is_in_time(numbers_and_stamps(flight))
    assert any("the file is cut short: its last" in line for line in flight.warnings)


def test_a_header_that_counts_more_pictures_than_the_file_holds_is_told(tmp_path):
    path = video(tmp_path / "a.avi", codec="MJPG")
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.index(b"vids") - 8 + 40, 43)
    path.write_bytes(content)
    assert any("3 of 43 pictures that the header counts are missing" in line for line in read(path).warnings)
