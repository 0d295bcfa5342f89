"""Answers to the questions that a pilot asks of a map, each in one sentence of the report's first table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.lost_pictures import NOTABLE_SHARE, SHOW_NOTHING
from slam.core.units import SPACE, length, percent
from slam.report.facts import Facts
from slam.report.page import Item

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slam.core.summary import Summary

_INSTRUMENTS = {
    "range": (
        "the height sensor",
        "measure one distance on the ground and compare it with map.html; hold the drone at two heights "
        "measured by tape, and state gain and zero of the height sensor in sensor.yaml",
    ),
    "pictures": ("the pictures themselves", "fly lower, with more overlap, or with a sharper camera"),
    "flat_floor": ("how flat the ground is", "fly higher above the uneven ground, or map it in parts"),
    "attitude": ("the attitude sensor", "calibrate its level, or fly the same rows in both directions"),
    "position": ("the GPS", "use a receiver with corrections (RTK), or measure ground points"),
    "control": ("the control points", "mark more of them, spread to the corners of the ground"),
    "imu": ("the IMU", "calibrate the IMU at rest before the flight"),
    "velocity": ("the vehicle's own velocity", "avoid stretches of floor without texture, or record the IMU"),
    "barometer": ("the barometer", "climb and descend more, or add a height sensor or GPS"),
    "assumed": (
        "assumed values, which no instrument measured",
        "state them in sensor.yaml with their uncertainty",
    ),
}
"""Name of a share in `backend.bundle.information_shares` -> in words, and what improves it."""
_EXAMPLE_M = 10.0
"""Length of the example; a map smaller than this takes its own size."""


def limit(shares: Mapping[str, Mapping[str, float]]) -> tuple[str, float] | None:
    """Return the instrument with the largest share in the variance of the place of the farthest keyframe.

    None where no shares are known.
    """
    rows = [shares[axis] for axis in ("x", "y") if axis in shares]
    if not rows:
        return None
    mean = {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
    name = max(mean, key=mean.__getitem__)
    return name, mean[name]


def limit_sentence(shares: Mapping[str, Mapping[str, float]]) -> str:
    """Return what limits the accuracy of a map, in one sentence; empty where it is not known."""
    found = limit(shares)
    if found is None:
        return ""
    name, share = found
    return f"What limits this: {_words(name)[0]} ({percent(share)} of the variance)."


def pilots_answers(estimate: Estimate, summary: Summary, facts: Facts) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a flight."""
    rows = [
        Item("Can I use this map?", _usable(estimate, summary)),
        Item("How accurate is a place on it?", _place(facts)),
        Item("How accurate is a distance on it?", _distance(facts)),
        Item("What limits the accuracy?", _limit(estimate, facts)),
        Item("How do I make the next map better?", _next_step(estimate, facts)),
        Item("Is everything on it?", _complete(facts, summary)),
        Item("Was a place recognised again?", _loops(facts)),
        Item("What was left out?", _left_out(facts, summary)),
        Item("Where on Earth is it?", _on_earth(estimate)),
        Item("Where do I look next?", _files(facts)),
    ]
    return tuple(row for row in rows if row.value)


def _words(name: str) -> tuple[str, str]:
    return _INSTRUMENTS.get(name, (name.replace("_", " "), ""))


def _usable(estimate: Estimate, summary: Summary) -> str:
    if summary.status == "ok":
        notes = len(summary.warnings)
        more = f" Read the {notes} note{'s' * (notes > 1)} under Warnings." if notes else ""
        assumed = " But no second instrument checks this accuracy: see “What limits the accuracy?”."
        alone = assumed if estimate.accuracy_basis else ""
        return f"Yes: all measurements agree with each other, within the accuracy below.{alone}{more}"
    return "Only with care: the status above names what is wrong and what to do first."


def _place(facts: Facts) -> str:
    if not np.isfinite(facts.sigma_median_m):
        return "Not known: no uncertainty could be computed for most of it."
    relative = f" relative to {facts.relative_to}" if facts.relative_to else ""
    return (
        f"A keyframe (a picture that the map is made of) is typically known to "
        f"±{SPACE}{facts.length(facts.sigma_median_m)}{relative}: one standard deviation. Two times out of "
        "three the error is smaller on each axis, and hardly ever it is three times as large."
    )


