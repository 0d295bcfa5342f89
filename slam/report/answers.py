"""Answers to the questions that a pilot asks of a map, each in one sentence of the report's first table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.lost_pictures import NOTABLE_SHARE, REDUNDANT, SHOW_NOTHING, TRACKING_LOST
from slam.core.units import SPACE, length, percent, unit
from slam.report.facts import Facts
from slam.report.left_out import left_out
from slam.report.page import Item

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slam.core.summary import Summary
    from slam.report.rasters.quality import UncertainGround

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
_STREAMS = {"height sensor": "sonar0", "accelerometer": "imu0", "GPS": "gps0"}
"""Instrument that tells the scale -> name of its stream in warnings."""
_IF_WRONG = "Lengths that it tells 1 % too long make the map 1 % too large."
_MOST_GAPS = 3
"""Stretches without pictures that are named."""
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
    return f"What limits this: {_words(name)[0]}, the cause of {percent(share)} of the squared error."


def pilots_answers(
    estimate: Estimate,
    summary: Summary,
    facts: Facts,
    against_truth: str = "",
    ground: UncertainGround | None = None,
) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a flight.

    ``against_truth``: the comparison with the truth in one sentence, where there is a truth. ``ground``: the
    least certain ground, where there is a mosaic.
    """
    rows = [
        Item("Can I use this map?", _usable(estimate, summary)),
        Item("How accurate is a place on it?", _place(facts, summary)),
        Item("Where is it least certain?", _least_certain(estimate, facts, ground)),
        Item("How far is it from the truth?", against_truth),
        Item("How far can I trust a distance or an area?", _distance(estimate, facts)),
        Item("Is the scale right, and by which instrument?", _scale(estimate, facts, summary)),
        Item("What limits the accuracy?", _limit(estimate)),
        Item("How do I make the next map better?", _next_step(estimate, facts, summary)),
        Item("Is any of the ground missing?", _missing(estimate, facts, summary)),
        Item("What failed?", _failed(estimate, facts, summary)),
        Item("What was left out, and do I have to act?", _left_out(facts, summary)),
        Item("Was a place recognised again?", _loops(facts)),
        Item("Which way do x and y point, and where is north?", _axes(estimate, facts)),
        Item("Where on Earth is it?", "" if facts.is_graph else _on_earth(estimate)),
    ]
    return tuple(row for row in rows if row.value)


def _words(name: str) -> tuple[str, str]:
    return _INSTRUMENTS.get(name, (name.replace("_", " "), ""))


def _usable(estimate: Estimate, summary: Summary) -> str:
    if summary.status == "ok":
        notes = len(summary.warnings)
        more = f" Read the {notes} note{'s' * (notes > 1)} under Warnings." if notes else ""
        assumed = " But no second instrument checks this accuracy: see “Is the scale right?” below."
        alone = assumed if estimate.accuracy_basis else ""
        return f"Yes: the measurements that the map uses agree within the accuracy below.{alone}{more}"
    return "Only with care: “Check this first” above names what is wrong and what to do about it."


def _place(facts: Facts, summary: Summary) -> str:
    if not np.isfinite(facts.sigma_median_m):
        return "Not known: no uncertainty could be computed for most of it."
    relative = f" relative to {facts.relative_to}" if facts.relative_to else " on Earth"
    return (
        f"{'A pose' if facts.is_graph else 'A keyframe (a picture that the map is made of)'} is "
        "typically known to "
        f"±{SPACE}{facts.length(facts.sigma_median_m)}{relative}: one standard deviation. Two times out of "
        "three the error is smaller on each axis; an error three times as large is rare."
        + (" It does not count what “Check this first” above names." if summary.status != "ok" else "")
    )


def _least_certain(estimate: Estimate, facts: Facts, ground: UncertainGround | None) -> str:
    k = facts.least_certain
    if k is None:
        return ""
    x, y, _ = estimate.w_T_b[k, :3, 3].tolist()
    m = unit(facts.metric)
    what = "pose" if facts.is_graph else "keyframe"
    name = estimate.frame_names[k] if k < len(estimate.frame_names) and not facts.is_graph else ""
    path = f"Around x = {x:.3g} {m}, y = {y:.3g} {m} ({what} {k}{f', {name}' * bool(name)})"
    path += f", where a position is known to ±{SPACE}{facts.length(facts.sigma_max_m)}."
    if ground is None:
        return f"{path} map.html colours the path by it."
    return (
        f"The ground around x = {ground.x_m:.3g} {m}, y = {ground.y_m:.3g} {m}, known to "
        f"±{SPACE}{facts.length(ground.std_m)}: the darkest of the middle map below. The path: "
        f"{path[0].lower()}{path[1:]}"
    )


