"""Conversion of manufacturers' gimbal angles to the attitude of a body with a down-looking camera.

The makers' frame ``n`` is north-east-down, their angles are ``Rz(yaw) Ry(pitch) Rx(roll)`` in it: yaw
clockwise from north, pitch positive upwards, roll positive to the right. The flight's world ``w`` is
east-north-up, its body ``b`` forward-left-up, and the camera is mounted as ``NADIR_B_T_C`` defines: the
top of a straight-down picture is the body's forward. A picture straight down with its top to north therefore
has roll = pitch = 0 and yaw = +90 degrees, whatever the maker.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C
from slam.core.rotations import rotation_of
from slam.io.body_axes import FRD_R_B, W_R_N

Array = NDArray[np.float64]

GIMBAL_STD_DEG = (2.0, 2.0, 5.0)
"""Standard deviations of a gimbal's roll, pitch, yaw."""
_GIMBAL_R_C = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""Rotation from camera axes to a gimbal at rest. The camera looks along x, with its right along y and down
along z.
"""


def body_from_gimbal(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    """Return w_R_b (3, 3) from gimbal angles, where pitch 0 looks at the horizon and -90 straight down
    (DJI)."""
    w_R_c = W_R_N @ _n_R(yaw_deg, pitch_deg, roll_deg) @ _GIMBAL_R_C
    return np.asarray(w_R_c @ NADIR_B_T_C[:3, :3].T)


def body_from_mount(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    """Return w_R_b (3, 3) from the attitude of a vehicle whose camera looks straight down at 0, 0 (Pix4D)."""
    return W_R_N @ _n_R(yaw_deg, pitch_deg, roll_deg) @ FRD_R_B


def tilt_deg(w_R_b: Array) -> float:
    """Return the angle between the optical axis and straight down."""
    return float(np.degrees(np.arccos(np.clip(w_R_b[2, 2], -1, 1))))


def _n_R(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    return rotation_of(np.radians([roll_deg, pitch_deg, yaw_deg]))
