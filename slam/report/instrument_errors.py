"""What the map shows of the instruments, in words."""

from __future__ import annotations

from math import degrees

from slam.estimate import AccelerometerErrors, AttitudeErrors

_SPACE = "\N{NARROW NO-BREAK SPACE}"


def attitude_told(found: AttitudeErrors | None) -> str:
    """``roll +4.9 ± 0.9°, pitch +0.9 ± 0.3°; up to 10.5°``; empty where the map shows nothing."""
    if found is None:
        return ""
    each = [
        f"{name} {degrees(offset):+.2f} ±{_SPACE}{degrees(std):.2f}°"
        for name, offset, std in zip(("roll", "pitch"), found.offset_rad, found.offset_std_rad, strict=True)
    ]
    return f"{', '.join(each)}; up to {degrees(found.largest_rad):.1f}°"


def heading_told(found: AttitudeErrors | None) -> str:
    """By how much the heading wandered."""
    if found is None or found.heading_wander_rad is None:
        return ""
    return f"{degrees(found.heading_wander_rad):.1f}°"


def accelerometer_told(found: AccelerometerErrors | None) -> str:
    """Its offset, axis by axis."""
    if found is None:
        return ""
    axes = zip(("forward", "left", "up"), found.offset_m_s2, found.offset_std_m_s2, strict=True)
    return ", ".join(f"{name} {offset:+.3f} ±{_SPACE}{std:.3f}" for name, offset, std in axes) + " m/s²"