def _distance(estimate: Estimate, facts: Facts) -> str:
    if not facts.metric:
        return "In metres not at all: no sensor measured a length. Ratios of distances are right."
    if not np.isfinite(facts.sigma_median_m):
        return "Not known."
    apart_m = min(_EXAMPLE_M, max(facts.extent_m))
    ends = f"±{SPACE}{facts.length(np.sqrt(2) * facts.sigma_median_m)}"
    if not facts.scale_std or not apart_m > 0:
        return f"A distance between two far places to about {ends}, one between near places better."
    by_scale = f"±{SPACE}{length(facts.scale_std * apart_m)} ({percent(facts.scale_std)})"
    return (
        f"A distance of {facts.length(apart_m)} is right to {by_scale} by the scale, and an area to twice "
        f"that share ({percent(2 * facts.scale_std)}), one standard deviation. The same share holds for any "
        f"other length. {_of_ends(estimate, ends)} map.html measures any distance and area with all of it."
    )


def _of_ends(estimate: Estimate, ends: str) -> str:
    """Return what the ends of a distance add: errors of a receiver move the whole map and cancel."""
    found = limit(estimate.information_shares)
    if found is not None and found[0] == "position":
        return "The uncertainty of a place on Earth adds little to it: most of that moves the whole map."
    return (
        f"The errors of both ends come on top, together typically less than {ends}: the whole is the root of "
        "the sum of both squares."
    )


