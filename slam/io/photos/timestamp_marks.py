"""Positions of photographs in ``Timestamp.MRK``, which DJI's drones with RTK write beside them.

A line has the number of a photograph, the GPS time of its exposure, the offset from the antenna to the
sensor of the camera (north, east and down [mm]), the place after this offset (latitude, longitude and height
over the ellipsoid), its standard deviations (north, east and up [m]) and the kind of solution. So the place
is that of the camera.
Source: DJI, Matrice 4 Series User Manual (2025), "Image Log File".
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from backend.wording import counted
from slam.core.errors import InputError
from slam.core.geodesy import position_fault
from slam.core.height_systems import ELLIPSOID
from slam.core.messages import Message, note, warning
from slam.core.names import listed
from slam.io.files import read_text, refused_file, shown
from slam.io.photos.photo_set import Photo
from slam.io.photos.position import RTK_SOLUTIONS, PhotoPosition

SUFFIX = ".mrk"
_MAX_BYTES = 1 << 26
_NUMBER = r"\s*([-+]?\d+(?:\.\d*)?)\s*"
_LINE = re.compile(
    rf"\s*(\d+)\s+[\d.]+\s+\[\d+\]\s+{_NUMBER},\s*N\s+{_NUMBER},\s*E\s+{_NUMBER},\s*V\s+"
    rf"{_NUMBER},\s*Lat\s+{_NUMBER},\s*Lon\s+{_NUMBER},\s*Ellh\s+"
    rf"{_NUMBER},{_NUMBER},{_NUMBER}\s+(\d+),\s*Q\s*"
)
_FILE_NAME = re.compile(r"_?Timestamp\.MRK$", re.IGNORECASE)
"""The end of the name of a file, after the name of the flight."""
_NUMBER_IN_NAME = re.compile(r"(?:^|_)(\d{3,4})(?:_[A-Z]+)?$", re.IGNORECASE)
"""The number at the end of DJI's names, ``100_0001_0012`` and ``DJI_20250101120000_0012_V``."""
_SAME_PLACE_M, _SIGMAS = 2.0, 3.0
"""A mark is of the photograph if the place in its tags is nearer than this distance and so many standard
deviations: the offset of the antenna may be a part of it, and neighbours on a line lie farther apart."""


@dataclass(frozen=True)
class _Mark:
    """One line of the file."""

    offset_m: tuple[float, float, float]
    """North, east and down from the antenna to the camera."""
    latitude_deg: float
    longitude_deg: float
    height_m: float
    std_m: tuple[float, float, float]
    """East, north, up."""
    solution: str


@dataclass(frozen=True)
class _MarkFile:
    """The marks of one flight."""

    path: Path
    name: str
    """Path below the folder of the photographs."""
    marks: dict[int, _Mark]
    """Number of a photograph -> mark."""

    def names(self, photo: Photo) -> bool:
        """Return whether a photograph of its folder has a name that begins as that of the file does."""
        return photo.path.parent == self.path.parent and photo.path.name.startswith(
            _FILE_NAME.sub("", self.path.name) + "_"
        )


