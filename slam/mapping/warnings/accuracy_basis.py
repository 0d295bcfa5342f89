"""The single instrument or the assumed values that determine the stated accuracy of a map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from backend.bundle.lens import FOCAL
from slam.core.flight import Flight
from slam.core.messages import CHECKED_BY_ONE_DISTANCE, Message, warning
from slam.core.names import enumerated
from slam.core.units import percent
from slam.mapping.map import Map

LEAST_SHARE = 0.01
"""Share of the scale, among instruments that measure lengths, below which one of them checks no other: by
itself it would tell lengths ten times less exactly than all together."""
VAGUE_SCALE_STD = 0.1
"""Relative standard deviation of the scale beyond which a map is not one to measure with: twice the nominal
gain error of a height sensor. Any length may then be wrong by a fifth."""
LEAST_CHECKS = 2
"""Check points with a known distance between them."""
Shares = Mapping[str, Mapping[str, float]]
"""As `backend.bundle.accuracy.information_shares` returns them; empty where they are not known."""


def telling_lengths(instruments: Mapping[str, tuple[str, bool]], shares: Shares) -> list[str]:
    """Return the names of the instruments that are used and tell the scale notably.

    ``instruments`` maps a name to the instrument's name in ``shares`` and to whether it is used.
    """
    scale = shares.get("scale", {})
    share = {name: scale.get(key, 0.0) for name, (key, used) in instruments.items() if used}
    return [name for name, each in share.items() if each >= LEAST_SHARE * sum(share.values())]


def accuracy_basis(flight: Flight, map_: Map, shares: Shares) -> str:
    """Return a sentence that names the only instrument or assumption behind scale and place.

    It is empty where two instruments check each other, where check points tell how far lengths are off, or
    where lengths are not metres.
    """
    if map_.control is not None and len(map_.control.checks) >= LEAST_CHECKS:
        return ""
    bundle = map_.bundle
    measured = None if bundle is None else bundle.optimum.problem.measurements
    by_gps = map_.georeferenced and (measured is None or bool(measured.positions))
    ranged = bundle is not None and bundle.range_errors is not None
    inertial = map_.inertial is not None and map_.inertial.helps
    by_barometer = bundle is not None and bundle.uses_barometer and not (map_.georeferenced or inertial)
    by_velocity = bundle is not None and bundle.uses_reported_motion and not ranged
    used = {
        "one height sensor": ("range", ranged),
        "one GPS receiver": ("position", by_gps),
        "control points": ("control", measured is not None and bool(measured.control)),
        "one accelerometer": ("imu", inertial),
        "one barometer": ("barometer", by_barometer),
        "the vehicle's own velocity": ("velocity", by_velocity),
    }
    telling = telling_lengths(used, shares)
    # Positions place the map, whatever they weigh in its lengths.
    placing = [name for name, (key, is_used) in used.items() if is_used and key in ("position", "control")]
    sources = [name for name in used if name in (*telling, *placing)]
    if len(sources) != 1:
        return ""
    (source,) = sources
    what = "Place, lengths" if map_.georeferenced else "Lengths"
    unchecked = f"no second instrument checks them{_assumed(flight, map_)}{_heights_by_lens(map_)}"
    return f"{what} and their accuracy rest on {source} alone; {unchecked}. {CHECKED_BY_ONE_DISTANCE}"


def _assumed(flight: Flight, map_: Map) -> str:
    """Name the values of the height sensor that the flight does not determine, and a lens that is held.

    A length on the ground is the height times an angle: the focal length enters it as the height does.
    """
    found = map_.bundle.range_errors if map_.bundle is not None else None
    if flight.sonar is None or found is None:
        return ""
    gain, zero = flight.sonar.scale_std, flight.sonar.datum_std_m
    gain_determined, zero_determined = found.determined(gain, zero)
    exact, assumed, stated = list[str](), list[str](), list[str]()
    for name, known, std, size, key in (
        ("its gain", gain_determined, gain, f"± {100 * gain:.2g} %", "scale_std"),
        ("its zero", zero_determined, zero, f"± {1e3 * zero:.2g} mm", "datum_std"),
    ):
        if not known and std:
            (assumed if key in flight.sonar.assumed else stated).append(f"{name} ({size})")
        elif not known:
            exact.append(name)
    if map_.camera.focal_std_ratio == 0:
        exact.append("the camera's focal length")
    clauses = [
        f"{enumerated(names)} {'are' if len(names) > 1 else 'is'} {how}"
        for names, how in ((assumed, "assumed"), (stated, "as stated"), (exact, "taken as exact"))
        if names
    ]
    return f", and {', and '.join(clauses)}" if clauses else ""


def _heights_by_lens(map_: Map) -> str:
    """Name the focal length on which heights rest where positions alone tell lengths.

    Over flat ground at one height, a focal length that is wrong moves the ground up or down and leaves no
    other trace (`backend.bundle.lens_evidence`).
    """
    bundle = map_.bundle
    if not map_.georeferenced or bundle is None or bundle.range_errors is not None:
        return ""
    lens = bundle.lens
    if lens is not None and lens.is_estimated[FOCAL].any():
        return ""
    known = "taken as exact"
    if lens is not None:
        known = f"known to {percent(lens.prior_std[0] / lens.calibration[0])} beforehand"
    return (
        f", and heights over the ground rest on the focal length, {known}, which this flight does not check"
    )


def scale_warning(flight: Flight, map_: Map, shares: Shares) -> Message:
    """Return what the scale of a map rests on that has neither ranges nor GPS, and what to do about it."""
    measured = flight.sonar is not None and bool(np.isfinite(flight.sonar.range_m).any())
    lacking = "no sonar range that fits the pictures, and no GPS" if measured else "no sonar and no GPS"
    if map_.bundle is None or map_.bundle.scale_std is None:
        return warning(
            f"{lacking}: no metric scale",
            "lengths are in units of the camera's mean height over the floor",
            "measure one distance on the ground and scale the map by it",
        )
    used = {
        "the vehicle's own velocity": ("velocity", map_.bundle.uses_reported_motion),
        "the accelerometer": ("imu", map_.inertial is not None and map_.inertial.helps),
        "the barometer's changes of height": ("barometer", map_.bundle.uses_barometer),
    }
    # Parts that the readings of an IMU join have their lengths from these.
    sources = telling_lengths(used, shares) or ["the accelerometer"]
    if len(sources) > 1 or "the accelerometer" in sources:
        source = f"lengths come from {enumerated(sources)} and are"
    else:
        source = f"no metric scale but that of {sources[0]},"
    check = "measure one distance on the ground to check it"
    return warning(f"{lacking}: {source} known to {100 * map_.bundle.scale_std:.2g} %", check)


def vague_lengths_warning(map_: Map) -> Message | None:
    """Return what to do about lengths in metres that are known too vaguely to measure with; else None."""
    std = map_.bundle.scale_std if map_.bundle is not None else None
    if std is None or std <= VAGUE_SCALE_STD:
        return None
    return warning(
        f"all lengths are known to {100 * std:.2g} % only: what tells them is too inexact for ground of this "
        "size",
        "measure one distance on the ground and scale the map by it, add control points, or map more ground",
    )
