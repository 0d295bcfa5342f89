"""Streams and the lens of a flight from the subtitles of a video."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.lens_priors import PLAUSIBLE_FOCAL, UNKNOWN_FOCAL_STD_RATIO
from slam.core.messages import Message, clauses_of, note, warning
from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import Gps
from slam.io.down_looking import MAX_TILT_DEG, tilt_remark
from slam.io.gimbal import GIMBAL_STD_DEG, body_from_gimbal, tilt_deg
from slam.io.photos.camera import ASSUMED_VIEW, assumed_focal_px
from slam.io.photos.position import HEIGHT_ABOVE_TAKEOFF_STD_M
from slam.io.recordings.recording import Offer, StreamReadings
from slam.io.recordings.video.model_lens import FILM_WIDTH_MM, ModelLens
from slam.io.recordings.video.subtitles import Subtitles, changed_rows
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]

_FOCAL_STD_RATIO, _RADIAL_STD = 0.1, 0.1
"""Standard deviations of its focal length (relative) and k1. Makers relate the focal length on 35 mm film
to the width or to the diagonal of the sensor, and video modes crop the picture.
"""
_ASSUMED: Mapping[str, Value] = {"assumed": ["noise_std"]}
"""The subtitles state no accuracy."""
_ZOOM_RATIO = 1.01
"""A larger ratio of the focal lengths in one video is a zoom, not rounding."""


def subtitle_offers(subtitles: Subtitles, name: str) -> list[Offer]:
    """Return the streams that the subtitles can fill."""
    order = ", GPS(latitude, longitude, altitude)" if subtitles.latitude_first else ""
    kinds = (
        ("attitude0", "gimbal_pitch", "gimbal degrees, north-east-down to the body of a nadir camera"),
        ("gps0", "latitude", f"deg, m{order}"),
        ("barometer0", "height", "m above the take-off"),
    )
    return [
        Offer(stream=stream, channel=name, kind="subtitles", rows=int(known), reading=reading)
        for stream, field, reading in kinds
        if (known := np.isfinite(subtitles.column(field)).sum())
    ]


def _readings(subtitles: Subtitles, values: Array, nominal: Mapping[str, Value]) -> StreamReadings:
    """Return the rows that differ from the row before; the others only hold it."""
    keep = changed_rows(values)
    repeated = int(np.isfinite(values[:, 0]).sum() - keep.sum())
    notes = (
        note(
            f"{repeated} of {repeated + int(keep.sum())} subtitles repeat the value before and were dropped"
        ),
    )
    stamps_ns = np.round(subtitles.stamps_s[keep] * 1e9).astype(np.int64)
    return StreamReadings(stamps_ns, values[keep], nominal, notes * bool(repeated))


def _gps(subtitles: Subtitles) -> StreamReadings:
    names = ("latitude", "longitude", "altitude", "height")
    values = np.column_stack([subtitles.column(name) for name in names])
    east_m, north_m, up_m = Gps.noise_std_m
    latitude = float(np.nanmedian(values[:, 0]))
    rounding_deg = subtitles.position_step_deg / math.sqrt(12)  # of a uniform error
    noise = (
        math.hypot(north_m / METRES_PER_DEGREE, rounding_deg),
        math.hypot(east_m / metres_per_degree_east(latitude), rounding_deg),
        up_m,
    )
    found = _readings(subtitles, values, {"noise_std": [repr(v) for v in noise], **_ASSUMED})
    return StreamReadings(found.stamps_ns, found.values[:, :3], found.nominal, found.notes)


def _barometer(subtitles: Subtitles) -> StreamReadings:
    nominal: dict[str, Value] = {"noise_std": [repr(HEIGHT_ABOVE_TAKEOFF_STD_M)], **_ASSUMED}
    return _readings(subtitles, subtitles.column("height")[:, None], nominal)


def _attitude(subtitles: Subtitles) -> StreamReadings:
    names = ("gimbal_yaw", "gimbal_pitch", "gimbal_roll")
    angles_deg = np.column_stack([subtitles.column(name) for name in names])
    known = np.isfinite(angles_deg).all(axis=1)
    w_R_b = np.array([body_from_gimbal(*row) for row in angles_deg[known]]).reshape(-1, 3, 3)
    values = np.full(angles_deg.shape, np.nan)
    values[known] = roll_pitch_yaw_of(w_R_b)
    # A gimbal's angle that is held is a reading: the gimbal holds it.
    stamps_ns = np.round(subtitles.stamps_s[known] * 1e9).astype(np.int64)
    noise: dict[str, Value] = {"noise_std": [repr(math.radians(v)) for v in GIMBAL_STD_DEG], **_ASSUMED}
    tilts = [tilt_deg(R) for R in w_R_b]
    tilt = float(np.median(tilts)) if tilts else 0.0
    notes = (tilt_remark(tilt).prefixed("the camera"),)
    return StreamReadings(stamps_ns, values[known], noise, notes * (tilt > MAX_TILT_DEG))


SUBTITLE_READERS: Mapping[str, Callable[[Subtitles], StreamReadings]] = {
    "attitude0": _attitude,
    "gps0": _gps,
    "barometer0": _barometer,
}
"""Folder of a stream -> its readings."""


def _focal_mm(subtitles: Subtitles) -> Array:
    """Return the focal lengths (n,) on 35 mm film, with the zoom."""
    focal_mm = subtitles.column("focal_mm") * np.nan_to_num(subtitles.column("zoom"), nan=1.0)
    return focal_mm[np.isfinite(focal_mm) & (focal_mm > 0)]


def _implausible_focal(focal_mm: Array, size_px: tuple[int, int]) -> Message | None:
    """Return a line where the focal lengths (n,) are none on 35 mm film; None where they are."""
    if not len(focal_mm):
        return None
    median_mm = float(np.median(focal_mm))
    low, high = PLAUSIBLE_FOCAL
    if low < median_mm / FILM_WIDTH_MM * size_px[0] / max(size_px) < high:
        return None
    return warning(
        f"focal_len {median_mm:g} mm is not used: no lens has it on 35 mm film (that of the lens itself?)"
    )


def video_camera(
    size_px: tuple[int, int],
    subtitles: Subtitles | None,
    has_angles: bool,
    by_model: ModelLens | None = None,
) -> tuple[Camera, list[Message]]:
    """Return the camera of a video, and the assumptions, one line each.

    ``has_angles`` states that the recording has an attitude. The focal length of the subtitles is that of the
    moment, and is preferred to that of the model.
    """
    width, height = size_px
    focal_mm = np.empty(0) if subtitles is None else _focal_mm(subtitles)
    notes = list[Message]()
    if implausible := _implausible_focal(focal_mm, size_px):
        notes.append(implausible)
        focal_mm = np.empty(0)
    distortion, std_ratio = Camera.distortion, _FOCAL_STD_RATIO
    if len(focal_mm):
        film_mm = float(np.median(focal_mm))
        focal_px = film_mm / FILM_WIDTH_MM * width
        notes.append(
            note(f"focal length {focal_px:.0f} px from {film_mm:g} mm on 35 mm film", "no distortion assumed")
        )
        if focal_mm.max() > _ZOOM_RATIO * focal_mm.min():
            zooms = f"from {focal_mm.min():g} to {focal_mm.max():g} mm"
            notes.append(
                warning(
                    f"the lens zooms {zooms}, but one focal length is modelled",
                    "keep the zoom fixed in flight",
                )
            )
    elif by_model is not None:
        focal_px, distortion = by_model.focal_px, by_model.distortion
        notes.append(note(*clauses_of(f"focal length {focal_px:.0f} px {by_model.remark}")))
    else:
        focal_px, std_ratio = assumed_focal_px(size_px), UNKNOWN_FOCAL_STD_RATIO
        notes.append(
            warning(f"focal length {focal_px:.0f} px assumed: {ASSUMED_VIEW}", "calibrate the camera")
        )
    if subtitles is not None and subtitles.stabilised:
        notes.append(
            warning(
                "pictures are stabilised electronically, so the lens differs from picture to picture",
                "record with the stabilisation off",
            )
        )
    if not has_angles:
        notes.append(
            warning("no angles of the gimbal: looking straight down assumed", "keep the camera there")
        )
    camera = Camera(
        focal_px=(focal_px, focal_px),
        center_px=((width - 1) / 2, (height - 1) / 2),
        size_px=size_px,
        distortion=distortion,
        focal_std_ratio=std_ratio,
        radial_std=_RADIAL_STD,
    )
    return camera, notes