def _scale(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    if facts.is_graph:
        return "As right as the edges of the graph, which give it."
    if not facts.metric:
        return "Not known: no instrument measured a length. Record a height sensor or GPS."
    known = f"to ±{SPACE}{percent(facts.scale_std)}" if facts.scale_std else "with an unknown uncertainty"
    if estimate.accuracy_basis:
        return (
            f"{known[0].upper()}{known[1:]}, if the {facts.scale_source} is right. {_IF_WRONG}"
            f" {estimate.accuracy_basis}"
        )
    if summary.status != "ok":
        return f"By {facts.scale_source}, {known}; but read “Check this first” above."
    if " and " not in facts.scale_source:
        return f"{known[0].upper()}{known[1:]}, if the {facts.scale_source} is right. {_IF_WRONG}"
    doubted = [
        stream
        for name, stream in _STREAMS.items()
        if name in facts.scale_source and any(line.startswith(f"{stream}: ") for line in summary.warnings)
    ]
    if doubted:
        return (
            f"{known[0].upper()}{known[1:]}, by {facts.scale_source} together. But a warning below names "
            f"{' and '.join(doubted)}: measure one distance on the ground to be sure."
        )
    return f"Yes, {known}: {facts.scale_source} tell it, and they agree."


def _limit(estimate: Estimate) -> str:
    found = limit(estimate.information_shares)
    if found is None:
        return ""
    name, share = found
    return (
        f"Mostly {_words(name)[0]}: the cause of {percent(share)} of the squared error at the farthest place."
    )


def _next_step(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    steps = []
    if not facts.loops_kept and not facts.is_graph:
        steps.append("cross or repeat an earlier part of the path, so that errors do not add up")
    if not facts.metric:
        steps.append("record a height sensor or GPS, which give lengths in metres")
    found = limit(estimate.information_shares)
    if found is not None and _words(found[0])[1]:
        steps.append(_words(found[0])[1])
    if any(gap.shows_nothing for gap in facts.gaps) or _bare(facts, summary):
        steps.append("cross the missing ground higher, with more light, or with marks on it")
    text = "; ".join(steps)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _bare(facts: Facts, summary: Summary) -> int:
    """Return the number of pictures that show nothing, if they are worth telling."""
    bare = sum(summary.rejected.get(reason, 0) for reason in SHOW_NOTHING)
    return bare if bare > NOTABLE_SHARE * facts.frames else 0


def _missing(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    thing = "poses" if facts.is_graph else "keyframes"
    told = []
    long = [gap for gap in facts.gaps if gap.shows_nothing]
    for gap in long[:_MOST_GAPS]:
        (x0, y0), (x1, y1) = (estimate.w_T_b[k, :2, 3].tolist() for k in (gap.i, gap.j))
        told.append(f"{facts.length(gap.length_m)} from ({x0:.3g}, {y0:.3g}) to ({x1:.3g}, {y1:.3g})")
    if told:
        more = f", and {len(long) - len(told)} more" if len(long) > len(told) else ""
        told = [
            f"no usable picture was taken along {' and '.join(told)}{more} of the path (x, y in "
            f"{unit(facts.metric)}; dotted in the picture of the path); the pictures at both ends still show "
            "some of the ground between"
        ]
    if bare := _bare(facts, summary):
        told.append(f"{bare} of {facts.frames} pictures show too little, and the warnings say when")
    if facts.placed < facts.keyframes or facts.maps > 1:
        parts = f", in {facts.maps} separate maps" if facts.maps > 1 else ""
        rest = "; the warnings name the rest" if facts.placed < facts.keyframes else ""
        told.append(f"{facts.placed} of {facts.keyframes} {thing} have a place{parts}{rest}")
    if told:
        return f"Yes: {'; '.join(told)}."
    if facts.is_graph:
        return f"No: all {facts.keyframes} poses lie on one map."
    stretch = (
        "the stretches without usable pictures (dotted in the picture of the path) are shorter than a picture"
        if facts.gaps
        else "no stretch of the path is without pictures"
    )
    return f"No: all {facts.keyframes} {thing} lie on one map, and {stretch}."


def _failed(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    told = []
    if summary.status != "ok":
        told.append("what “Check this first” above names")
    if unplaced := facts.keyframes - facts.placed:
        told.append(f"{unplaced} {'poses' if facts.is_graph else 'keyframes'} could not be placed")
    if lost := summary.rejected.get(TRACKING_LOST, 0):
        times = "once" if lost == 1 else f"{lost} times"
        told.append(f"{times} a picture had nothing in common with the one before, and tracking began anew")
    if number := sum(why != REDUNDANT for why in estimate.not_drawn.values()):
        are = "keyframe is" if number == 1 else "keyframes are"
        told.append(f"{number} {are} not in the mosaic (summary.json says why)")
    if told:
        return f"{told[0][0].upper()}{'; '.join(told)[1:]}."
    return "Nothing." if not summary.warnings else "Nothing; the warnings name what to check."


def _loops(facts: Facts) -> str:
    if facts.loops_kept:
        return f"Yes, {facts.loops_kept} times, so errors do not add up over the flight. {_rejected(facts)}"
    return f"No, so errors add up along the path. {_rejected(facts)}"


def _rejected(facts: Facts) -> str:
    if not facts.loops_rejected:
        return "No match was rejected."
    return f"{facts.loops_rejected} other matches were rejected, each with its reason below."


def _left_out(facts: Facts, summary: Summary) -> str:
    rows = left_out(summary.rejected)
    if not rows:
        return "Nothing."
    act = [row for row in rows if not row.no_need_to_act]
    words = {
        "match": "matches of places",
        "view": "single views of floor points",
        "link": "edges" if facts.is_graph else "pictures or links",
    }
    counts = {kind: sum(row.count for row in rows if row.kind == kind) for kind in words}
    parts = ", ".join(f"{count} {words[kind]}" for kind, count in counts.items() if count)
    if not act:
        return f"{parts}. No need to act on these: the map does not rest on them. The table has the reasons."
    first = f"“{act[0].reason}” ({act[0].count}): {act[0].act[0].lower()}{act[0].act[1:]}"
    return f"{parts}. The map does not rest on them. Act on {first} The table below has the others."


def _axes(estimate: Estimate, facts: Facts) -> str:
    unknown = "" if estimate.origin is not None or facts.is_graph else " Where north is, is not known."
    return f"{facts.axes}{unknown}"


def _on_earth(estimate: Estimate) -> str:
    origin = estimate.origin
    if origin is None:
        return "Not known: no GPS was used."
    return f"Its origin is at {origin.latitude_deg:.6f}°, {origin.longitude_deg:.6f}°."
