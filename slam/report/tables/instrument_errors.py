"""Instrument errors that the map reveals, in words."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees

from backend.wording import counted
from slam.core.instrument_errors import (
    AccelerometerErrors,
    AntennaPlace,
    AttitudeErrors,
    BarometerErrors,
    LensNumber,
    MountTilt,
    RollingShutter,
    VelocityErrors,
)
from slam.core.units import SPACE, to_error, with_error


def attitude_text(found: AttitudeErrors | None) -> str:
    """Offsets of the attitude sensor in words: ``roll +4.9 ± 0.9°, pitch +0.9 ± 0.3° on average,
    up to 10.5° at one keyframe``; empty where the map reveals none."""
    if found is None:
        return ""
    each = [
        f"{name} {with_error(degrees(offset), degrees(std), '+')}°"
        for name, offset, std in zip(("roll", "pitch"), found.offset_rad, found.offset_std_rad, strict=True)
    ]
    return f"{', '.join(each)} on average, up to {degrees(found.largest_rad):.1f}° at one keyframe"


def heading_text(found: AttitudeErrors | None) -> str:
    """Wander of the heading, in words."""
    if found is None or found.heading_wander_rad is None:
        return ""
    return (
        f"{degrees(found.heading_wander_rad):.1f}° over the flight, against the map: magnetometers and gyros "
        "drift so; the pictures hold the heading of the map"
    )


def mount_text(found: MountTilt | None) -> str:
    """Tilt of the camera on the body relative to the reported mount, in words."""
    if found is None:
        return ""
    roll, pitch = (with_error(degrees(tilt), degrees(found.std_rad), "+") for tilt in found.tilt_rad)
    return f"roll {roll}°, pitch {pitch}°"


def lens_text(found: Mapping[str, LensNumber] | None, estimated: bool = True) -> str:
    """Return the numbers of the lens that the flight determines, in words, or if not ``estimated`` those that
    are known mostly by what was told before it."""
    return ", ".join(
        f"{name} {with_error(n.value, n.std)} (before the flight: "
        f"{to_error(n.told, n.std) if estimated else with_error(n.told, n.told_std)})"
        for name, n in (found or {}).items()
        if n.estimated == estimated
    )


def shutter_text(found: RollingShutter | None) -> str:
    """Read-out time of the camera, and whether it was estimated, in words."""
    if found is None:
        return ""
    motion = f"the motion of {counted(found.known_velocities, 'picture')}"
    if found.estimated:
        ms = with_error(1e3 * found.readout_s, 1e3 * found.std_s)
        stated = "" if found.stated_s is None else f"; {1e3 * found.stated_s:.3g} ms are stated"
        return f"rolling: {ms} ms from the first row to the last, estimated by {motion}{stated}"
    if found.told_std_s == 0:
        return f"rolling: {1e3 * found.readout_s:.3g} ms from the first row to the last, as stated"
    known = f"tells its time to {1e3 * found.std_s:.2g} ms"
    return f"taken as global: {motion} shows no rolling shutter, and {known}"


def antenna_text(found: AntennaPlace | None) -> str:
    """Estimated place of the GPS antenna on the body, in words."""
    if found is None:
        return ""
    rows = zip(("forward", "left"), found.place_m, found.std_m, found.told_m, strict=False)
    each = [f"{axis} {with_error(at, std, '+')} m (told {stated:+.2f})" for axis, at, std, stated in rows]
    return ", ".join(each)


def accelerometer_text(found: AccelerometerErrors | None) -> str:
    """Offset of the accelerometer, axis by axis, in words."""
    if found is None:
        return ""
    axes = zip(("forward", "left", "up"), found.offset_m_s2, found.offset_std_m_s2, strict=True)
    return ", ".join(f"{name} {with_error(offset, std, '+')}" for name, offset, std in axes) + " m/s²"


def arm_text(found: AccelerometerErrors | None) -> str:
    """Position of the accelerometer on the body, in words."""
    if found is None:
        return ""
    axes = zip(("forward", "left", "up"), found.arm_m, found.arm_std_m, strict=True)
    return ", ".join(f"{name} {with_error(1e3 * at, 1e3 * std, '+')}" for name, at, std in axes) + " mm"


def lag_text(found: AccelerometerErrors | None) -> str:
    """Delay of the accelerometer's readings behind the gyro's, in words; empty where none was taken out."""
    if found is None or not found.lag_taken_out:
        return ""
    return f"{with_error(1e3 * found.lag_s, 1e3 * found.lag_std_s, '+')}{SPACE}ms, taken out"


def lengths_text(found: AccelerometerErrors | None) -> str:
    """Scale of the map's lengths according to the accelerometer, in words."""
    if found is None:
        return ""
    off, std = 100 * (found.scale - 1), 100 * found.scale_std
    beside = (
        "those of the other instruments, before both were joined" if found.used else "the map's, not needed"
    )
    return f"{with_error(off, std, '+')}{SPACE}% off {beside}"


def velocity_text(found: VelocityErrors | None) -> str:
    """Gain and offset of the vehicle's own velocity, in words."""
    if found is None:
        return ""
    gains = zip(found.gain, found.gain_std, strict=True)
    offsets = zip(found.offset_m_s, found.offset_std_m_s, strict=True)
    ratio = [f"{with_error(gain, std)} times the true one" for gain, std in gains]
    more = [f"{with_error(offset, std, '+')} m/s" for offset, std in offsets]
    return f"forward {ratio[0]}, {more[0]}; left {ratio[1]}, {more[1]}"


def barometer_text(found: BarometerErrors | None) -> str:
    """Gain and noise of the barometer, in words."""
    if found is None:
        return ""
    gain = f"{with_error(found.gain, found.gain_std)} times the true changes of height"
    return f"{gain}, noise {found.noise_m:.2g}{SPACE}m"
