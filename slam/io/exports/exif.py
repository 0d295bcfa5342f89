"""Copies of the photographs with the estimated positions in their tags; pixels stay byte by byte."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from backend.wording import counted
from slam.core.errors import InputError
from slam.core.names import listed
from slam.io.exports.camera_position import REPLACED, CameraPosition
from slam.io.exports.exported_map import ExportedMap
from slam.io.exports.picture_tags import with_tags
from slam.io.exports.tiff_tags import TiffTags
from slam.io.exports.xmp_position import with_position
from slam.io.files import read_bytes, refusal
from slam.io.photos.search import find_photos
from slam.io.picture_headers import MAX_BYTES


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write a copy of each photograph that is placed, and name the others.

    Raises ``InputError`` if no photograph of the map can be copied.
    """
    folder = exported.photos
    assert folder is not None
    paths = dict(find_photos(folder).photos)
    # Pictures of several flights are known by their place in the folder above.
    paths = {path.relative_to(folder).as_posix().replace("/", "_"): path for path in paths.values()} | paths
    left_out: dict[str, list[str]] = defaultdict(list)
    positions = _positions(exported)
    for done, (name, position) in enumerate(positions.items()):
        exported.progress("photographs", done, len(positions))
        if name not in paths:
            left_out["not in the folder"].append(name)
            continue
        try:
            picture = read_bytes(paths[name], folder, MAX_BYTES)
            (target / name).write_bytes(_positioned(picture, position))
        except ValueError as reason:
            left_out[str(reason)].append(name)
    exported.progress("photographs", len(positions), len(positions))
    lost = [f"{len(names)} left out: {reason} ({listed(names)})" for reason, names in left_out.items()]
    if sum(map(len, left_out.values())) == len(positions):
        do = "give the folder that the map was made of, or the one that holds those of all its flights"
        raise refusal(folder, f"no photograph of the map can be copied: {'; '.join(lost)}", do)
    unused = len(set(paths.values()) - {paths[name] for name in positions if name in paths})
    return (
        *lost,
        *(f"{counted(unused, 'photograph is', 'photographs are')} not on the map, and not copied",)
        * bool(unused),
    )


def _positions(exported: ExportedMap) -> dict[str, CameraPosition]:
    """Return the position of each placed photograph by its name."""
    camera = exported.estimate.camera
    assert camera is not None
    cameras = exported.keyframes.in_one_folder().of_sensor(camera.b_T_c)
    if len({*cameras.names}) < len(cameras):
        raise InputError("--to exif: two photographs of the map have one name")
    places = zip(*exported.geodetic(cameras), strict=True)
    return {
        name: CameraPosition(
            float(latitude),
            float(longitude),
            float(altitude),
            (float(std[0]), float(std[1]), float(std[2])) if np.isfinite(std).all() else None,
        )
        for name, (latitude, longitude, altitude), std in zip(
            cameras.names, places, cameras.position_stds_m, strict=True
        )
    }


def _positioned(picture: bytes, position: CameraPosition) -> bytes:
    def set_position(tags: TiffTags) -> None:
        tags.set_gps(position.exif(), REPLACED)

    return with_tags(picture, set_position, lambda packet: with_position(packet, position))
