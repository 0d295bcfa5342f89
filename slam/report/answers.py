"""Answers to the questions that a pilot asks of a map, each in some sentences of the report's first table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.lost_pictures import NOTABLE_SHARE, REDUNDANT, SHOW_NOTHING, TRACKING_LOST
from slam.core.messages import by_kind, reasons_of
from slam.core.units import SPACE, unit
from slam.report.accuracy_answers import (
    distance,
    heights,
    is_tilt_doubted,
    least_certain,
    loops,
    not_as_it_is,
    place,
    scale,
)
from slam.report.advice import limit_sentence, next_steps
from slam.report.facts import Facts
from slam.report.left_out import counted, left_out
from slam.report.mosaic_facts import MosaicFacts
from slam.report.page import Item

if TYPE_CHECKING:
    from slam.core.summary import Summary

_MOST_GAPS = 3
"""Stretches without pictures that are named."""


def pilots_answers(
    estimate: Estimate,
    summary: Summary,
    facts: Facts,
    mosaic: MosaicFacts | None = None,
) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a flight.

    ``mosaic``: figures of the mosaic, where there is one.
    """
    rows = [
        Item("Can I use this map?", _usable(estimate, facts, summary)),
        Item("What does the status promise, and what not?", _promise(estimate, summary, facts)),
        Item("How accurate is a place on it?", place(facts, summary, mosaic)),
        Item("How far can I trust a distance or an area?", distance(estimate, facts, mosaic)),
        Item("Where is it least certain?", least_certain(estimate, facts, mosaic)),
        Item("Is the scale right, and by which instrument?", scale(estimate, facts, summary)),
        Item("What limits the accuracy?", _limit(estimate, facts)),
        Item("How do I make the next map better?", _next(estimate, facts, summary, mosaic)),
        Item("What failed?", _failed(estimate, facts, summary)),
        Item("Is any of the ground missing?", _missing(estimate, facts, summary)),
        Item("Was a place recognised again, and is that right?", loops(estimate, facts)),
        Item("What was left out, and do I have to act?", _left_out(facts, summary)),
        Item("What on the mosaic may not be as it is on the ground?", not_as_it_is(estimate, mosaic)),
        Item("Are the heights true?", "" if facts.is_graph else heights(estimate, facts, summary)),
        Item("Where is the mosaic, and how big is a pixel?", _whereabouts(facts, mosaic)),
        Item("Which way do x and y point, and where is north?", _axes(estimate, facts)),
        Item("Where on Earth is it?", "" if facts.is_graph else _on_earth(estimate)),
        Item("Can I hand its coordinates to others?", "" if facts.is_graph else _hand_on(facts, mosaic)),
    ]
    return tuple(row for row in rows if row.value)


