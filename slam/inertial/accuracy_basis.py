"""The single instrument that determines the stated accuracy of a track."""

from __future__ import annotations

from backend.ekf.inputs import Readings
from slam.inertial.instruments import InertialTrust


def track_accuracy_basis(readings: Readings, trust: InertialTrust) -> str:
    """Return a sentence that names the only instrument behind the track over ground.

    It is empty where two instruments check each other, and where the track drifts without any.
    """
    flow, positions = readings.velocity_m_s is not None, readings.w_p_b_m is not None
    if flow and not positions:
        # In axes that move at a constant velocity, gyro and accelerometer read the same.
        return (
            "The track over ground and its accuracy rest on velocity0 alone: at a fixed heading no other "
            f"instrument shows a constant error of it, and ± {trust.velocity_error_m_s:.2g} m/s is assumed."
        )
    if positions and not flow:
        return (
            "The track over ground and its accuracy rest on one GPS receiver alone; no second instrument "
            "checks them."
        )
    return ""
