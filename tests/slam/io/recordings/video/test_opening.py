"""Options of FFmpeg while a video is opened: they belong to the whole process."""

from __future__ import annotations

import os
import threading

import pytest

from slam.io.recordings.video.pictures import packet_times

OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"


class Opened:
    """A video without pictures."""

    def grab(self) -> bool:
        return False

    def release(self) -> None:
        pass


@pytest.mark.parametrize("of_user", ["threads;1", None])
def test_options_of_the_user_count_while_a_video_is_opened_and_stay(monkeypatch, tmp_path, of_user):
    seen = []

    def opened(*_):
        seen.append(os.environ[OPTIONS])
        return Opened()

    monkeypatch.setattr("slam.io.recordings.video.pictures.cv2.VideoCapture", opened)
    monkeypatch.delenv(OPTIONS, raising=False)
    if of_user:
        monkeypatch.setenv(OPTIONS, of_user)
    packet_times(tmp_path / "a.avi")
    assert seen == ["threads;1|fflags;sortdts" if of_user else "fflags;sortdts"]
    assert os.environ.get(OPTIONS) == of_user


def test_videos_that_are_opened_at_once_leave_no_options_behind(monkeypatch, tmp_path):
    """The first one would end while the second one is opened, if that did not wait."""
    begun, ended = threading.Event(), threading.Event()

    def opened(name, *_):
        if name.endswith("first.avi"):
            second.start()
            begun.wait(0.1)
        else:
            begun.set()
            ended.wait(1.0)
        return Opened()

    monkeypatch.setattr("slam.io.recordings.video.pictures.cv2.VideoCapture", opened)
    monkeypatch.delenv(OPTIONS, raising=False)
    second = threading.Thread(target=packet_times, args=(tmp_path / "second.avi",))
    packet_times(tmp_path / "first.avi")
    ended.set()
    second.join()
    assert OPTIONS not in os.environ
