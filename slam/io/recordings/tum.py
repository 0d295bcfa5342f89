"""Folders in the layout of the TUM RGB-D benchmark: pictures in ``rgb.txt``, poses in ``groundtruth.txt``.

The poses are those of the camera's optical frame in the world of the motion capture. A flight has the pose of
the body, on which the camera looks down with the nose at the top. Sources: Sturm et al., "A benchmark for the
evaluation of RGB-D SLAM systems", IROS 2012; its pages "File formats" and "Intrinsic camera calibration".
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.messages import Message, warning
from slam.core.progress import Progress
from slam.io.csv_stream import MAX_STAMP_NS
from slam.io.files import brief, check_inside, read_bytes, refusal
from slam.io.recordings.picture_list import assumed_camera, listed_pictures
from slam.io.recordings.recording import Content, Offer, Recording, StreamReadings

Array = NDArray[np.float64]

LIST_NAME, TRUTH_NAME = "rgb.txt", "groundtruth.txt"
_MAX_TEXT_BYTES = 1 << 28
_MOST_DIGITS = 10
"""Digits of the seconds in the largest stamp."""
_TRUTH = "state_groundtruth_estimate0"
_CALIBRATIONS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, (0.0, 0.0, 0.0, 0.0, 0.0)),
}
"""Word in the folder's name -> fx, fy, cx, cy in px of 640 x 480, and distortion."""


def open_recording(path: Path) -> Recording:
    """Open a folder. Raises ``InputError`` where a list is damaged or names a file outside."""
    stamps_ns, names = _pictures(path)
    truth = _truth(path) if (path / TRUTH_NAME).is_file() else None
    offers = [
        Offer(stream="cam0", channel=LIST_NAME, kind="list of pictures", rows=len(names), reading="8 bit")
    ]
    if truth is not None:
        reading = "m, quaternion of the camera in the world, to the body"
        rows = len(truth.stamps_ns)
        offers.append(Offer(stream=_TRUTH, channel=TRUTH_NAME, kind="poses", rows=rows, reading=reading))
    others = tuple(
        (file.name, "list", 0)
        for file in sorted(path.glob("*.txt"))
        if file.name not in (LIST_NAME, TRUTH_NAME)
    )

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        taken = {offer.stream for offer in chosen}
        readings = {_TRUTH: truth} if truth is not None and _TRUTH in taken else {}
        camera_of = partial(_camera, path)
        is_taken = "cam0" in taken
        pictures = listed_pictures(path / LIST_NAME, stamps_ns, names, camera_of) if is_taken else None
        return Content(readings, pictures)

    return Recording(
        path=path,
        name=path.resolve().name,
        description="a TUM RGB-D folder",
        offers=tuple(offers),
        others=others,
        read=read,
    )


def _lines(path: Path, root: Path) -> list[tuple[int, list[str]]]:
    """Return number and words of each line that is no comment."""
    text = read_bytes(path, root, _MAX_TEXT_BYTES).decode("utf-8", errors="replace")
    rows = [(k, line.replace(",", " ").split()) for k, line in enumerate(text.splitlines(), 1)]
    return [(k, words) for k, words in rows if words and not words[0].startswith("#")]


def _nanoseconds(path: Path, line: int, text: str) -> int:
    """Return a stamp in seconds as nanoseconds, without the rounding of a float."""
    whole, _, part = text.partition(".")
    is_number = whole.isdecimal() and len(whole) <= _MOST_DIGITS and (not part or part.isdecimal())
    stamp_ns = int(whole) * 10**9 + int(part.ljust(9, "0")[:9] or 0) if is_number else -1
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise refusal(path, f"has the stamp {brief(text, 40)!r}", "write seconds", line)
    return stamp_ns


def _pictures(folder: Path) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    path = folder / LIST_NAME
    stamps, names = [], []
    for line, words in _lines(path, folder):
        if len(words) < 2:
            raise refusal(path, "has a line without a picture", "write: stamp filename", line)
        check_inside(folder / words[1], folder)
        stamps.append(_nanoseconds(path, line, words[0]))
        names.append(words[1])
    if not names:
        raise refusal(path, "lists no picture", "add lines: stamp filename")
    return np.array(stamps, dtype=np.int64), tuple(names)


def _truth(folder: Path) -> StreamReadings:
    path = folder / TRUTH_NAME
    stamps, rows = [], []
    for line, words in _lines(path, folder):
        try:
            rows.append([float(word) for word in words[1:8]])
        except ValueError:
            rows.append([])
        if len(rows[-1]) != 7:
            raise refusal(path, "has a line without a pose", "write: stamp tx ty tz qx qy qz qw", line)
        stamps.append(_nanoseconds(path, line, words[0]))
    poses = np.array(rows, dtype=float).reshape(-1, 7)
    with np.errstate(over="ignore"):
        length = np.linalg.norm(poses[:, 3:], axis=1)
    known = np.isfinite(poses).all(axis=1) & (length > 0.5) & (length < np.inf)
    c_R_b = NADIR_B_T_C[:3, :3].T
    values = np.full((len(poses), 16), np.nan)
    values[known, :3] = poses[known, :3]
    w_R_b = Rotation.from_quat(poses[known, 3:]) * Rotation.from_matrix(c_R_b)
    values[known, 3:7] = w_R_b.as_quat(scalar_first=True)
    return StreamReadings(np.array(stamps, dtype=np.int64), values)


def _camera(folder: Path, size_px: tuple[int, int]) -> tuple[Camera, Message]:
    name = next((word for word in _CALIBRATIONS if word in folder.resolve().name.lower()), None)
    if name is not None and size_px == (640, 480):
        fx, fy, cx, cy, distortion = _CALIBRATIONS[name]
        said = warning(f"lens of {name}, as its benchmark states it")
        return Camera((fx, fy), (cx, cy), size_px, distortion), said
    return assumed_camera(size_px)