def _usable(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    found = by_kind(summary.warnings)
    named = reasons_of(summary.status, summary.warnings)
    others = sum(line not in named for line in found.warnings)
    more = _counted(
        others, "warning", "warnings", "to act on stands under Warnings", "to act on stand under Warnings"
    )
    notes = _counted(len(found.notes), "note", "notes", "needs no action", "need no action")
    told = "".join(f" {text}." for text in (more, notes) if text)
    if summary.status == "ok":
        alone = "; but no second instrument checks its accuracy (“Is the scale right?” below)"
        doubt = alone if estimate.accuracy_basis else ""
        return (
            f"Yes, {_purpose(estimate, facts, summary)}{doubt}. The measurements that the map uses agree "
            f"within the accuracy below.{told}"
        )
    return f"Only with care: “Check this first” above names what is wrong and what to do about it.{told}"


def _purpose(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    """Return what a map whose status is ok is good for, and what not."""
    if facts.is_graph:
        return "for the places of its poses"
    if not facts.metric:
        return "to find things and to compare lengths with each other; not in metres"
    good = "to find things, and to measure distances and areas"
    if is_tilt_doubted(summary):
        return f"{good}; not for heights, which a warning doubts"
    if estimate.ground is not None and estimate.ground.is_measured:
        good = "to find things, and to measure distances, areas and heights"
    return good if facts.relative_to else f"{good}; as coordinates on Earth only as the GPS has it"


def _counted(count: int, one: str, many: str, after_one: str, after_many: str) -> str:
    return (
        ""
        if count == 0
        else f"{count} {one if count == 1 else many} {after_one if count == 1 else after_many}"
    )


def _promise(estimate: Estimate, summary: Summary, facts: Facts) -> str:
    if facts.is_graph:
        return ""
    alone = f" It cannot see an error of an instrument that nothing checks: {estimate.accuracy_basis}"
    unseen = (
        alone
        if estimate.accuracy_basis
        else " It cannot see an error that all instruments share; one distance measured on the ground would."
    )
    warned = by_kind(summary.warnings).warnings
    doubted = " What a warning on this page names is excepted." if warned else ""
    if summary.status == "ok":
        return (
            "“ok” promises that the map hangs together, that pictures and instruments agree with each "
            f"other within the accuracy stated here, and that this accuracy holds.{doubted}{unseen}"
        )
    return (
        "It names every cause that was found by which the map may be wrong by more than the accuracy "
        "stated here. That accuracy may be too good for this reason. All else was compared and "
        f"agrees.{unseen}"
    )


def _whereabouts(facts: Facts, mosaic: MosaicFacts | None) -> str:
    if mosaic is None:
        return ""
    size = f"{mosaic.width} x {mosaic.height} pixels of {facts.length(mosaic.pixel_m)}"
    return (
        f"In mosaic.tif beside this page, {size} on the ground; mosaic.png is the same as a picture. "
        f"Coordinate system of mosaic.tif and elevation.tif: {facts.plane}."
    )


def _limit(estimate: Estimate, facts: Facts) -> str:
    told = limit_sentence(estimate.information_shares, facts.metric).removeprefix("What limits this: ")
    if not told:
        return ""
    return f"{told[0].upper()}{told[1:]} The table of instruments below has all shares."


def _next(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    missing = any(gap.shows_nothing for gap in facts.gaps) or bool(_bare(facts, summary))
    return next_steps(estimate, facts, summary, missing, mosaic)


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
        where = " where the path is dotted" if facts.gaps else ""
        whole = "; the map is in one piece all the same" if facts.maps == 1 else ""
        told.append(
            f"{times} a picture had nothing in common with the one before, and tracking began anew{where}"
            f"{whole}"
        )
    if number := sum(why != REDUNDANT for why in estimate.not_drawn.values()):
        are = "keyframe is" if number == 1 else "keyframes are"
        told.append(f"{number} {are} not in the mosaic (summary.json says why)")
    if told:
        return f"{told[0][0].upper()}{'; '.join(told)[1:]}."
    on_purpose = " What was left out (below) was left out on purpose." if summary.rejected else ""
    warned = by_kind(summary.warnings).warnings
    return f"Nothing{'; the warnings name what to check' if warned else ''}.{on_purpose}"


def _left_out(facts: Facts, summary: Summary) -> str:
    rows = left_out(summary.rejected)
    if not rows:
        return "Nothing."
    act = [row for row in rows if not row.no_need_to_act]
    parts = counted(rows, facts.is_graph)
    if not act:
        return f"{parts}. No need to act on these: the map does not rest on them. The table has the reasons."
    first = act[0]
    told = f"“{first.what}” ({first.count}): {first.act[0].lower()}{first.act[1:]}"
    if not first.only_if:
        return f"{parts}. The map does not rest on them. Act on {told} The table below has the others."
    return (
        f"{parts}. The map does not rest on them. Whether to act depends on the case: {told} The table below "
        "has the others."
    )


def _axes(estimate: Estimate, facts: Facts) -> str:
    unknown = "" if estimate.origin is not None or facts.is_graph else " Where north is, is not known."
    return f"{facts.axes}{unknown}"


def _hand_on(facts: Facts, mosaic: MosaicFacts | None) -> str:
    """Return who can use coordinates of this map, and what has to be told with them."""
    if not facts.metric:
        return "No: they are not in metres. Hand on the mosaic as a picture."
    if facts.relative_to:
        return (
            "Only together with this map: its origin and axes mean nothing elsewhere. Distances and areas "
            "can be handed on, with their uncertainty. With GPS or control points the map would lie on Earth."
        )
    known = mosaic is not None and np.isfinite(mosaic.typical_std_m)
    std_m = mosaic.typical_std_m if mosaic is not None and known else facts.sigma_median_m
    told = [f"the coordinate system (above), the accuracy (typically ±{SPACE}{facts.length(std_m)})"]
    if not facts.controlled:
        told.append("and that the place on Earth is that of the GPS")
    stated = (
        f" Its fixes are stated or assumed to be good to ±{SPACE}{facts.length(facts.gps_std_m)} east "
        "and north each; an error that all of them share moves the whole map."
        if np.isfinite(facts.gps_std_m) and not facts.controlled
        else ""
    )
    return f"Yes, if you tell with them {', '.join(told)}.{stated}"


def _on_earth(estimate: Estimate) -> str:
    origin = estimate.origin
    if origin is None:
        return "Not known: no GPS was used."
    return f"Its origin is at {origin.text} (WGS 84)."
