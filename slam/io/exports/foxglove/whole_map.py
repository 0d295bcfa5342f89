"""The messages of a finished map, in order of time."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from frontend.camera import Camera
from frontend.workers import Workers
from slam.core.errors import InputError, one_line
from slam.core.estimate import Estimate
from slam.core.messages import Kind, by_kind, parsed
from slam.core.names import listed
from slam.core.streams import Frames
from slam.io.exports.bag_messages import BODY, CAMERA, WORLD
from slam.io.exports.exported_map import ExportedMap
from slam.io.exports.foxglove import messages
from slam.io.exports.foxglove.floor import floor_points
from slam.io.exports.foxglove.foxglove_file import FoxgloveFile
from slam.io.exports.foxglove.links import link_entities
from slam.io.exports.foxglove.pictures import WIDTH_PX, jpeg

_PIXELS_PER_POINT = 256
"""Pixels of the pictures for each point of the ground. A point takes 16 bytes and a pixel a quarter of one,
so that the ground takes a quarter of the pictures."""
_LEAST_POINTS, _MOST_POINTS = 2_000, 250_000


def map_facts(estimate: Estimate) -> dict[str, str]:
    """Return what a reader must know of the map as a whole."""
    facts = {"name": one_line(estimate.name), "status": one_line(estimate.status)}
    facts["unit"] = "m" if estimate.metric else "mean heights of the camera"
    facts["floor_z"] = f"{estimate.floor_z_m:.4f}"
    if (origin := estimate.origin) is not None:
        facts["origin_latitude_deg"] = repr(origin.latitude_deg)
        facts["origin_longitude_deg"] = repr(origin.longitude_deg)
        facts["origin_altitude_m"] = repr(origin.altitude_m if origin.altitude_known else math.nan)
    return facts


def write_map(file: FoxgloveFile, exported: ExportedMap) -> tuple[str, ...]:
    """Write all messages of a map, and return notes. Raises ``InputError`` for pictures of another flight."""
    estimate, keyframes, unread = exported.estimate, exported.keyframes, []
    frames = exported.flight.frames if exported.flight is not None else None
    camera = None if estimate.camera is None else estimate.camera.narrowed(WIDTH_PX)
    pictures: Iterator[bytes | None] | None = None
    if frames is not None and camera is not None:
        _check_names(exported, frames)
        pictures = _pictures(exported, frames, camera)
    notes = _write_once(file, exported)
    covariances = keyframes.fixed_axes_covariances
    has_place = estimate.origin is not None
    places = list(zip(*exported.navigation_fixes(keyframes), strict=True)) if has_place else []
    for k, stamp_ns in enumerate(keyframes.stamps_ns.tolist()):
        T, name = keyframes.w_T_b[k], keyframes.names[k]
        about = {"picture": name, "part": str(int(keyframes.component[k]))}
        file.add("/tf", stamp_ns, messages.transforms(stamp_ns, WORLD, BODY, T))
        file.add("/slam/pose", stamp_ns, messages.pose_in_frame(stamp_ns, T))
        file.add("/slam/odometry", stamp_ns, messages.odometry(stamp_ns, T, covariances[k], about))
        if places:
            fix = messages.location(stamp_ns, places[k], covariances[k, :3, :3], T)
            file.add("/slam/fix", stamp_ns, fix)
        if pictures is not None and camera is not None:
            picture = next(pictures)
            if picture is None:
                unread.append(name)
                continue
            file.add("/camera/calibration", stamp_ns, messages.calibration(stamp_ns, camera))
            file.add("/camera/image", stamp_ns, messages.image(stamp_ns, picture))
    if unread:
        notes.append(f"pictures that cannot be read are left out: {listed(unread)}")
    return (*notes, *exported.navigation_notes())


def _check_names(exported: ExportedMap, frames: Frames) -> None:
    estimate = exported.estimate
    for k in exported.keyframes.numbers.tolist():
        frame, name = int(estimate.frame_index[k]), estimate.frame_names[k]
        if frame >= len(frames) or frames.names[frame] != name:
            raise InputError(
                f"--photos: picture {frame} of the flight is not {one_line(name)} of the map; give the one "
                "flight that the map was made of, or make the file with slam optimize --mcap"
            )


def _pictures(exported: ExportedMap, frames: Frames, camera: Camera) -> Iterator[bytes | None]:
    """Yield the picture of each keyframe as JPEG; None for one that cannot be read."""
    chosen = exported.estimate.frame_index[exported.keyframes.numbers].tolist()

    def read(shared: Frames, frame: int) -> bytes | None:
        picture = shared[frame].read()
        return None if picture is None else jpeg(picture, camera)

    for done, picture in enumerate(Workers().map(read, frames, chosen)):
        exported.progress("pictures", done, len(chosen))
        yield picture
    exported.progress("pictures", len(chosen), len(chosen))


def _write_once(file: FoxgloveFile, exported: ExportedMap) -> list[str]:
    """Write what belongs to no single keyframe at the first stamp, and return notes."""
    estimate, keyframes, camera = exported.estimate, exported.keyframes, exported.estimate.camera
    first_ns, notes = int(keyframes.stamps_ns[0]), []
    status = parsed(f"status: {estimate.status}")
    status = status.as_reason() if by_kind(estimate.messages).reasons else status.as_note()
    for message in (status, *estimate.messages):
        is_warning = message.kind is not Kind.NOTE
        file.add("/slam/log", first_ns, messages.log(first_ns, one_line(message.text), is_warning=is_warning))
    if camera is not None:
        mount = messages.transforms(first_ns, BODY, CAMERA, camera.b_T_c)
        file.add("/tf_static", first_ns, mount)
    file.add("/slam/path", first_ns, messages.path(first_ns, keyframes.w_T_b))
    links, note = link_entities(estimate, keyframes.numbers, first_ns)
    file.add("/slam/links", first_ns, messages.scene(links))
    if note:
        notes.append(note)
    if camera is not None and exported.folder is not None:
        width, height = camera.narrowed(WIDTH_PX).size_px
        most = int(np.clip(len(keyframes) * width * height // _PIXELS_PER_POINT, _LEAST_POINTS, _MOST_POINTS))
        ground = floor_points(exported.folder, estimate, most)
        if ground is not None:
            file.add("/slam/floor", first_ns, messages.point_cloud(first_ns, *ground))
    return notes
