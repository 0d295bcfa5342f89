"""The GPS series of a set of photographs, and remarks on every position that is not used or assumed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted, either
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.height_systems import UNKNOWN
from slam.core.messages import Message, note, warning
from slam.core.names import listed
from slam.core.streams import Gps
from slam.io.gps_accuracy import median_and_each
from slam.io.photos.photo_set import Photo
from slam.io.photos.position import RTK_SOLUTIONS, UNSIGNED, PhotoPosition
from slam.io.photos.unused_tags import unused_tags

Array = NDArray[np.float64]

_SAME_PLACE_M = 1.0
"""Places that differ by less are those of one receiver, which a camera stores twice at other moments."""
_FIXED = RTK_SOLUTIONS[50]
_NO_PLACE = "the map has no metric scale and no place on Earth"
_GIVE_PLACES = "copy the originals with their tags, or give control points (--gcp)"


def photo_gps(photos: Sequence[Photo], stamps_s: Array) -> tuple[Gps | None, tuple[Message, ...]]:
    """Return the positions of photographs, in their order, at ``stamps_s`` (n,), and the remarks."""
    names = [photo.name for photo in photos]
    positions, remarks = _with_letters_of_others([photo.tags.position for photo in photos], names)
    remarks += _faults(positions, names)
    known = [k for k, p in enumerate(positions) if p.is_known]
    if not known:
        what = "can be used" if remarks else "is recorded"
        return None, (
            *remarks,
            warning(f"no GPS position of any photograph {what}: {_NO_PLACE}", _GIVE_PLACES),
        )
    if len(known) < len(positions):
        remarks.append(
            warning(
                f"{len(positions) - len(known)} of {len(positions)} photographs "
                f"{either(len(positions) - len(known), 'has', 'have')} no GPS position to use: the "
                "pictures alone place them"
            )
        )
    fixes = [positions[k] for k in known]
    altitude_m, remark = _altitudes(fixes)
    remarks += remark
    gap_m = np.abs(altitude_m - _column(fixes, "exif_altitude_m"))
    if (gap_m > 1).any():
        remarks.append(
            warning(
                "altitude from the maker's tag",
                f"Exif's differs by up to {np.nanmax(gap_m):.0f} m",
                "check the altitude of one point if altitudes matter",
            )
        )
    remarks += [*_places_differ(fixes), *_other_datums(fixes)]
    std_m, stds_m, accuracy = _accuracy(fixes)
    gps = Gps(
        stamps_s[known],
        _column(fixes, "latitude_deg"),
        _column(fixes, "longitude_deg"),
        altitude_m,
        std_m,
        stds_m=stds_m,
        height_system=_height_system(fixes),
        assumed=_assumed(fixes),
    )
    return gps, (*remarks, *accuracy)


def _assumed(fixes: Sequence[PhotoPosition]) -> tuple[str, ...]:
    """Return what no tag states: where the antenna is, unless places are those of the camera, and noise."""
    place = () if all(fix.is_of_camera for fix in fixes) else ("T_BS",)
    return (*place, "noise_std") if all(fix.std_m is None for fix in fixes) else place


def _height_system(fixes: Sequence[PhotoPosition]) -> str:
    """Return the vertical datum of the altitudes, empty where not all have the same."""
    systems = {fix.height_system for fix in fixes if fix.altitude_m is not None}
    return systems.pop() if len(systems) == 1 else UNKNOWN


def _altitudes(fixes: Sequence[PhotoPosition]) -> tuple[Array, list[Message]]:
    """Return the altitudes (n,), NaN where there is none, and a remark where some are missing."""
    altitude_m = _column(fixes, "altitude_m")
    # A receiver gives no two altitudes of exactly 0: programs write it where none is known.
    written_m = altitude_m[np.isfinite(altitude_m)]
    zeros = len(written_m) > 1 and not written_m.any()
    if zeros:
        altitude_m = np.full(len(fixes), np.nan)
    lacking = int(np.isnan(altitude_m).sum())
    if not lacking:
        return altitude_m, []
    if lacking < len(fixes):
        none = f"{lacking} of {len(fixes)} GPS positions {either(lacking, 'has', 'have')} no altitude"
        return altitude_m, [warning(f"{none}: the others alone tell the height")]
    none = "altitude 0 wherever one is written, which is none" if zeros else "no GPS position has an altitude"
    return altitude_m, [
        warning(
            f"{none}: heights count from the floor, and nothing tells where that lies above the sea",
            "copy the originals with their tags, or give control points with heights (--gcp)",
        )
    ]


def _places_differ(fixes: Sequence[PhotoPosition]) -> list[Message]:
    """Return a remark where Exif's places are not those of the maker's tags, which are used."""
    gaps = [(p.exif_gap_deg, p.latitude_deg or 0.0) for p in fixes if p.exif_gap_deg is not None]
    metres = [
        np.hypot(north * METRES_PER_DEGREE, east * metres_per_degree_east(at)) for (north, east), at in gaps
    ]
    other = [m for m in metres if m > _SAME_PLACE_M]
    if not other:
        return []
    return [
        warning(
            f"places of {counted(len(other), 'photograph')} from the maker's tags",
            f"Exif's differ by up to {max(other):.3g} m: if these were corrected afterwards (PPK), remove "
            "the maker's, for example with exiftool -XMP-drone-dji:all=",
        )
    ]


def _other_datums(fixes: Sequence[PhotoPosition]) -> list[Message]:
    """Return a remark for each datum other than WGS 84 that Exif names."""
    return [
        warning(
            f"GPSMapDatum of {counted(count, 'photograph')} is {datum}: positions are taken as WGS 84, from "
            "which older datums differ by up to a kilometre",
            "transform them, or give a table of positions or control points (--gcp)",
        )
        for datum, count in sorted(Counter(fix.datum for fix in fixes if fix.datum).items())
    ]


def _column(fixes: Sequence[PhotoPosition], name: str) -> Array:
    return np.array([np.nan if getattr(p, name) is None else getattr(p, name) for p in fixes], dtype=float)


def _accuracy(
    fixes: Sequence[PhotoPosition],
) -> tuple[tuple[float, float, float], Array | None, list[Message]]:
    """Return the median standard deviations of the set, those of each fix (n, 3) if they differ much, and
    remarks."""
    stated = [p.std_m for p in fixes if p.std_m is not None]
    if not stated:
        assumed = "{:g}, {:g}, {:g} m".format(*Gps.noise_std_m)
        said = note(
            f"accuracy of the GPS assumed: {assumed}",
            "if it is better, run slam import and correct noise_std in gps0/sensor.yaml",
        )
        return Gps.noise_std_m, None, [said, *_rtk_solutions(fixes)]
    remarks = _rtk_solutions(fixes)
    typical = np.median(stated, axis=0)
    without = [p.std_m is None and p.rtk not in ("", _FIXED) for p in fixes]
    silent = sum(p.std_m is None for p in fixes) - sum(without)
    if any(without):
        assumed = "{:g}, {:g}, {:g} m assumed".format(*Gps.noise_std_m)
        line = (
            f"{sum(without)} of {len(fixes)} GPS positions state no accuracy and have no fixed RTK solution"
        )
        remarks.append(note(f"{line}: {assumed}"))
    if silent:
        line = f"{silent} of {len(fixes)} GPS positions state no accuracy: that of the others is assumed"
        remarks.append(note(line))
    stds_m = np.array(
        [
            Gps.noise_std_m if alone else typical if p.std_m is None else p.std_m
            for p, alone in zip(fixes, without, strict=True)
        ]
    )
    return *median_and_each(stds_m, Gps.noise_std_m), remarks


def _rtk_solutions(fixes: Sequence[PhotoPosition]) -> list[Message]:
    """Return a remark with the number of fixes of each RTK solution where not all are fixed."""
    counts = Counter(p.rtk or "unknown" for p in fixes)
    if not any(p.rtk for p in fixes) or set(counts) == {_FIXED}:
        return []
    text = ", ".join(f"{count} {solution}" for solution, count in sorted(counts.items()))
    return [
        note(f"RTK solutions of {counted(len(fixes), 'GPS position')}: {text}", "each has its own accuracy")
    ]


def _faults(positions: Sequence[PhotoPosition], names: Sequence[str]) -> list[Message]:
    """Return one line for each kind of tag that is present but not used, with its photographs."""
    lines = unused_tags("position", [(n, p.faults) for n, p in zip(names, positions, strict=True)])
    letters = "write the letters, for example with exiftool -GPSLatitudeRef=N -GPSLongitudeRef=E"
    return [line.extended(letters * (UNSIGNED in line.text)) for line in lines]


def _with_letters_of_others(
    positions: Sequence[PhotoPosition], names: Sequence[str]
) -> tuple[list[PhotoPosition], list[Message]]:
    """Return the positions with missing letters N, S, E, W taken from the others, if all others agree."""
    signs = {
        (np.sign(p.latitude_deg), np.sign(p.longitude_deg))
        for p in positions
        if p.latitude_deg is not None and p.longitude_deg is not None
    }
    if len(signs) != 1:
        return list(positions), []
    north, east = next(iter(signs))
    there = ("N" if north >= 0 else "S") + ("E" if east >= 0 else "W")
    lacking = [
        k for k, p in enumerate(positions) if p.unsigned_deg is not None and set(p.letters) <= set(there)
    ]
    complete = list(positions)
    for k in lacking:
        lat, lon = positions[k].unsigned_deg or (0.0, 0.0)
        complete[k] = replace(
            positions[k],
            latitude_deg=float(north * lat),
            longitude_deg=float(east * lon),
            faults=tuple(fault for fault in positions[k].faults if UNSIGNED not in fault),
        )
    line = warning(
        f"{counted(len(lacking), 'photograph')} without the letters N or S, E or W: those of the others, "
        f"{there[0]} and {there[1]}, assumed ({listed([names[k] for k in lacking])})",
        "write the letters where that is wrong",
    )
    return complete, [line] if lacking else []
