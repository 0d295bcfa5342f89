"""Folders in the layout of KITTI's odometry benchmark: pictures in ``image_0`` and the like, and their times.

``times.txt`` has the time of each picture in seconds, ``calib.txt`` the projection of each camera after
rectification. Poses are those of a car's camera, whose axes say nothing about a vehicle, and are not read.
Source: Geiger, Lenz and Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite",
CVPR 2012; the readme of its odometry development kit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.messages import Message, warning
from slam.core.progress import Progress
from slam.io.csv_stream import MAX_STAMP_NS
from slam.io.files import brief, check_inside, read_text, refusal
from slam.io.recordings.picture_list import assumed_camera, listed_pictures
from slam.io.recordings.recording import Content, Offer, Recording

TIMES_NAME, CALIBRATION_NAME = "times.txt", "calib.txt"
_CAMERAS = ("image_0", "image_1", "image_2", "image_3")
_SUFFIXES = (".png", ".jpg", ".jpeg")
_MAX_BYTES = 1 << 26


def is_kitti(folder: Path) -> bool:
    """Return whether a folder has the names of the layout."""
    return (folder / TIMES_NAME).is_file() and any((folder / name).is_dir() for name in _CAMERAS)


def open_recording(path: Path) -> Recording:
    """Open a folder. Raises ``InputError`` where a time or the calibration cannot be read."""
    stamps_ns = _stamps(path)
    pictures = {name: found for name in _CAMERAS if (found := _names(path, name))}
    offers = tuple(
        Offer(stream="cam0", channel=name, kind="folder of pictures", rows=len(found), reading="8 bit")
        for name, found in pictures.items()
    )
    read_names = (TIMES_NAME, CALIBRATION_NAME)
    others = tuple((f.name, "text", 0) for f in sorted(path.glob("*.txt")) if f.name not in read_names)

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        camera = next(offer.channel for offer in chosen)
        names = pictures[camera]
        count = min(len(names), len(stamps_ns))
        differ = f"{camera} has {len(names)} pictures, {TIMES_NAME} {len(stamps_ns)} times"
        said = warning(f"{differ}: the first {count} are used", "check that both are complete")
        notes = (said,) * (len(names) != len(stamps_ns))
        lens = partial(_camera, path, camera)
        return Content(
            pictures=listed_pictures(path / TIMES_NAME, stamps_ns[:count], names[:count], lens, notes)
        )

    return Recording(
        path=path,
        name=path.resolve().name,
        description="a folder in KITTI's layout",
        offers=offers,
        others=others,
        read=read,
    )


def _stamps(folder: Path) -> NDArray[np.int64]:
    path = folder / TIMES_NAME
    lines = [line.strip() for line in read_text(path, folder, _MAX_BYTES)[0].splitlines()]
    stamps = []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        try:
            stamp_ns = float(line) * 1e9
        except ValueError:
            stamp_ns = np.nan
        if not 0 <= stamp_ns <= MAX_STAMP_NS:
            raise refusal(path, f"has the time {brief(line, 40)!r}", "write seconds", number)
        stamps.append(round(stamp_ns))
    return np.array(stamps, dtype=np.int64)


def _names(folder: Path, camera: str) -> tuple[str, ...]:
    """Return the pictures of a camera in the order of their names, from the folder."""
    if not (folder / camera).is_dir():
        return ()
    check_inside(folder / camera, folder)
    names = sorted(path.name for path in (folder / camera).iterdir() if path.suffix.lower() in _SUFFIXES)
    return tuple(f"{camera}/{name}" for name in names)


def _camera(folder: Path, name: str, size_px: tuple[int, int]) -> tuple[Camera, Message]:
    """Return the camera of a folder of pictures by its projection, else an assumed one; and a note."""
    path = folder / CALIBRATION_NAME
    key = f"P{name.rpartition('_')[2]}:"
    lines = read_text(path, folder, _MAX_BYTES)[0].splitlines() if path.is_file() else []
    for number, line in enumerate(lines, 1):
        if not line.startswith(key):
            continue
        try:
            values = [float(word) for word in line.split()[1:]]
        except ValueError:
            values = []
        if len(values) != 12 or not (np.isfinite(values).all() and values[0] > 0 and values[5] > 0):
            raise refusal(
                path, f"has no projection of 12 numbers for {key}", "correct it, or remove it", number
            )
        camera = Camera((values[0], values[5]), (values[2], values[6]), size_px)
        said = f"lens of {CALIBRATION_NAME}, {key[:-1]}: rectified pictures, without distortion"
        return camera, warning(said)
    return assumed_camera(size_px)
