"""The first sentence of a report: what was mapped, how accurately, and what holds it together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backend.wording import counted, either
from slam.core.messages import Message, by_kind
from slam.core.units import SPACE, area, percent
from slam.report.answers.streams import doubted, doubts
from slam.report.facts import Facts
from slam.report.mosaic_facts import MosaicFacts


def sentence(facts: Facts, status: str, mosaic: MosaicFacts | None = None) -> str:
    """Summarise the result and its accuracy in words for a pilot; ``status`` is that of the map.

    ``mosaic``: figures of the mosaic, where there is one.
    """
    ground_std_m = None if mosaic is None else mosaic.ground_std_m
    thing = "poses" if facts.is_graph else "keyframes"
    if facts.placed == 0:
        return f"Nothing could be placed: none of {facts.keyframes} {thing} has a position."
    of_map = "" if facts.is_graph or facts.keyframes == 1 else " (the pictures that the map is made of)"
    whole = (
        ("The only" if facts.keyframes == 1 else f"All {facts.keyframes}")
        if facts.placed == facts.keyframes
        else f"{facts.placed} of {facts.keyframes}"
    )
    maps = (
        "one consistent map" if facts.maps <= 1 else f"{facts.maps} separate maps that share no common ground"
    )
    noun = thing[:-1] if facts.keyframes == 1 else thing
    text = f"{whole} {noun}{of_map} {either(facts.placed, 'lies', 'lie')} on {maps}"
    on_ground = ground_std_m is not None and bool(np.isfinite(ground_std_m[0]))
    typical_m, worst_m = (
        ground_std_m if ground_std_m is not None and on_ground else (facts.sigma_median_m, facts.sigma_max_m)
    )
    if np.isfinite(typical_m):
        worst = (
            f"and to ±{SPACE}{facts.error(worst_m)} where it is least certain"
            if np.isfinite(worst_m)
            else "and others are not known"
        )
        why = (
            f" (mostly because the scale of all lengths is known to {percent(facts.scale_std)} only)"
            if facts.mostly_scale and not on_ground
            else ""
        )
        of = "a point on the ground" if on_ground else f"the position of a {thing[:-1]}"
        typically = f"is typically known to ±{SPACE}{facts.error(typical_m)}{why}, {worst}"
        text += f"; {facts.against} {of} {typically}"
        if status != "ok":
            text += "; errors that the status names come on top"
    text += "."
    if facts.loops_kept:
        one = facts.loops_kept == 1
        closures = "loop closure" if one else "loop closures"
        pair = (
            "two pictures, not neighbours in time, that show"
            if one
            else "pairs of pictures, not neighbours in time, that show"
        )
        what = "" if facts.is_graph else f" ({pair} one place)"
        text += f" {facts.loops_kept} {closures}{what} {'holds' if one else 'hold'} it together."
    elif facts.relative_to:
        text += " No place was recognised a second time with certainty, so errors add up along the path."
    else:
        text += " No place was recognised a second time with certainty: positions alone hold the path."
    text += _missing(facts, mosaic)
    if not facts.metric:
        text += (
            " No sensor determined the length of a metre, so lengths are relative: in heights, multiples of "
            "the camera's mean height over the floor."
        )
    return text


def _missing(facts: Facts, mosaic: MosaicFacts | None) -> str:
    """Return how much ground the map lacks, in one sentence with a space in front; empty where none is
    missing."""
    long = [gap for gap in facts.gaps if gap.shows_nothing]
    holes_m2 = 0.0 if mosaic is None else mosaic.hole_beside_m2
    lines = []
    if long:
        path = facts.length(sum(gap.length_m for gap in long))
        lines.append(
            f"no usable picture shows {counted(len(long), 'stretch', 'stretches')} of the path, {path} in all"
        )
        if mosaic is not None and mosaic.gap_area_m2 > 0:
            lines[-1] += f", and with it {area(mosaic.gap_area_m2, facts.metric)} of ground"
    if holes_m2 > 0:
        lines.append(f"{area(holes_m2, facts.metric)} {'more ' if long else ''}inside the map are missing")
    text = " and ".join(lines)
    return f" Ground is missing: {text}." if lines else ""


def what_ok_means(messages: Sequence[Message], ground_is_missing: bool) -> str:
    """Return what the status ok says of a map, except for what its ``messages`` doubt."""
    found = [doubted(message) for message in doubts(messages)]
    text = "all measurements that this map uses agree with each other"
    if found:
        text += f", with {either(len(found), 'one exception', 'exceptions')}: {'; '.join(found)}"
    if count := len(by_kind(messages).warnings):
        text += f"; see the {either(count, 'warning', 'warnings')} below “In short”"
        text += ": ground is missing" if ground_is_missing else ""
    return f"{text}."
