"""The single instrument that determines the stated accuracy of a track."""

from __future__ import annotations

from backend.ekf.inputs import Readings
from slam.core.units import length
from slam.inertial.instruments import InertialTrust


def track_accuracy_basis(readings: Readings, trust: InertialTrust, lasts_s: float) -> str:
    """Return a sentence that names the only instrument behind the track over ground of ``lasts_s``.

    It is empty where two instruments check each other, and where the track drifts without any.
    """
    flow, positions = readings.velocity_m_s is not None, readings.w_p_antenna_m is not None
    if flow and not positions:
        # At a constant velocity gyro and accelerometer read what they read at rest, but for the drag
        # (`slam.inertial.drag_check`). The errors of the velocity that the filter has as states last for a
        # second.
        error_m_s = trust.velocity_error_m_s
        return (
            "The track over ground and its accuracy rest on velocity0 alone. At a fixed heading no other "
            "instrument tells a constant error of it from wind; turns in flight do. The accuracy counts no "
            "such error: "
            f"{error_m_s:.2g} m/s would move the end of the track by {length(error_m_s * lasts_s, True)}."
        )
    if positions and not flow:
        return (
            "The track over ground and its accuracy rest on one GPS receiver alone; no second instrument "
            "checks them."
        )
    return ""
