"""Answers about what a map lacks: what failed, and which ground is missing."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from backend.wording import counted, either
from slam.core.estimate import Estimate
from slam.core.lost_pictures import NOTABLE_SHARE, REDUNDANT, SHOW_NOTHING, TRACKING_LOST
from slam.core.messages import by_kind
from slam.core.names import listed
from slam.core.units import area, axis_names, percent, unit
from slam.report.answers.streams import STREAM_WORDS, doubts, is_tilt_doubted
from slam.report.coordinates import at
from slam.report.facts import Facts
from slam.report.mosaic_facts import MosaicFacts

if TYPE_CHECKING:
    from slam.core.summary import Summary

_MOST_NAMED = 3
"""Keyframes that are named; summary.json has all of them."""
_MOST_GAPS = 3
"""Stretches without pictures that are named."""


def too_bare(facts: Facts, summary: Summary) -> int:
    """Return the number of pictures that show nothing, if they are worth telling."""
    bare = sum(count for reason, count in summary.rejected.items() if reason.startswith(SHOW_NOTHING))
    return bare if bare > NOTABLE_SHARE * facts.frames else 0


def missing(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    """Return which ground the map lacks: on the path, inside the mosaic, around it, and of its heights."""
    thing = "poses" if facts.is_graph else "keyframes"
    lacks = _stretches(estimate, facts, mosaic)
    if bare := too_bare(facts, summary):
        lacks.append(
            f"{bare} of {facts.frames} pictures {either(bare, 'shows', 'show')} too little, and the "
            "warnings say when"
        )
    if facts.placed < facts.keyframes or facts.maps > 1:
        parts = f", in {facts.maps} separate maps" if facts.maps > 1 else ""
        rest = "; the warnings name the rest" if facts.placed < facts.keyframes else ""
        lacks.append(f"{facts.placed} of {facts.keyframes} {thing} have a place{parts}{rest}")
    if mosaic is not None and mosaic.holes:
        lacks.append(_holes(estimate, mosaic))
    if lacks:
        return (
            f"Yes: {'; '.join(lacks)}.{_edge(mosaic)}{_beyond(estimate)}{_without_height(estimate, mosaic)}"
        )
    if facts.is_graph:
        return f"No: all {facts.keyframes} poses lie on one map."
    stretch = (
        "the stretches without usable pictures (dotted in the picture of the path) are shorter than a picture"
        if facts.gaps
        else "no stretch of the path is without pictures"
    )
    whole = ", and the mosaic has no hole" if mosaic is not None else ""
    return (
        f"No: all {facts.keyframes} {thing} lie on one map, {'and ' if not whole else ''}{stretch}{whole}."
        f"{_edge(mosaic)}{_beyond(estimate)}{_without_height(estimate, mosaic)}"
    )


def _beyond(estimate: Estimate) -> str:
    """Return which keyframes show ground beyond the mosaic, in a sentence with a space in front."""
    if not estimate.partly_drawn:
        return ""
    count = len(estimate.partly_drawn)
    of = [f"{_keyframes(estimate, [name])}: {what}" for name, what in estimate.partly_drawn.items()]
    show = f"{counted(count, 'keyframe')} {either(count, 'shows', 'show')} more ground than the mosaic"
    return f" On purpose, {show} ({listed(of)})."


def _stretches(estimate: Estimate, facts: Facts, mosaic: MosaicFacts | None) -> list[str]:
    long = [gap for gap in facts.gaps if gap.shows_nothing]
    lines = []
    for gap in long[:_MOST_GAPS]:
        (x0, y0), (x1, y1) = (estimate.w_T_b[k, :2, 3].tolist() for k in (gap.i, gap.j))
        lines.append(f"{facts.length(gap.length_m)} from ({x0:.3g}, {y0:.3g}) to ({x1:.3g}, {y1:.3g})")
    if not lines:
        return []
    more = f", and {len(long) - len(lines)} more" if len(long) > len(lines) else ""
    axes = ", ".join(axis_names(estimate.origin is not None))
    return [
        f"no usable picture was taken along {' and '.join(lines)}{more} of the path ({axes} in "
        f"{unit(facts.metric)}; dotted in the picture of the path){_below(facts, mosaic)}"
    ]


def _below(facts: Facts, mosaic: MosaicFacts | None) -> str:
    """Return how much of the ground below the stretches is missing, behind a semicolon."""
    some = "the pictures at both ends still show some of the ground between"
    if mosaic is None:
        return f"; {some}"
    if not mosaic.gap_area_m2:
        return "; other pictures show all the ground below"
    missing = area(mosaic.gap_area_m2, facts.metric)
    return f", where {missing} of the ground below, as wide as a picture, are grey on the map; {some}"


def _holes(estimate: Estimate, mosaic: MosaicFacts) -> str:
    """Return the empty areas inside of a mosaic."""
    count = "one hole" if mosaic.holes == 1 else f"{mosaic.holes} holes"
    which = "" if mosaic.holes == 1 else "the largest "
    return (
        f"the mosaic has {count}, {area(mosaic.hole_area_m2, estimate.metric)} in all, {which}around "
        f"{at(estimate, mosaic.hole_x_m, mosaic.hole_y_m)}: "
        "no picture shows this ground, or higher ground hides it"
    )


def _edge(mosaic: MosaicFacts | None) -> str:
    """Return how much of the rectangle of a mosaic is ground."""
    if mosaic is None or not mosaic.covered_share > 0:
        return ""
    return (
        f" The map ends where the pictures end, so its edge is frayed: {percent(mosaic.covered_share)} of "
        "the rectangle of the mosaic is ground, and the rest, which no picture shows, is grey."
    )


def _without_height(estimate: Estimate, mosaic: MosaicFacts | None) -> str:
    ground = estimate.ground
    if ground is None or not ground.is_measured_in_part:
        return ""
    holes = 0 if mosaic is None else mosaic.holes
    ground_shown = (
        f"Apart from the hole{'s' * (holes > 1)}, all ground within that edge"
        if holes
        else "All of this ground"
    )
    return (
        f" {ground_shown} is in the picture, but not all has a height to be trusted: {ground.untrusted} "
        "(“Are the heights true?” below)."
    )


def failed(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None = None) -> str:
    """Return what went wrong: parts of the map, and instruments that a warning doubts."""
    lines = []
    if summary.status != "ok":
        lines.append("what “Check this first” above names")
    lines += _bare(facts, summary, mosaic)
    if unplaced := facts.keyframes - facts.placed:
        lines.append(f"{counted(unplaced, 'pose' if facts.is_graph else 'keyframe')} could not be placed")
    if lost := summary.rejected.get(TRACKING_LOST, 0):
        times = {1: "once", 2: "twice"}.get(lost, f"{lost} times")
        where = " where the path is dotted" if facts.gaps else ""
        whole = "; the map is in one piece all the same" if facts.maps == 1 else ""
        lines.append(
            f"{times} a picture had nothing in common with the one before, and tracking began anew{where}"
            f"{whole}"
        )
    if number := sum(why != REDUNDANT for why in estimate.not_drawn.values()):
        lines.append(_not_drawn(estimate, number))
    warned_of, found_here = _doubted(summary), _doubted_without_warning(estimate, facts)
    doubted = "".join(f" {text}" for text in warned_of) + _trusted(estimate, summary)
    doubted += "".join(f" {text}" for text in found_here)
    if not doubted and not facts.is_graph and summary.status == "ok":
        doubted = " No instrument is doubted."
    on_purpose = " What was left out (below) was left out on purpose." if summary.rejected else ""
    if lines:
        text = "; ".join(lines)
        return f"{text[0].upper()}{text[1:]}.{doubted}"
    if warned_of:
        one = len(warned_of) == 1
        which = "a warning below doubts an instrument" if one else "warnings below doubt instruments"
        return f"No part of the map, but {which}.{doubted}{on_purpose}"
    if found_here:
        begin = "No part of the map, and no warning doubts an instrument, but some readings or heights are"
        return f"{begin} doubted.{doubted}{on_purpose}"
    warned = by_kind(summary.messages).warnings
    return f"Nothing{'; the warnings name what to check' if warned else ''}.{doubted}{on_purpose}"


def _bare(facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> list[str]:
    """Return that pictures showed nothing usable, and how much ground is missing; empty for a few of many."""
    if not (bare := too_bare(facts, summary)):
        return []
    missing_m2 = 0.0 if mosaic is None else mosaic.missing_m2
    lost = f", and {area(missing_m2, facts.metric)} of ground are missing" if missing_m2 else ""
    return [f"{bare} of {facts.frames} pictures showed too little to be used{lost}"]


def _trusted(estimate: Estimate, summary: Summary) -> str:
    """Return how the map uses an attitude sensor that is tilted, in sentences with a space in front.

    `backend.bundle.noise` weighs roll and pitch by their differences from the map.
    """
    found = estimate.instruments.attitude
    if found is None or not is_tilt_doubted(summary.messages):
        return ""
    return (
        f" The map trusts its roll and pitch no better than to {degrees(found.tilt_rad):.1f}°, their mean "
        "difference from the map. Lengths along the ground do not depend on them, but heights may lean."
    )


def _not_drawn(estimate: Estimate, number: int) -> str:
    """Return which keyframes the mosaic does not show, and why."""
    names: dict[str, list[str]] = {}
    for name, why in estimate.not_drawn.items():
        if why != REDUNDANT:
            names.setdefault(why, []).append(name)
    are = "keyframe is" if number == 1 else "keyframes are"
    text = "; ".join(f"{_keyframes(estimate, of)}: {why}" for why, of in names.items())
    return f"{number} {are} not in the mosaic ({text})"


def _keyframes(estimate: Estimate, names: list[str]) -> str:
    """Return keyframes by number and name, where they are few."""
    if len(names) > _MOST_NAMED:
        return f"{len(names)} keyframes, which summary.json names"
    number = {name: k for k, name in enumerate(estimate.frame_names)}
    return ", ".join(f"keyframe {number[name]}, {name}" if name in number else name for name in names)


def _doubted(summary: Summary) -> list[str]:
    """Return a sentence for each warning that doubts an instrument and that the status does not name."""
    lines = []
    for doubt in doubts(by_kind(summary.messages).others):
        text = f"{STREAM_WORDS[doubt.about]}{':' * doubt.begins_with_colon} {doubt.finding}"
        lines.append(f"{text[0].upper()}{text[1:]}.")
    return lines


def _doubted_without_warning(estimate: Estimate, facts: Facts) -> list[str]:
    """Return a sentence for each doubt that needs no warning: the accuracy told does not rest on it."""
    lines = []
    if facts.heading_doubt:
        lines.append(f"The attitude sensor: {facts.heading_doubt}; the pictures hold the heading of the map.")
    if estimate.ground is not None and estimate.ground.doubt:
        lines.append(f"{estimate.ground.doubt} (“Are the heights true?” below).")
    return lines
