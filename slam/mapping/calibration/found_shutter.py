"""The shutter of the camera, as the map has found it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from frontend.camera import Camera
from slam.core.instrument_errors import RollingShutter
from slam.core.messages import Message, about
from slam.core.units import with_error
from slam.mapping.map import Map

Array = NDArray[np.float64]

_SETTLED = 0.05
"""Relative change of the read-out time beyond which the rows are corrected again. In an even flight the
correction is linear in that time, and the refinement corrects the rest: of a motion of three pixels, the
error is far below a tenth of one."""


def rolling_shutter(bundle: Bundle | None) -> RollingShutter | None:
    """Return the read-out time of the camera; None where nothing is known of it."""
    if bundle is None or bundle.readout is None:
        return None
    found = bundle.readout
    return RollingShutter(
        found.readout_s,
        found.std_s,
        found.prior_std_s,
        found.is_estimated,
        found.known_velocities,
        found.stated_s,
    )


def with_found_shutter(camera: Camera, refined: Map) -> Camera | None:
    """Return the camera of a video with the read-out time that a map has found; None where the rows of its
    pictures are corrected by nearly that time already."""
    bundle = refined.bundle
    if bundle is None or bundle.readout is None or not bundle.readout.is_estimated:
        return None
    found_s = bundle.readout.readout_s
    if abs(found_s - camera.readout_s) <= _SETTLED * abs(found_s):
        return None
    stated_s = camera.readout_s if camera.stated_readout_s is None else camera.stated_readout_s
    return replace(camera, readout_s=found_s, stated_readout_s=stated_s)


def refuted_shutter_warning(bundle: Bundle | None, camera_file: str) -> Message | None:
    """Return the warning about a stated read-out time in whose place the map has an estimated one."""
    found = None if bundle is None else bundle.readout
    if found is None or found.stated_s is None or not found.is_estimated:
        return None
    estimate = with_error(1e3 * found.readout_s, 1e3 * found.std_s)
    return about(
        "cam0",
        f"the stated read-out time of the shutter, {1e3 * found.stated_s:.3g} ms, contradicts the pictures",
        f"this map has {estimate} ms instead, as estimated from them",
        f"correct readout in {camera_file}",
    )


def row_motion(map_: Map) -> tuple[Array | None, Array | None]:
    """Return the motion (n, 3) of each camera in body axes from the exposure of the first row to that of the
    last, in metres, and its turn (n, 3), in rad; NaN for pictures outside the main part, None for a global
    shutter."""
    bundle = map_.bundle
    if bundle is None or bundle.row_motion_m is None or bundle.row_turn_rad is None:
        return None, None
    moved_m, turned_rad = np.full((2, len(map_.w_T_b), 3), np.nan)
    main = np.flatnonzero(map_.component == 0)
    if len(main) == len(bundle.row_motion_m):  # else instruments have joined other parts to the refined one
        moved_m[main], turned_rad[main] = bundle.row_motion_m, bundle.row_turn_rad
    return moved_m, turned_rad
