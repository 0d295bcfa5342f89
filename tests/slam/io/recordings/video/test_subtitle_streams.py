"""Streams and lens of a flight from the subtitles of a video."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.recordings.video.mp4 import read_tracks
from slam.io.recordings.video.subtitles import parse_subtitles
from tests.slam.io.recordings.video.made_video import (
    file_of_samples,
    video,
)
from tests.slam.io.recordings.video.test_video import read

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings"


measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")


NEWER = "[latitude: {lat:.6f}] [longitude: {lon:.6f}] [rel_alt: {h:.3f} abs_alt: {alt:.3f}]"


OLDEST = "HOME({lon:.4f},{lat:.4f}) 2017.08.05 14:11:51\nGPS({lon:.4f},{lat:.4f},16) BAROMETER:{h:.1f}"


PHANTOM = (
    "F/5.6, SS 400, GPS ({lon:.6f}, {lat:.6f}, 15), HOME (1.5, 2.5, -57.98m), D 698.70m, H {h:.2f}m, H.S n/a"
)


MATRICE = "2022.06.21 16:06:17\nGPS({lat:.4f},{lon:.4f},{alt:.1f}M) BAROMETER:{h:.1f}M"


DIALECTS = {
    "Mini 5 Pro": (NEWER, 1e-6, 1e-3),
    "Mavic 2 Pro": ("[latitude : {lat:.6f}] [longtitude : {lon:.6f}] [altitude: {alt:.6f}]", 1e-6, 1e-6),
    "decimal commas": (NEWER, 1e-6, 1e-3),
    "Mavic Pro": (OLDEST, 1e-4, 0.1),
    "Phantom 4 RTK": (PHANTOM, 1e-6, 0.01),
    "Matrice 300": (MATRICE, 1e-4, 0.1),
}
"""A template of each family of dialects, with the steps of its coordinates and heights."""


def clock(ms: int) -> str:
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"


def cue(k: int, start_ms: int, end_ms: int, text: str) -> str:
    times = f"{clock(start_ms)} --> {clock(end_ms)}"
    return f'{k}\n{times}\n<font size="28">FrameCnt: {k}, DiffTime: 33ms\n{text} </font>\n\n'


@pytest.mark.parametrize("name", DIALECTS)
def test_a_track_in_each_dialect_returns_to_its_own_resolution(tmp_path, name):
    """Thirty subtitles a second, of which every third holds a new position."""
    template, step_deg, step_m = DIALECTS[name]
    fixes = [(-34.5 + 3e-4 * k, 149.25 - 2e-4 * k, 20.0 + 0.7 * k, 120.0 + 0.7 * k) for k in range(20)]
    parts = []
    for k in range(60):
        latitude, longitude, height, altitude = fixes[k // 3]
        text = template.format(lat=latitude, lon=longitude, h=height, alt=altitude)
        if name == "decimal commas":
            text = text.replace(".", ",")
        parts.append(cue(k + 1, 33 * k, 33 * k + 33, text))
    (tmp_path / "a.SRT").write_text("\ufeff" + "".join(parts), encoding="utf-8")
    flight = read(tmp_path / "a.SRT")
    assert flight.gps.stamps_s == pytest.approx(0.099 * np.arange(20)), "held positions are dropped"
    latitude, longitude, height, altitude = np.array(fixes).T
    assert flight.gps.latitude_deg == pytest.approx(latitude, abs=0.51 * step_deg)
    assert flight.gps.longitude_deg == pytest.approx(longitude, abs=0.51 * step_deg)
    if "{alt" in template:
        assert flight.gps.altitude_m == pytest.approx(altitude, abs=0.51 * step_m)
    if "{h" in template:
        assert flight.barometer.value == pytest.approx(height, abs=0.51 * step_m)
    else:
        assert flight.barometer is None


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "gbk", "latin-1"])
@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_subtitles_in_other_encodings_are_read(tmp_path, encoding, end):
    place = {"gbk": "\u9ad8\u5ea6", "latin-1": "H\u00f6he"}.get(encoding, "\u9ad8")
    text = "".join(
        cue(k + 1, 1000 * k, 1000 * k + 1000, f"{place} GPS(8.{2000 + k},47.4692,16)") for k in range(4)
    )
    (tmp_path / "a.srt").write_bytes(text.replace("\n", end).encode(encoding))
    assert read(tmp_path / "a.srt").gps.longitude_deg == pytest.approx([8.2, 8.2001, 8.2002, 8.2003])


def test_coarse_coordinates_have_a_larger_noise(tmp_path):
    """Four decimals are steps of 11 m: a uniform error of 11.1 / sqrt(12) = 3.2 m beside the 5 m of GPS."""
    text = "".join(cue(k + 1, 1000 * k, 1000 * k + 1000, f"GPS(8.{2000 + k},47.4692,16)") for k in range(4))
    (tmp_path / "a.srt").write_text(text)
    _, north_m, _ = read(tmp_path / "a.srt").gps.noise_std_m
    assert north_m == pytest.approx(np.hypot(5.0, 11.132 / np.sqrt(12)), rel=1e-3)


def with_subtitles(folder: Path, texts: list[str], count: int = 40) -> Path:
    path = video(folder / "DJI_0001.MP4", count)
    cues = [cue(k + 1, 100 * k, 100 * k + 100, text) for k, text in enumerate(texts)]
    (folder / "DJI_0001.SRT").write_text("".join(cues))
    return path


def test_lens_and_gimbal_of_a_video(tmp_path):
    """24 mm on 36 mm film over 64 px is 42.67 px; a gimbal straight down with its top to east has yaw 0."""
    text = "[focal_len: 240] [latitude: 47.5] [longitude: 8.25] [gb_yaw: 90.0 gb_pitch: -90.0 gb_roll: 0.0]"
    flight = read(with_subtitles(tmp_path, [text] * 40))
    assert flight.camera.focal_px[0] == pytest.approx(24 / 36 * 64)
    assert flight.camera.focal_std_ratio > 0, "it is refined"
    assert flight.attitude.roll_pitch_yaw_rad[3] == pytest.approx([0, 0, 0], abs=1e-9)
    assert flight.gps.stamps_s == pytest.approx([0, 3.9]), "the position is held to the end"
    assert any("38 of 40 subtitles repeat the value before" in line for line in flight.warnings)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["[focal_len: 24.00]"] * 20 + ["[focal_len: 48.00]"] * 20, "the lens zooms from 24 to 48 mm"),
        (["[eis: normal]"] * 40, "stabilised electronically"),
        (["[latitude: 1.5] [longitude: 2.5]"] * 20, r"covers 0.0 to 2.0 s of a video of 3.9 s"),
        ([], "holds no subtitle"),
        (["[gb_yaw: 0.0 gb_pitch: -30.0 gb_roll: 0.0]"] * 40, "60 degrees away from straight down"),
        (["[focal_len: 24.00]"] * 40, "no angles of the gimbal: looking straight down assumed"),
    ],
)
def test_what_the_subtitles_say_about_the_lens_and_what_they_lack_is_reported(tmp_path, texts, message):
    assert any(message in line for line in read(with_subtitles(tmp_path, texts)).warnings)


def test_subtitles_inside_the_file_are_read(tmp_path):
    texts = [f"GPS({8.25 + k / 100:.4f},47.5000,16) BAROMETER:{k}.5".encode() for k in range(4)]
    samples = [len(text).to_bytes(2, "big") + text for text in texts]
    path = file_of_samples(tmp_path / "a.mp4", b"sbtl", b"tx3g", [100, 200, 300, 400], samples)
    (track,) = read_tracks(path)
    assert (track.handler, track.code) == ("sbtl", "tx3g")
    assert track.stamps_s == pytest.approx([0, 0.1, 0.3, 0.6])
    with path.open("rb") as file:
        assert list(track.samples(file)) == samples
    from slam.io.recordings.video.video import subtitles_of_track

    found, lost = subtitles_of_track(path, track)
    assert found.column("longitude") == pytest.approx([8.25, 8.26, 8.27, 8.28])
    assert found.stamps_s == pytest.approx([0, 0.1, 0.3, 0.6])
    assert lost == 0
    found, lost = subtitles_of_track(path, replace(track, offsets=track.offsets + [0, 10**6, 0, 0]))
    assert found.stamps_s == pytest.approx([0, 0.3, 0.6])
    assert lost == 1


WITHOUT_POSITIONS = ("juan_broken_empty", "juan_broken_empty2", "juan_mavic_air")


SUBTITLE_FILES = sorted(SAMPLES.glob("dji-srt/*.[sS][rR][tT]")) if "SLAM_DATA" in os.environ else []


@measured
def test_recorded_subtitles_are_there():
    assert len(SUBTITLE_FILES) == 28


@measured
@pytest.mark.parametrize("path", SUBTITLE_FILES, ids=lambda path: path.stem)
def test_every_recorded_file_of_subtitles_is_read_or_refused_in_one_line(path):
    """Positions lie in one place, and are updated 5 to 10 times a second, or once in the older models."""
    if path.stem in WITHOUT_POSITIONS:
        with pytest.raises(InputError):
            read(path)
        return
    gps = read(path).gps
    assert np.ptp(gps.latitude_deg) + np.ptp(gps.longitude_deg) < 0.1
    if len(gps.stamps_s) > 100:
        assert 0.9 < 1 / np.median(np.diff(gps.stamps_s)) < 15


@measured
def test_a_recorded_track_is_that_of_the_file():
    flight = read(SAMPLES / "dji-srt" / "nunzio_DJI_0023.SRT")
    assert (flight.gps.latitude_deg[0], flight.gps.longitude_deg[0]) == (41.151572, 16.412772)
    assert (flight.gps.altitude_m[0], flight.barometer.value[0]) == (172.044, 50.7)
    assert flight.notes["date"] == "2022-12-29"


@measured
def test_a_video_with_subtitles_is_a_flight():
    flight = read(SAMPLES / "dji-srt" / "synthetic_hybrid.MP4")
    assert (len(flight.frames), flight.camera.size_px) == (132, (176, 144))
    assert len(flight.gps.stamps_s) == 85
    assert all(flight.frames[k].read() is not None for k in (0, 131, 60))


def test_an_impossible_altitude_is_missing_and_told(tmp_path):
    texts = [NEWER.format(lat=47 + 1e-5 * k, lon=8.0, h=5.0 + k, alt=400.0 + k) for k in range(4)]
    texts[2] = texts[2].replace("abs_alt: 402.000", "abs_alt: " + "9" * 300)
    path = tmp_path / "a.srt"
    path.write_text("".join(cue(k, 1000 * k, 1000 * k + 1000, text) for k, text in enumerate(texts, 1)))
    flight = read(path)
    assert np.isnan(flight.gps.altitude_m).tolist() == [False, False, True, False]
    assert any("1 value of altitude beyond" in line for line in flight.warnings)


def test_a_subtitle_whose_date_is_damaged_is_left_out():
    cue = "{}\n2024-05-06 10:00:{:02d}\nGPS(8.5, 47.25, 400)\n\n"
    text = cue.format(1, 1) + cue.format(2, 2).replace("2024", "9924") + cue.format(3, 3)
    np.testing.assert_allclose(parse_subtitles(text).stamps_s, [0.0, 2.0])
