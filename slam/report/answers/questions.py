"""Answers to the questions that a pilot asks of a map, each in some sentences of the report's first table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted
from slam.core.estimate import Estimate
from slam.core.messages import by_kind
from slam.core.units import SPACE, percent
from slam.report.answers.accuracy import (
    least_certain,
    not_as_it_is,
    place,
    scale,
)
from slam.report.answers.advice import WORDS, further_limits, limit, limit_sentence, next_steps
from slam.report.answers.checked_lengths import RESULT, basis, unless_checked
from slam.report.answers.distances import distance
from slam.report.answers.failures import failed, missing
from slam.report.answers.heights import heights, only_near, typical_height_std, without_heights
from slam.report.answers.left_out import LeftOut, counted_by_kind
from slam.report.answers.left_out_here import ground_is_missing, left_out_here
from slam.report.answers.loops import another_arrangement, gain_of_loops, loops
from slam.report.answers.streams import doubts, is_tilt_doubted
from slam.report.facts import Facts
from slam.report.mosaic_facts import MosaicFacts
from slam.report.page import Item

PLACE = "How accurate is a place on it?"
"""The question whose answer the comparison with the truth follows."""

if TYPE_CHECKING:
    from slam.core.summary import Summary


def pilots_answers(
    estimate: Estimate,
    summary: Summary,
    facts: Facts,
    mosaic: MosaicFacts | None = None,
    left_out: Sequence[LeftOut] | None = None,
) -> tuple[Item, ...]:
    """Return questions and answers; only those that apply to a flight.

    ``mosaic``: figures of the mosaic, where there is one. ``left_out``: rows of the table of what the
    map was made without; None: those that the summary counts.
    """
    rows_left_out = left_out_here(estimate, facts, summary) if left_out is None else left_out
    rows = [
        Item("Can I use this map?", _usable(estimate, facts, summary)),
        Item("What does the status promise, and what not?", _promise(estimate, summary, facts)),
        Item(PLACE, place(estimate, facts, summary, mosaic)),
        Item("How far can I trust a distance or an area?", distance(estimate, facts, summary, mosaic)),
        Item("Where is it least certain?", least_certain(estimate, facts, mosaic)),
        Item("Is the scale right, and by which instrument?", scale(estimate, facts, summary)),
        Item("What limits the accuracy?", _limit(estimate, facts, mosaic)),
        Item("How do I make the next map better?", _next(estimate, facts, summary, mosaic)),
        Item("What failed?", failed(estimate, facts, summary, mosaic)),
        Item("Is any of the ground missing?", missing(estimate, facts, summary, mosaic)),
        Item("Was a place recognised again, and is that right?", loops(estimate, facts)),
        Item("Could the pictures fit together in another way?", another_arrangement(estimate, facts)),
        Item("What did loop closures change?", gain_of_loops(facts)),
        Item(
            "What was left out, and do I have to act?",
            _left_out(facts, rows_left_out),
        ),
        Item("What on the mosaic may not be as it is on the ground?", not_as_it_is(estimate, mosaic)),
        Item("Are the heights true?", *(("",) if facts.is_graph else heights(estimate, facts, summary))),
        Item("Where is the mosaic, and how big is a pixel?", _whereabouts(facts, mosaic)),
        Item("Which way do x and y point, and where is north?", _axes(estimate, facts)),
        Item("Where on Earth is it?", "" if facts.is_graph else _on_earth(estimate)),
        Item(
            "Can I hand its coordinates to others?",
            "" if facts.is_graph else _hand_on(estimate, facts, summary, mosaic),
        ),
    ]
    return tuple(row for row in rows if row.value)


def _usable(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    found = by_kind(summary.messages)
    more = _count_of(len(found.others), "warning stands", "warnings stand", "under Warnings, with what to do")
    notes = _count_of(len(found.notes), "note needs", "notes need", "no action")
    words = "".join(f" {text}." for text in (more, notes) if text)
    if summary.status == "ok":
        alone = unless_checked(
            "; but no second instrument checks its accuracy (“Is the scale right?” below)",
            f"; its lengths were compared with known distances on the ground ({RESULT})",
        )
        doubt = alone if estimate.accuracy_basis else ""
        excepted = ", except for what a warning doubts" if doubts(summary.messages) else ""
        return (
            f"Yes, {_purpose(estimate, facts, summary)}{doubt}. The measurements that the map uses agree "
            f"within the accuracy below{excepted}.{words}"
        )
    return f"Only with care: “Check this first” above names what is wrong and what to do about it.{words}"


def _purpose(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    """Return what a map whose status is ok is good for, and what not."""
    if facts.is_graph:
        return "for the places of its poses"
    if not facts.metric:
        return "to find things and to compare lengths with each other; not in metres"
    good, ground = "to find things, and to measure distances and areas", estimate.ground
    flat = "not for heights of the ground, which was taken as flat"
    if is_tilt_doubted(summary.messages):
        near = only_near(estimate, facts)
        return f"{good}; {flat}; {near}" if without_heights(estimate) else f"{good}; {near}"
    if ground is not None and ground.is_measured:
        good = "to find things, and to measure distances, areas and differences in height"
        good += " where the ground was measured" if ground.is_measured_in_part else ""
    elif ground is not None:
        uneven = "not for heights, which no two pictures show"
        good = f"{good}; {uneven if ground.relief_share else flat}"
    return good if facts.relative_to else f"{good}; as coordinates on Earth only as the GPS has it"


def _count_of(count: int, one: str, many: str, rest: str) -> str:
    return f"{counted(count, one, many)} {rest}" if count else ""


def _promise(estimate: Estimate, summary: Summary, facts: Facts) -> str:
    if facts.is_graph:
        return ""
    alone = f" It cannot see an error of an instrument that nothing checks: {basis(estimate.accuracy_basis)}"
    unseen = (
        alone
        if estimate.accuracy_basis
        else " It cannot see an error that all instruments share; "
        + unless_checked(
            "one distance measured on the ground would.",
            f"known distances on the ground do ({RESULT}).",
        )
    )
    warned = by_kind(summary.messages).warnings
    trusted = f" {facts.condition}" * bool(estimate.accuracy_basis)
    doubted = (
        " What a warning on this page or “What failed?” below names is excepted."
        if warned or facts.heading_doubt
        else ""
    )
    if summary.status == "ok":
        return (
            "“ok” promises that the map hangs together, that pictures and instruments agree with each "
            f"other within the accuracy stated here, and that this accuracy holds{trusted}.{doubted}{unseen}"
        )
    return (
        "It names every cause that was found by which the map may be wrong by more than the accuracy "
        "stated here. That accuracy may be too good for this reason. All else was compared and "
        f"agrees.{doubted}{unseen}"
    )


def _whereabouts(facts: Facts, mosaic: MosaicFacts | None) -> str:
    if mosaic is None:
        return ""
    size = f"{mosaic.width} x {mosaic.height} pixels of {facts.length(mosaic.pixel_m)}"
    return (
        f"In mosaic.tif beside this page, {size} on the ground; mosaic.png is the same as a picture. "
        f"Coordinate system of mosaic.tif and elevation.tif: {facts.plane}."
    )


def _limit(estimate: Estimate, facts: Facts, mosaic: MosaicFacts | None) -> str:
    shares, on_ground = estimate.information_shares, mosaic is not None
    text = limit_sentence(shares, facts.metric, on_ground).removeprefix("What limits this: ")
    if not text:
        return ""
    further = further_limits(shares, facts.metric, on_ground)
    meant = (
        "What the pictures themselves tell is the tilt of the camera, by how exactly they fit each other, "
        "and its focal length, unless that was known before."
        if WORDS["pictures"] in f"{text} {further}".lower()
        else ""
    )
    if WORDS["flat_floor"] in text and estimate.camera is not None:
        camera = estimate.camera
        corner = float(np.hypot(*np.divide(camera.size_px, camera.focal_px))) / 2
        meant += (
            " If the height of the ground is wrong, its place is wrong too: in a corner of a picture by "
            f"{corner:.2g} times the error of the height, and straight below the camera not at all."
        )
    of_lengths = limit(shares, ("scale",)) if facts.metric else None
    if of_lengths is not None and of_lengths[0] == "pictures" and facts.scale_source:
        meant += (
            f" They measure no length: the scale comes from {facts.scale_source} alone. Their share in the "
            "lengths is what their inexact fit adds to the error; more overlap or sharper pictures lower it."
        )
    of_all = (
        "Most of the uncertainty of a camera's place is one error that all lengths share, "
        f"±{SPACE}{percent(facts.scale_std)}."
        if facts.mostly_scale
        else ""
    )
    parts = (
        f"{text[0].upper()}{text[1:]}",
        of_all,
        further,
        meant.strip(),
        "The table of instruments below has all shares.",
    )
    return " ".join(part for part in parts if part)


def _next(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    return next_steps(estimate, facts, summary, ground_is_missing(facts, summary), mosaic)


def _left_out(facts: Facts, rows: Sequence[LeftOut]) -> str:
    if not rows:
        return "Nothing."
    act = [row for row in rows if not row.no_need_to_act]
    parts = counted_by_kind(rows, facts.is_graph)
    if not act:
        return f"{parts}; no need to act, since the map does not rest on them. The table has the reasons."
    first = act[0]
    text = f"“{first.what}” ({first.count}): {first.act[0].lower()}{first.act[1:]}"
    act_on = "you may have to act on" if first.only_if else "act on"
    return f"{parts}; {act_on} {text} The map does not rest on them. The table below has the others."


def _axes(estimate: Estimate, facts: Facts) -> str:
    unknown = "" if estimate.origin is not None or facts.is_graph else "North is not known; "
    doubt = (
        f" Zero is the heading that the attitude sensor called zero at the first keyframe, but "
        f"{facts.heading_doubt}: on the map all fits together, but do not take x for a direction of a "
        "compass."
        if facts.heading_doubt and estimate.origin is None
        else ""
    )
    return f"{unknown}{facts.axes}{doubt}"


def _hand_on(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    """Return who can use coordinates of this map, and what has to be told with them."""
    if not facts.metric:
        return "No: they are not in metres. Hand on the mosaic as a picture."
    if summary.status != "ok":
        return "Not before you have checked what “Check this first” above names: its places may be wrong."
    if facts.relative_to:
        return (
            "Only together with this map: its origin and axes mean nothing elsewhere. Distances and areas "
            "can be handed on, with their uncertainty. With GPS or control points the map would lie on Earth."
        )
    known = mosaic is not None and np.isfinite(mosaic.typical_std_m)
    std_m = mosaic.typical_std_m if mosaic is not None and known else facts.sigma_median_m
    lines = [f"the coordinate system (above), the accuracy (typically ±{SPACE}{facts.error(std_m)})"]
    over_m = typical_height_std(estimate)
    kind = "altitudes" if facts.altitude_known else "heights"
    if np.isfinite(over_m):
        lines.append(
            f"that of {kind} of the ground (±{SPACE}{facts.error(over_m)}; “Are the heights true?” "
            "says what they count from)"
        )
    if not facts.controlled:
        lines.append("and that the place on Earth is that of the GPS")
    text = (
        f" Its fixes are {facts.gps_accuracy} to be good to ±{SPACE}{facts.error(facts.gps_std_m)} east "
        "and north each; an error that all of them share moves the whole map."
        if np.isfinite(facts.gps_std_m) and not facts.controlled
        else ""
    )
    return f"Yes, if you tell with them {', '.join(lines)}.{text}"


def _on_earth(estimate: Estimate) -> str:
    origin = estimate.origin
    if origin is None:
        return "Not known: no GPS was used."
    return f"Its origin is at {origin.text} (WGS 84)."
