"""What the map shows of the instruments, in words."""

from __future__ import annotations

from math import degrees

from slam.core.estimate import AccelerometerErrors, AttitudeErrors, MountTilt
from slam.core.units import SPACE


def attitude_text(found: AttitudeErrors | None) -> str:
    """``roll +4.9 ± 0.9°, pitch +0.9 ± 0.3°; up to 10.5°``; empty where the map shows nothing."""
    if found is None:
        return ""
    each = [
        f"{name} {degrees(offset):+.2f} ±{SPACE}{degrees(std):.2f}°"
        for name, offset, std in zip(("roll", "pitch"), found.offset_rad, found.offset_std_rad, strict=True)
    ]
    return f"{', '.join(each)}; up to {degrees(found.largest_rad):.1f}°"


def heading_text(found: AttitudeErrors | None) -> str:
    """By how much the heading wandered."""
    if found is None or found.heading_wander_rad is None:
        return ""
    return f"{degrees(found.heading_wander_rad):.1f}°"


def mount_text(found: MountTilt | None) -> str:
    """How the camera sits on the body, against what was told."""
    if found is None:
        return ""
    roll, pitch = (f"{degrees(tilt):+.2f}" for tilt in found.tilt_rad)
    return f"roll {roll}, pitch {pitch} ±{SPACE}{degrees(found.std_rad):.2f}°"


def accelerometer_text(found: AccelerometerErrors | None) -> str:
    """Its offset, axis by axis."""
    if found is None:
        return ""
    axes = zip(("forward", "left", "up"), found.offset_m_s2, found.offset_std_m_s2, strict=True)
    return ", ".join(f"{name} {offset:+.3f} ±{SPACE}{std:.3f}" for name, offset, std in axes) + " m/s²"


def arm_text(found: AccelerometerErrors | None) -> str:
    """Where on the body it sits."""
    if found is None:
        return ""
    axes = zip(("forward", "left", "up"), found.arm_m, found.arm_std_m, strict=True)
    return ", ".join(f"{name} {1e3 * at:+.0f} ±{SPACE}{1e3 * std:.0f}" for name, at, std in axes) + " mm"


def lengths_text(found: AccelerometerErrors | None) -> str:
    """What it says of the map's lengths."""
    if found is None:
        return ""
    off, std = 100 * (found.scale - 1), 100 * found.scale_std
    use = "used for the map" if found.used else "not needed"
    return f"{off:+.1f} ±{SPACE}{std:.1f}{SPACE}% off the map's, {use}"