def _distance(facts: Facts) -> str:
    if not facts.metric:
        return "In metres not at all: no sensor measured a length. Ratios of distances are right."
    if not np.isfinite(facts.sigma_median_m):
        return "Not known."
    apart_m = min(_EXAMPLE_M, max(facts.extent_m))
    if not facts.scale_std or not np.isfinite(apart_m):
        return f"About ±{SPACE}{facts.length(np.sqrt(2) * facts.sigma_median_m)} between two far places."
    std_m = facts.scale_std * apart_m
    return (
        f"The scale of all lengths makes ±{SPACE}{length(std_m)} of {facts.length(apart_m)} "
        f"({percent(facts.scale_std)}); the errors of both ends come on top. map.html measures any distance "
        "with all of it."
    )


def _limit(estimate: Estimate, facts: Facts) -> str:
    found = limit(estimate.information_shares)
    if found is None:
        return estimate.accuracy_basis
    name, share = found
    basis = f" {estimate.accuracy_basis}" if estimate.accuracy_basis else ""
    return f"Mostly {_words(name)[0]}: {percent(share)} of the variance of the farthest place.{basis}"


def _next_step(estimate: Estimate, facts: Facts) -> str:
    steps = []
    if not facts.loops_kept and not facts.is_graph:
        steps.append("cross or repeat an earlier part of the path, so that errors do not add up")
    if not facts.metric:
        steps.append("record a height sensor or GPS, which give lengths in metres")
    found = limit(estimate.information_shares)
    if found is not None and _words(found[0])[1]:
        steps.append(_words(found[0])[1])
    text = "; ".join(steps)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _complete(facts: Facts, summary: Summary) -> str:
    thing = "poses" if facts.is_graph else "keyframes"
    bare = sum(summary.rejected.get(reason, 0) for reason in SHOW_NOTHING)
    if bare > NOTABLE_SHARE * facts.frames and facts.maps <= 1:
        return (
            f"No: {bare} of {facts.frames} pictures show too little. Ground that only they saw is missing; "
            f"the warnings say which. {facts.placed} of {facts.keyframes} {thing} lie on one map."
        )
    if facts.placed == facts.keyframes and facts.maps <= 1:
        return f"Yes: all {facts.keyframes} {thing} lie on one map."
    parts = f", in {facts.maps} separate maps" if facts.maps > 1 else ""
    return f"No: {facts.placed} of {facts.keyframes} {thing} have a place{parts}. The warnings name the rest."


def _loops(facts: Facts) -> str:
    if facts.loops_kept:
        return f"Yes, {facts.loops_kept} times, so errors do not add up over the flight. {_rejected(facts)}"
    return f"No, so errors add up along the path. {_rejected(facts)}"


def _rejected(facts: Facts) -> str:
    if not facts.loops_rejected:
        return "No match was rejected."
    return f"{facts.loops_rejected} other matches were rejected, each with its reason below."


def _left_out(facts: Facts, summary: Summary) -> str:
    if not summary.rejected:
        return "Nothing."
    kinds = {
        "matches of places": "loop: ",
        "single views of floor points": "view of ",
        "pictures or links": "",
    }
    count, most = dict.fromkeys(kinds, 0), dict.fromkeys(kinds, ("", 0))
    for reason, number in summary.rejected.items():
        kind = next(kind for kind, prefix in kinds.items() if reason.startswith(prefix))
        count[kind] += number
        most[kind] = max(most[kind], (reason.removeprefix(kinds[kind]), number), key=lambda each: each[1])
    parts = [f"{count[kind]} {kind} (most often “{most[kind][0]}”)" for kind in kinds if count[kind]]
    return f"{', '.join(parts)}. The table Rejected data below lists all; the map does not rest on them."


def _on_earth(estimate: Estimate) -> str:
    origin = estimate.origin
    if origin is None:
        return "Not known: no GPS was used. The map starts at the first keyframe, along its heading."
    return f"At {origin.latitude_deg:.6f}°, {origin.longitude_deg:.6f}°; x points east and y north."


def _files(facts: Facts) -> str:
    if facts.is_graph:
        return "trajectory.tum holds the poses, loops.csv each link with its verdict."
    return (
        "map.html shows the map with each link and its uncertainty; mosaic.tif is for GIS programs, and "
        "mosaic_quality.tif says how reliable each piece is."
    )
