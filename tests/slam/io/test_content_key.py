"""Digests by which a later run knows that files are as they were."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from slam.core.join_flights import JoinedPictures
from slam.core.streams import Frames
from slam.io.content_key import digest_with, file_key, source_key
from slam.io.images import PictureFiles
from slam.io.levels import Levels
from slam.io.recorded_pictures import RecordedPictures


def test_a_file_is_known_by_its_content(tmp_path):
    paths = [tmp_path / name for name in "abc"]
    for path, content in zip(paths, (b"one", b"one", b"two"), strict=True):
        path.write_bytes(content)
    one, same, other = map(file_key, paths)
    assert one == same != other
    assert file_key(tmp_path / "missing") is None
    assert file_key(tmp_path) is None


def test_what_is_no_file_in_the_folder_of_a_recording_does_not_count(tmp_path):
    (tmp_path / "bag").write_bytes(b"one")
    known = source_key([tmp_path])
    (tmp_path / "gone").symlink_to(tmp_path / "missing")
    assert source_key([tmp_path]) == known
    os.mkfifo(tmp_path / "pipe")
    assert source_key([tmp_path]) == known


def test_a_large_file_is_known_by_parts_and_its_time(tmp_path, monkeypatch):
    monkeypatch.setattr("slam.io.content_key._WHOLE_BYTES", 64)
    monkeypatch.setattr("slam.io.content_key._PART_BYTES", 8)
    path = tmp_path / "video"
    path.write_bytes(bytes(1000))
    os.utime(path, ns=(0, 10**9))
    known = file_key(path)
    assert file_key(path) == known
    for change in (0, 999):
        changed = bytearray(1000)
        changed[change] = 1
        path.write_bytes(changed)
        os.utime(path, ns=(0, 10**9))
        assert file_key(path) != known
    path.write_bytes(bytes(1000))
    os.utime(path, ns=(0, 10**9 + 1))
    assert file_key(path) != known


def test_a_recording_in_a_folder_is_known_by_all_its_files(tmp_path):
    (tmp_path / "inner").mkdir()
    for name in ("a", "inner/b"):
        (tmp_path / name).write_text(name)
    known = source_key([tmp_path])
    assert known is not None
    (tmp_path / "inner/b").write_text("changed")
    assert source_key([tmp_path]) != known
    assert source_key([tmp_path, tmp_path / "missing"]) is None


def test_pictures_are_known_by_their_files_and_how_they_are_read(tmp_path):
    paths = (tmp_path / "a.png", tmp_path / "missing.png")
    paths[0].write_bytes(b"content")
    files = PictureFiles(paths, (4, 3))
    assert files.content_key(0) == PictureFiles(paths, (4, 3)).content_key(0)
    assert files.content_key(0) != PictureFiles(paths, (4, 3), Levels(0.0, 9.0)).content_key(0)
    assert files.content_key(1) is None


class Fetch:
    def __call__(self, k: int) -> bytes:
        return b""

    def content_key(self, k: int) -> bytes | None:
        return digest_with(b"file", k)


@pytest.mark.parametrize(("fetch", "is_known"), [(Fetch(), True), (lambda k: b"", False)])
def test_recorded_and_joined_pictures_pass_on_what_their_source_knows(fetch, is_known):
    recorded = RecordedPictures(fetch, np.array([3, 5]), (4, 3), "png")
    assert (recorded.content_key(0) is not None) == is_known
    assert not is_known or recorded.content_key(0) != recorded.content_key(1)
    frames = Frames(np.arange(2.0), ("a", "b"), recorded)
    joined = JoinedPictures([frames, frames])
    assert [joined.content_key(k) for k in range(4)] == 2 * [recorded.content_key(k) for k in range(2)]


def test_a_link_that_leads_nowhere_is_unknown(tmp_path: Path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    assert file_key(tmp_path / "link") is None
