"""Tables with the name of a video: their times, and which part of a long one belongs to it."""

from __future__ import annotations

import pytest

from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import lines_with, table
from tests.slam.io.recordings.video.made_video import video

AIRDATA = "time(millisecond),height_above_takeoff(meters),isVideo"


def airdata(path, *stretches_s):
    """Write 300 s of heights equal to the time, with the camera switched on for some stretches."""

    def row(k):
        on = any(begin <= k / 10 < end for begin, end in stretches_s)
        return f"{100 * k},{k / 10},{int(on)}"

    return table(path, AIRDATA, *map(row, range(3000)))


def test_a_table_beside_a_video_is_on_its_clock(tmp_path):
    path = video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", "time [s],range [m]", *(f"{k / 5},{1 + k / 10}" for k in range(20)))
    flight = read(path)
    assert len(flight.frames) == 40
    assert flight.sonar.stamps_s[:2] == pytest.approx([0.0, 0.2])
    assert flight.sonar.range_m[10] == pytest.approx(2.0)
    assert not lines_with(flight, ["a.csv"])


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time [s],range [m]", ["its times are not those of the video", "give it as a source of its own"]),
        ("time [s],range", ["is not used: ", "has no unit"]),
    ],
)
def test_a_table_that_does_not_fit_the_video_is_named(tmp_path, header, words):
    path = video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", header, *(f"{1.6e9 + k},1" for k in range(9)))
    flight = read(path)
    assert flight.sonar is None
    assert lines_with(flight, ["a.csv", *words])


def test_a_table_longer_than_the_video_is_not_counted_from_its_start(tmp_path):
    path = video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", "time [s],height [m]", *(f"{k / 10},{k / 10}" for k in range(3000)))
    flight = read(path)
    assert flight.barometer is None
    (line,) = lines_with(flight, ["a.csv is not used"])
    assert "0.0 to 299.9 s and 0 to 3.9 s" in line
    assert "slam import a.mp4 a.csv --out FLIGHT" in line
    assert "--offset cam0=SECONDS" in line


def test_the_stretch_of_filming_that_lasts_as_long_is_the_video(tmp_path):
    path = video(tmp_path / "a.mp4")
    airdata(tmp_path / "a.csv", (20, 60), (100, 104), (200, 230))
    flight = read(path)
    assert len(flight.frames) == 40
    height_m = flight.barometer.value[flight.barometer.stamps_s >= flight.frames.stamps_s[0]]
    assert height_m[0] == pytest.approx(100.0)
    assert height_m[-1] < 106
    assert lines_with(flight, ["a.csv", "from 100.0 s on, belong to the video"])


@pytest.mark.parametrize(
    ("stretches_s", "why"),
    [
        (((20, 24), (100, 104)), "more than one stretch as long as the video, 3.9 s (in s: 3.9, 3.9)"),
        (((20, 60),), "no stretch as long as the video, 3.9 s (in s: 39.9)"),
        ((), "no stretch as long as the video, 3.9 s (in s: none)"),
    ],
)
def test_a_record_of_a_flight_without_one_stretch_for_the_video_is_not_used(tmp_path, stretches_s, why):
    path = video(tmp_path / "a.mp4")
    airdata(tmp_path / "a.csv", *stretches_s)
    flight = read(path)
    assert flight.barometer is None
    assert lines_with(flight, ["a.csv is not used", why, "slam import a.mp4 a.csv"])


def test_names_and_words_of_decoded_records_tell_the_filming(tmp_path):
    path = video(tmp_path / "a.mp4")
    rows = (f"{k / 10},{k / 10},{100 <= k < 140}" for k in range(300))
    table(tmp_path / "a.csv", "OSD.flyTime [s],OSD.height [m],CUSTOM.isVideo", *rows)
    flight = read(path)
    assert lines_with(flight, ["from 10.0 s on, belong to the video"])
    assert not lines_with(flight, ["no number"])


def test_a_table_that_ends_before_the_video_is_named(tmp_path):
    path = video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", "time [s],range [m]", *(f"{k / 10},1" for k in range(20)))
    flight = read(path)
    assert len(flight.sonar.stamps_s) == 20
    assert lines_with(flight, ["a.csv covers 0.0 to 2.0 s of a video of 3.9 s"])


def test_a_fast_table_that_begins_and_ends_with_the_switch_covers_the_video(tmp_path):
    path = video(tmp_path / "a.mp4")
    table(tmp_path / "a.csv", "time [s],range [m]", *(f"{k / 100},1" for k in range(5, 345)))
    flight = read(path)
    assert len(flight.sonar.stamps_s) == 340
    assert not lines_with(flight, ["covers"])
