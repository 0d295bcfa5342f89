"""The limit of a map's accuracy, and what a pilot can do about it with the instruments at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from slam.core.estimate import Estimate
from slam.core.messages import by_kind
from slam.core.units import percent
from slam.report.facts import Facts

if TYPE_CHECKING:
    from slam.core.summary import Summary
    from slam.report.mosaic_facts import MosaicFacts

WORDS: Mapping[str, str] = {
    "range": "the height sensor",
    "pictures": "the pictures themselves",
    "flat_floor": "how flat the ground is",
    "attitude": "the attitude sensor",
    "position": "the GPS",
    "control": "the control points",
    "imu": "the IMU (its accelerometer)",
    "velocity": "the vehicle's own velocity",
    "barometer": "the barometer",
    "assumed": "assumed values, which no instrument measured",
}
"""Name of a share in `backend.bundle.accuracy.information_shares` -> in words."""
_CARRIER_PHASE_M = 0.1
"""Receivers that state less have corrections of the carrier phase (RTK, PPK), and errors of centimetres.
Without it, corrections leave half a metre at least (Groves, Principles of GNSS, 2013, chapter 10)."""
_LENGTHS = ("scale",)
_STEPS: Mapping[str, str] = {
    "pictures": "fly lower, with more overlap, or with a sharper camera",
    "flat_floor": "fly higher above the uneven ground, or map it in parts",
    "attitude": "calibrate its level, or fly the same rows in both directions",
    "control": "mark more control points, spread to the corners of the ground",
    "imu": "calibrate the gain of the accelerometer (at rest on each of its six sides), or measure one "
    "distance on the ground and compare it with map.html",
    "velocity": "avoid stretches of floor without texture, or record the IMU",
    "barometer": "climb and descend more, or add a height sensor or GPS",
    "assumed": "record the instrument that measures them, or state them with their accuracy in sensor.yaml",
}


def limit(
    shares: Mapping[str, Mapping[str, float]], axes: Sequence[str] = ("x", "y")
) -> tuple[str, float] | None:
    """Return the instrument with the largest share in the variance, and that share.

    It is that of the place of the farthest keyframe, or for the axes ``("scale",)`` that of the lengths. None
    where no shares are known.
    """
    rows = [shares[axis] for axis in axes if axis in shares]
    if not rows:
        return None
    mean = {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
    name = max(mean, key=mean.__getitem__)
    return name, mean[name]


def limit_sentence(shares: Mapping[str, Mapping[str, float]], metric: bool = True) -> str:
    """Return what limits the accuracy of places and lengths of a map, in one sentence; empty where it is not
    known.

    Without metres nothing is said of lengths.
    """
    found, of_lengths = limit(shares), limit(shares, _LENGTHS) if metric else None
    if found is None:
        return ""
    name, share = found
    left = f"{percent(share)} of the uncertainty that is left"
    if of_lengths is None or of_lengths[0] == name:
        return f"What limits this: {in_words(name)}, the cause of {left}."
    lengths = f"{in_words(of_lengths[0])}, the cause of {percent(of_lengths[1])} of theirs"
    return (
        f"What limits this: for the place of a camera {in_words(name)}, the cause of {left}; for lengths "
        f"{lengths}."
    )


def in_words(name: str) -> str:
    """Return an instrument's name for a reader."""
    return WORDS.get(name, name.replace("_", " "))


def next_steps(
    estimate: Estimate,
    facts: Facts,
    summary: Summary,
    ground_missing: bool,
    mosaic: MosaicFacts | None = None,
) -> str:
    """Return what makes the next map better, the most important first.

    What the status names comes before what limits a map whose status is ok. On a mosaic whose ground is less
    accurate than the cameras above it, lengths are the limit, and not the places of the cameras.
    """
    steps = []
    if summary.status != "ok":
        steps.append("first do what “Check this first” says: it is worth more than all that follows")
    elif count := len(by_kind(summary.warnings).warnings):
        steps.append(
            "first do what the warning below advises"
            if count == 1
            else f"first do what the {count} warnings below advise"
        )
    if not facts.loops_kept and not facts.is_graph:
        why = "errors do not add up" if facts.relative_to else "the map does not rest on positions alone"
        steps.append(f"cross or repeat an earlier part of the path, so that {why}")
    if not facts.metric:
        steps.append("record a height sensor or GPS, which give lengths in metres")
    of_lengths = _limited_by_lengths(facts, mosaic)
    found = limit(estimate.information_shares, _LENGTHS if of_lengths else ("x", "y"))
    if found is not None and (step := _step(found[0], facts, estimate, of_lengths)):
        steps.append(f"to be more accurate than now, {step}")
    if ground_missing:
        steps.append("cross the missing ground higher, with more light, or with marks on it")
    return " ".join(f"{step[0].upper()}{step[1:]}." for step in steps)


def _limited_by_lengths(facts: Facts, mosaic: MosaicFacts | None) -> bool:
    return facts.metric and mosaic is not None and mosaic.typical_std_m > facts.sigma_median_m


def _step(name: str, facts: Facts, estimate: Estimate, of_lengths: bool) -> str:
    """Return what improves the instrument that limits a map, by what is at hand."""
    if name == "pictures" and of_lengths and estimate.instruments.lens:
        return (
            "calibrate the camera, or fly part of the ground at another height: the pictures themselves tell "
            "the camera's focal length, and lengths depend on it"
        )
    if name == "position":
        return _better_positions(facts)
    if name == "range":
        return _better_ranges(facts)
    return _STEPS.get(name, "")


def _better_positions(facts: Facts) -> str:
    more = "mark more control points" if facts.controlled else "measure control points on the ground"
    if facts.gps_std_m < _CARRIER_PHASE_M:
        return f"{more}: the GPS already has corrections (RTK), and no receiver is much better"
    return f"use a GPS with corrections (RTK), or {more} and mark them in the pictures"


def _better_ranges(facts: Facts) -> str:
    measured = "measure one distance on the ground and compare it with map.html"
    if facts.range_exact:
        return (
            "fly longer over the same ground, so that the scatter of the height sensor's readings averages "
            f"out; and {measured}, because its gain and zero are taken as exact"
        )
    return (
        f"{measured}; or hold the drone at two heights measured by tape, and state gain and zero of the "
        "height sensor in sensor.yaml"
    )