def with_marks(
    photos: Sequence[Photo], folder: Path, beside: Sequence[Path]
) -> tuple[list[Photo], list[Path], tuple[Message, ...]]:
    """Return photographs with the places of files, the other files ``beside`` them, and lines about these.

    A photograph has the mark of its number in a file of its folder, unless its tags lie elsewhere. The
    numbers of several flights in one folder begin at 1 each: there the names of the files tell which
    photographs are theirs, or else the places do.
    """
    files, remarks = list[_MarkFile](), list[Message]()
    for path in (path for path in beside if path.suffix.lower() == SUFFIX):
        name = shown(str(path.relative_to(folder)))
        try:
            marks, unread = _marks(path, folder)
        except InputError as refused:
            remarks.append(refused_file(refused, folder, "its places are not used"))
            continue
        files.append(_MarkFile(path, name, marks))
        if unread:
            remarks.append(
                warning(f"{name}: {counted(unread, 'line')} cannot be read, and {unread} places are missing")
            )
    placed, used = list(photos), dict[str, list[tuple[PhotoPosition, _Mark]]]()
    elsewhere, ambiguous = dict[str, list[str]](), dict[str, list[str]]()
    of_names = {file.path for file in files if any(map(file.names, photos))}
    for k, photo in enumerate(photos):
        own = [
            file for file in files if file.path.parent == photo.path.parent and _number(photo) in file.marks
        ]
        own = [file for file in own if file.path not in of_names or file.names(photo)]
        near = [file for file in own if _is_of(file.marks[_number(photo)], photo.tags.position)]
        if len(near) == 1:
            mark = near[0].marks[_number(photo)]
            used.setdefault(near[0].name, []).append((photo.tags.position, mark))
            placed[k] = _at(photo, mark)
        elif own:
            reason = ambiguous if near else elsewhere
            reason.setdefault(listed([file.name for file in near or own]), []).append(photo.name)
    remarks += [
        warning(
            f"{names}: the marks of {counted(len(of), 'photograph')} lie elsewhere than the places in "
            f"their tags and are not used ({listed(of)})",
            "are they of another flight?",
        )
        for names, of in elsewhere.items()
    ]
    remarks += [
        warning(
            f"{names}: each has a mark that may be of {counted(len(of), 'photograph')} ({listed(of)}), "
            "and none of these is used",
            "put each flight into a folder of its own",
        )
        for names, of in ambiguous.items()
    ]
    remarks += [_about(name, found, len(photos)) for name, found in used.items()]
    return placed, [path for path in beside if path.suffix.lower() != SUFFIX], tuple(remarks)


def _marks(path: Path, folder: Path) -> tuple[dict[int, _Mark], int]:
    """Return number of a photograph -> mark, and the number of lines that are none. Raises ``InputError``."""
    marks, unread = dict[int, _Mark](), 0
    for line in read_text(path, folder, _MAX_BYTES)[0].splitlines():
        if not line.strip():
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            unread += 1
            continue
        north, east, down, latitude, longitude, height, std_n, std_e, std_u = map(float, match.groups()[1:10])
        is_placed = int(match[11]) and min(std_n, std_e, std_u) > 0
        if not is_placed or position_fault(latitude, longitude):
            unread += 1
            continue
        marks[int(match[1])] = _Mark(
            (1e-3 * north, 1e-3 * east, 1e-3 * down),
            latitude,
            longitude,
            height,
            (std_e, std_n, std_u),
            RTK_SOLUTIONS.get(int(match[11]), ""),
        )
    if not marks:
        raise InputError(f"{path}: holds no place of a photograph")
    return marks, unread


def _number(photo: Photo) -> int:
    """Return the number of a photograph in its folder; -1 for a name without one."""
    match = _NUMBER_IN_NAME.search(photo.path.stem)
    return int(match[1]) if match else -1


def _is_of(mark: _Mark, tags: PhotoPosition) -> bool:
    """Return whether a mark may be of a photograph by the place in its tags."""
    within_m = _SAME_PLACE_M + _SIGMAS * float(np.hypot(*mark.std_m[:2]))
    return not tags.apart_m(mark.latitude_deg, mark.longitude_deg) > within_m


def _at(photo: Photo, mark: _Mark) -> Photo:
    position = PhotoPosition(
        latitude_deg=mark.latitude_deg,
        longitude_deg=mark.longitude_deg,
        altitude_m=mark.height_m,
        std_m=mark.std_m,
        rtk=mark.solution,
        height_system=ELLIPSOID,
        is_of_camera=True,
        height_above_takeoff_m=photo.tags.position.height_above_takeoff_m,
    )
    return photo.at(position)


def _about(name: str, found: Sequence[tuple[PhotoPosition, _Mark]], total: int) -> Message:
    """Return a line about the marks that are used."""
    offset_m = float(np.mean([np.linalg.norm(mark.offset_m) for _, mark in found]))
    known = [(tags, mark) for tags, mark in found if tags.is_known]
    apart_m = max((tags.apart_m(mark.latitude_deg, mark.longitude_deg) for tags, mark in known), default=0.0)
    beside = f"those in the tags differ by up to {apart_m:.2g} m along the ground" if known else ""
    return note(
        f"places of {len(found)} of {total} photographs, with their accuracies, are those of {name}: of the "
        f"camera, {offset_m:.2g} m from the antenna on average",
        beside,
    )
