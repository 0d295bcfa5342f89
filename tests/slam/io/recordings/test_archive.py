"""ZIP archives of recordings: what is in them, and what is refused."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from slam.cli.source import kind_of, open_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.made_flight import made_flight
from tests.slam.io.recordings.video.made_video import video


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def files_of(folder: Path, prefix: str = "") -> dict[str, bytes]:
    return {f"{prefix}{p.relative_to(folder)}": p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def read(path: Path):
    assert kind_of(path) == "archive"
    return open_flight(path, silent)[0]


@pytest.mark.parametrize("prefix", ["", "my flight/"])
def test_a_flight_folder_in_an_archive(tmp_path, prefix):
    write_flight(made_flight(), tmp_path / "flight")
    flight = read(zipped(tmp_path / "a.zip", {**files_of(tmp_path / "flight", prefix), "__MACOSX/._a": b"x"}))
    expected = read_flight(tmp_path / "flight")
    assert np.array_equal(flight.imu.accel_m_s2, expected.imu.accel_m_s2)
    assert np.array_equal(flight.frames[0].read(), expected.frames[0].read())


def test_a_video_with_its_subtitles_in_an_archive(tmp_path):
    cue = "1\n00:00:00,000 --> 00:00:01,000\n[latitude: 47.5] [longitude: 8.25]\n"
    content = {"day/DJI_1.MP4": video(tmp_path / "v.mp4", 5).read_bytes(), "day/DJI_1.SRT": cue.encode()}
    flight = read(zipped(tmp_path / "a.zip", content))
    assert (len(flight.frames), flight.gps.latitude_deg.tolist()) == (5, [47.5])


def test_several_recordings_are_named(tmp_path):
    content = video(tmp_path / "v.mp4", 5).read_bytes()
    with pytest.raises(
        InputError, match=r"holds 2 recordings \(a\.mp4, b\.mp4\); unpack it and name one of them"
    ):
        read(zipped(tmp_path / "a.zip", {"a.mp4": content, "b.mp4": content}))


def test_a_damaged_recording_beside_a_whole_one_is_named(tmp_path):
    content = video(tmp_path / "v.mp4", 5).read_bytes()
    flight = read(zipped(tmp_path / "a.zip", {"a.mp4": content, "b/b.ulg": b"damaged"}))
    assert len(flight.frames) == 5
    assert flight.warnings[0].startswith(
        "a.zip holds b/b.ulg: has the name of a PX4 log, but begins otherwise"
    )


def test_a_damaged_recording_alone_is_refused_by_its_name(tmp_path):
    with pytest.raises(InputError, match=r"b\.ulg: is empty; copy it again"):
        read(zipped(tmp_path / "a.zip", {"b.ulg": b"", "notes.txt": b"hello"}))


@pytest.mark.parametrize(
    "name", ["../evil.txt", "/evil.txt", "a/../../evil.txt", "..\\evil.txt", "C:/evil.txt"]
)
def test_a_name_that_leads_out_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="outside of itself"):
        read(zipped(tmp_path / "a.zip", {name: b"evil"}))
    assert not list(tmp_path.parent.glob("**/evil.txt"))


def test_an_archive_larger_than_the_disk_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    path = zipped(tmp_path / "a.zip", {"a.mp4": bytes(1 << 20)})
    monkeypatch.setattr("shutil.disk_usage", lambda where: type("Usage", (), {"free": 1000})())
    with pytest.raises(InputError, match=r"needs 1,048,576 bytes unpacked, .* has 1,000"):
        read(path)


def test_a_file_longer_than_declared_is_refused(tmp_path):
    """The declared sizes stand in the directory at the end, and before the file."""
    path = zipped(tmp_path / "a.zip", {"a.mp4": bytes(100_000)})
    content = path.read_bytes().replace((100_000).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"cannot be unpacked|than it declares"):
        read(path)


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_a_truncated_archive_is_one_line(tmp_path, share):
    path = zipped(tmp_path / "a.zip", {"a.bin": np.random.default_rng(0).bytes(10_000)})
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"a\.zip: is a ZIP archive that cannot be unpacked"):
        read(path)


def test_an_archive_without_a_flight_says_what_is_there(tmp_path):
    why = r"a\.zip: holds neither a recording, a flight folder nor photographs \(found: notes\.txt\)"
    with pytest.raises(InputError, match=why):
        read(zipped(tmp_path / "a.zip", {"notes.txt": b"hello"}))


def test_an_archive_in_an_archive(tmp_path):
    inner = zipped(tmp_path / "in.zip", {"v.mp4": video(tmp_path / "v.mp4", 5).read_bytes()}).read_bytes()
    outer = zipped(tmp_path / "out.zip", {"day/in.zip": inner, "day/notes.txt": b"hello"})
    assert len(read(outer).frames) == 5
    with pytest.raises(InputError, match=r"holds neither a recording"):
        read(zipped(tmp_path / "deep.zip", {"out.zip": outer.read_bytes()}))


def test_a_folder_of_recordings_names_them(tmp_path):
    folder = tmp_path / "DCIM"
    folder.mkdir()
    video(folder / "a.mp4", 5)
    with pytest.raises(InputError, match=r"is a folder of recordings \(a\.mp4\); give it itself"):
        kind_of(folder)
    (folder / "a.srt").write_text("1\n00:00:00,000 --> 00:00:01,000\n[latitude: 47.5] [longitude: 8.25]\n")
    video(folder / "b.mp4", 5)
    with pytest.raises(InputError, match=r"\(a\.mp4, b\.mp4\); give one, or those of one flight"):
        kind_of(folder)
