"""Exposure times and camera poses of the rows of a picture.

Within one picture the camera's pose is interpolated between moments ``KNOT_S`` apart. That is short compared
with the vehicle's attitude lag of 0.1 s. The error is below 0.03 px against an exact pose for each row
(``tests/slam/simulation/camera/test_shutter.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.simulation.camera.effects import CameraEffects

Array = NDArray[np.float64]

KNOT_S = 0.005
SMEAR_PX = 0.75
"""Motion of the picture during one sub-exposure."""
MAX_PARTS = 32


def moments(stamps_s: Array, effects: CameraEffects, duration_s: float) -> Array:
    """Return the times (n, m), within the flight, of the poses of pictures stamped ``stamps_s``."""
    first = stamps_s - effects.time_offset_s - effects.exposure_s / 2
    count = 1 if effects.window_s == 0 else int(np.ceil(effects.window_s / KNOT_S)) + 1
    times_s = first[:, None] + np.linspace(0.0, effects.window_s, count)
    return np.clip(times_s, 0.0, duration_s)


def parts(w_T_c: Array, focal_px: float, effects: CameraEffects) -> int:
    """Return the number of sub-exposures for the fastest corner, from camera poses (m, 4, 4)."""
    if effects.exposure_s == 0:
        return 1
    distance_m = np.linalg.norm(np.diff(w_T_c[:, :3, 3], axis=0), axis=1).sum()
    turns = np.diff(w_T_c[:, :3, :3], axis=0)
    # |R1 - R0| (Frobenius) is sqrt(2) times the angle; a corner moves up to 1.5 times as far as the centre.
    turn = np.linalg.norm(turns, axis=(1, 2)).sum() / np.sqrt(2)
    smear_px = (
        focal_px
        * (distance_m / max(w_T_c[0, 2, 3], 0.05) + 1.5 * turn)
        * effects.exposure_s
        / effects.window_s
    )
    return int(np.clip(np.ceil(smear_px / SMEAR_PX), 1, MAX_PARTS))


def row_poses(
    w_T_c: Array, rows: int, part: int, part_count: int, effects: CameraEffects
) -> tuple[Array, Array]:
    """Return rotations (1 or rows, 3, 3) and positions (1 or rows, 3) at one sub-exposure.

    ``w_T_c`` (m, 4, 4) are the camera's poses at the picture's ``moments``. The result has one pose where all
    rows share it.
    """
    if len(w_T_c) == 1:
        return w_T_c[:, :3, :3], w_T_c[:, :3, 3]
    delay = np.linspace(0.0, 1.0, rows) if effects.readout_s > 0 else np.zeros(1)
    at_s = delay * effects.readout_s + (part + 0.5) / part_count * effects.exposure_s
    at = np.clip(at_s / effects.window_s, 0, 1) * (len(w_T_c) - 1)
    k = np.minimum(at.astype(int), len(w_T_c) - 2)
    share = (at - k)[:, None, None]
    between = (1 - share) * w_T_c[k] + share * w_T_c[k + 1]
    return between[:, :3, :3], between[:, :3, 3]
