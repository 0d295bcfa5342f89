"""Import of a folder of geotagged photographs as a flight, in which every photograph is a keyframe.

Missing tags are replaced by assumptions, which ``Flight.warnings`` lists together with the photographs that
are left out. The altitude is the maker's ``AbsoluteAltitude`` if present, as Exif's often has fewer digits or
is the uncorrected receiver's. Heights above sea level and above the ellipsoid differ by a constant, which
does not affect the map. Times come from the camera's clock if every photograph has it, else from the
satellites', else from the order of the names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted
from slam.core.flight import Flight
from slam.core.messages import Message, note, warning
from slam.core.names import listed
from slam.core.progress import Progress, silent
from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import AttitudeSeries, Frames, Scalar
from slam.io.files import brief
from slam.io.gcp_list import with_own_points
from slam.io.images import PictureFiles, common_levels
from slam.io.photos.camera import photo_camera
from slam.io.photos.camera_models import with_camera_models
from slam.io.photos.exif import PhotoTags
from slam.io.photos.geotag_table import with_geotags
from slam.io.photos.gps import photo_gps
from slam.io.photos.photo_set import AttitudeSource, Photo, select_photos
from slam.io.photos.position import HEIGHT_ABOVE_TAKEOFF_STD_M
from slam.io.photos.timestamp_marks import with_marks
from slam.io.photos.velocity import photo_velocities
from slam.io.transparent_pixels import transparent_pixels

Array = NDArray[np.float64]

_SECOND_NS = 10**9


def import_photos(folder: str | Path, progress: Progress = silent, band: str | None = None) -> Flight:
    """Read the photographs in a folder and its subfolders.

    The pictures stay on disk until they are requested. Of a multispectral camera one band is read: ``band``,
    or colour, or the one with the most photographs.
    Lenses come from cameras of OpenSfM or OpenDroneMap beside them (`slam.io.photos.camera_models`).
    Positions of DJI's marks beside them are preferred to the tags (`slam.io.photos.timestamp_marks`), and
    those of a table to both (`slam.io.photos.geotag_table`).
    Control points come from ``gcp_list.txt`` in the folder, if it is there (`slam.io.gcp_list`).
    Raises ``InputError`` if there is no folder, no photograph in it, or no usable one.
    """
    folder = Path(folder)
    selection = select_photos(folder, progress, band)
    lensed, beside, lens_remarks = with_camera_models(selection.photos, folder, selection.beside)
    marked, beside, mark_remarks = with_marks(lensed, folder, beside)
    located, geotag_remarks = with_geotags(marked, folder, beside)
    photos, stamps_ns, time_remarks = _sort_by_time(located)
    epoch_ns = int(stamps_ns[0])
    stamps_s = (stamps_ns - epoch_ns) / _SECOND_NS
    tags = [photo.tags for photo in photos]
    camera, camera_remarks = photo_camera(tags)
    gps, gps_remarks = photo_gps(photos, stamps_s)
    frames, frame_remarks = _frames(photos, stamps_s)
    velocity, velocity_remarks = photo_velocities(photos, gps, stamps_s)
    frames = replace(frames, w_v_m_s=velocity)
    vehicle = tags[0].model if tags[0].model.startswith(tags[0].make) else f"{tags[0].make} {tags[0].model}"
    date = datetime.fromtimestamp(epoch_ns // _SECOND_NS, UTC).date().isoformat() if epoch_ns else ""
    notes = {"vehicle": vehicle.strip(), "date": date}
    flight = Flight(
        name=brief(folder.resolve().name, 120) or "photos",
        epoch_ns=epoch_ns,
        camera=camera,
        frames=frames,
        attitude=_attitude(photos, selection.attitude, stamps_s),
        barometer=_heights_above_takeoff(tags, stamps_s),
        gps=gps,
        notes={key: value for key, value in notes.items() if value},
        all_keyframes=True,
    ).with_warning(
        *selection.remarks,
        *mark_remarks,
        *geotag_remarks,
        *time_remarks,
        *lens_remarks,
        *camera_remarks,
        *_several_cameras(tags),
        *gps_remarks,
        *velocity_remarks,
        *frame_remarks,
        *_damaged_tags(tags),
        *_turned(tags),
    )
    return with_own_points(flight, folder)


def _sort_by_time(photos: Sequence[Photo]) -> tuple[Sequence[Photo], NDArray[np.int64], tuple[Message, ...]]:
    """Return the photographs by time, strictly increasing stamps on one clock [ns], and the assumptions."""
    zones_known = all(photo.tags.utc_offset_ns is not None for photo in photos)
    camera = [
        None
        if t.camera_time_ns is None
        else t.camera_time_ns - ((t.utc_offset_ns or 0) if zones_known else 0)
        for t in (photo.tags for photo in photos)
    ]
    satellite = [photo.tags.gps_time_ns for photo in photos]
    for times, remark in (
        (
            camera,
            None
            if zones_known
            else note(
                "times from the camera's clock, time zone unknown, UTC assumed",
                "the map does not depend on it",
            ),
        ),
        (satellite, note("times from the satellites' clock")),
    ):
        known = [time for time in times if time is not None]
        if len(known) == len(photos) and (len(set(known)) > 1 or len(photos) == 1):
            # The sort is stable, so equal times keep the order of the names.
            order = sorted(range(len(photos)), key=lambda k: known[k])
            stamps = np.array([known[k] for k in order], dtype=np.int64)
            increasing, equal_count = _make_increasing(stamps)
            equal = (
                (note(f"{equal_count} equal time stamps spread evenly, in the order of the names"),)
                if equal_count
                else ()
            )
            return [photos[k] for k in order], increasing, (() if remark is None else (remark,)) + equal
    remark = note("no time of its own in every photograph: the order of the names, 1 s apart, assumed")
    return photos, np.arange(len(photos), dtype=np.int64) * _SECOND_NS, (remark,)


def _make_increasing(stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return sorted stamps made strictly increasing, and the number of equal ones. Equal stamps are spread
    evenly up to the next one, over at most a second.
    """
    distinct, start, count = np.unique(stamps_ns, return_index=True, return_counts=True)
    interval = np.minimum(np.diff(distinct, append=distinct[-1] + _SECOND_NS), _SECOND_NS)
    rank = np.arange(len(stamps_ns)) - np.repeat(start, count)
    increasing = stamps_ns + rank * np.repeat(interval // count, count)
    # Stamps less than a nanosecond apart cannot be spread, only shifted.
    index = np.arange(len(increasing))
    return np.maximum.accumulate(increasing - index) + index, int((count - 1).sum())


def _attitude(
    photos: Sequence[Photo], source: AttitudeSource | None, stamps_s: Array
) -> AttitudeSeries | None:
    known = [k for k, photo in enumerate(photos) if photo.w_R_b is not None]
    if source is None or not known:
        return None
    angles = roll_pitch_yaw_of(np.array([p.w_R_b for p in photos if p.w_R_b is not None]))
    roll, pitch, yaw = np.radians(source.std_deg)
    std_rad = float(roll), float(pitch), float(yaw)
    return AttitudeSeries(stamps_s[known], angles, std_rad, assumed=("noise_std",))


def _heights_above_takeoff(tags: Sequence[PhotoTags], stamps_s: Array) -> Scalar | None:
    known = [k for k, t in enumerate(tags) if t.position.height_above_takeoff_m is not None]
    height_m = np.array([tags[k].position.height_above_takeoff_m for k in known], dtype=float)
    return (
        Scalar(stamps_s[known], height_m, HEIGHT_ABOVE_TAKEOFF_STD_M, assumed=("noise_std",))
        if known
        else None
    )


def _frames(photos: Sequence[Photo], stamps_s: Array) -> tuple[Frames, tuple[Message, ...]]:
    paths = tuple(photo.path for photo in photos)
    notes: list[Message] = [*transparent_pixels(paths)]
    files = PictureFiles(paths, photos[0].tags.size_px, common_levels(paths, notes))
    return Frames(stamps_s, tuple(photo.name for photo in photos), files, files.failures), tuple(notes)


def _several_cameras(tags: Sequence[PhotoTags]) -> tuple[Message, ...]:
    """Return a remark where serial numbers tell several cameras of the model, whose lenses differ."""
    serials = Counter(t.serial for t in tags if t.serial)
    if len(serials) < 2:
        return ()
    each = listed([f"{count} of {brief(serial, 40)}" for serial, count in serials.most_common()])
    return (
        warning(
            f"photographs of {len(serials)} cameras of one model by their serial numbers ({each}): one "
            "lens is estimated for all, and focal lengths of one model differ by a percent or so, which "
            "heights follow",
            "map those of each camera alone",
        ),
    )


def _turned(tags: Sequence[PhotoTags]) -> tuple[Message, ...]:
    turned = sum(t.is_turned for t in tags)
    line = (
        f"{counted(turned, 'photograph has', 'photographs have')} an Exif orientation, by which viewers turn "
        "them: pixels, such as those of control points, are those of the pictures as they are stored"
    )
    return (note(line),) if turned else ()


def _damaged_tags(tags: Sequence[PhotoTags]) -> tuple[Message, ...]:
    damaged = sum(t.xmp_damaged for t in tags)
    return (
        (
            warning(
                f"{counted(damaged, 'photograph has', 'photographs have')} XMP tags that cannot be read, "
                "ignored",
                "copy the originals",
            ),
        )
        if damaged
        else ()
    )
