"""Answers about loops: places recognised again, rejected matches, and what loop closures changed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from backend.measurements import CONTRADICTED, SAME_PLACE_HEIGHTS
from backend.wording import counted, either
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.units import length, percent
from slam.report.answers.checked_lengths import RESULT, unless_checked
from slam.report.facts import Facts, median_height_m


def loops(estimate: Estimate, facts: Facts) -> str:
    """Return how often places were recognised, and what speaks for and against the matches."""
    rejected = [loop for loop in estimate.loops if loop.verdict == "rejected"]
    against = [loop for loop in rejected if loop.finding == CONTRADICTED]
    names = ("loop closure", "loop closures") if facts.is_graph else ("pair of pictures", "pairs of pictures")
    if facts.loops_kept:
        text = (
            f"Yes, by {counted(facts.loops_kept, *names)}, so errors do not add up over the flight."
            f"{_ends(estimate, facts)} Each match that was kept agrees with all the others in one map."
        )
    elif facts.relative_to:
        text = "No, so errors add up along the path."
    else:
        text = "No: positions alone hold the path."
    if not rejected:
        return f"{text} No match was rejected: each shows enough to tell, and agrees."
    text += (
        f" {counted(len(rejected), 'other was', 'others were')} rejected, and the map rests on none of them."
        f"{_contradicted(estimate, against)}"
    )
    if unproven := len(rejected) - len(against):
        text += (
            f" {counted(unproven, 'shows', 'show')} too little to tell whether "
            f"{either(unproven, 'it is', 'they are')} right."
        )
    return text


def _ends(estimate: Estimate, facts: Facts) -> str:
    """Return how many keyframes have a match, in one sentence with a space in front; empty for a graph, and
    where all have one."""
    ends = {end for loop in estimate.loops if loop.verdict == "kept" for end in (loop.i, loop.j)}
    if facts.is_graph or not 0 < len(ends) < facts.placed:
        return ""
    grow = " Between them errors grow, up to the next pair." if facts.relative_to else ""
    return f" {len(ends)} of {facts.placed} keyframes belong to such a pair.{grow}"


def another_arrangement(estimate: Estimate, facts: Facts) -> str:
    """Return what the certificate says of other arrangements of the pictures; empty without one, for a graph,
    and where no match closes a ring, so that any arrangement fits."""
    found = estimate.certificate
    if found is None or facts.is_graph or found.objective == 0:
        return ""
    if not found.certified:
        return (
            f"That is not excluded: the proof that no other arrangement fits better failed ({found.reason}). "
            "It is no sign of an error: none that fits better was found."
        )
    return (
        "No: no other arrangement fits the accepted matches better; this is a proof, not a search. The best "
        f"fit of the matches alone differs from this map by up to {facts.length(found.moved_m)} and "
        f"{np.degrees(found.moved_rad):.2g}°. That is neither another arrangement nor the error of this map: "
        "the matches alone take the ground as flat, count as equally certain in all directions, and know of "
        "no other instrument. It does not prove that the matches are right."
    )


def _contradicted(estimate: Estimate, loops: Sequence[LoopVerdict]) -> str:
    """Return how many contradicted matches show the right place but inexactly, and how many another place,
    with a space in front; empty without any."""
    if not loops:
        return ""
    height_m = median_height_m(estimate) if estimate.metric else 1.0
    near = [miss for loop in loops if (miss := _miss(loop, height_m)) <= SAME_PLACE_HEIGHTS]
    far, lines = len(loops) - len(near), []
    if near:
        largest, middle = (length(miss * height_m, estimate.metric) for miss in (max(near), np.median(near)))
        size = f"{largest} at most, typically by {middle}" if len(near) > 1 else largest
        uneven = estimate.ground is not None and estimate.ground.relief_share > 0
        cause = ", likely because a match takes the ground for flat, and here it is not" if uneven else ""
        shown = counted(len(near), "shows", "show") if far else either(len(near), "it shows", "they show")
        lines.append(f"{shown} the right place but inexactly, off by {size}{cause}")
    if far:
        shown = counted(far, "shows", "show") if near else either(far, "it shows", "they show")
        lines.append(f"{shown} another place that looks alike, or {either(far, 'fits', 'fit')} wrongly")
    text = f" The rest of the map contradicts {len(loops)}: {'; '.join(lines)}."
    return f"{text}{_most_often(estimate, loops)}"


def _miss(loop: LoopVerdict, height_m: float) -> float:
    """Return by how much a match displaces the ground in its pictures, in heights of the camera; infinite
    where another check rejected it or the height is not known."""
    misfit = loop.rejection.misfit if loop.rejection else None
    if misfit is None or not height_m > 0:  # poses of a planar graph have no height
        return float("inf")
    off = misfit.length / height_m if misfit.unit == "m" else misfit.length
    return float(np.hypot(off, np.radians(misfit.angle_deg)))


def _most_often(estimate: Estimate, loops: Sequence[LoopVerdict]) -> str:
    """Return which keyframe is in more of the loops than any other; empty where none is."""
    (k, count), (_, next_count) = Counter(end for loop in loops for end in (loop.i, loop.j)).most_common(2)
    if count == next_count:
        return ""
    return (
        f" Keyframe {k}, {estimate.frame_names[k]}, is in {count} of the {len(loops)}, more than any other."
    )


def gain_of_loops(facts: Facts) -> str:
    """Return how far loop closures moved the path; empty where there are none, and for a graph."""
    typical_m, largest_m = facts.loops_moved_m
    found = facts.loop_change
    if facts.is_graph or not facts.loops_kept or not np.isfinite(largest_m):
        return ""
    known = unless_checked(
        "", f" {RESULT} tells by how much distances would be wrong without them, and are with them."
    )
    together = f"{facts.length(typical_m)} away from here typically, and {facts.length(largest_m)} at most"
    height = " The picture “Height” below shows the heights of both."
    if found is None:
        return f"Without them, the camera would lie {together}, place and height together.{height}{known}"
    off, turn_deg = found.scale - 1, np.degrees(found.turn_rad)
    with_fit = ", together with the later fit of all pictures and instruments," * facts.is_refined
    return (
        f"They{with_fit} took out drift that would bend the map by {facts.length(found.typical_m)} "
        f"typically, and by {facts.length(found.largest_m)} at most. Besides, without "
        f"{'both' if facts.is_refined else 'them'} all lengths are "
        f"{percent(abs(off))} {'longer' if off > 0 else 'shorter'}, and the whole map is turned by "
        f"{abs(turn_deg):.2g}° and shifted by {facts.length(found.shift_m)}, which bends nothing. Both "
        f"together would place the camera {together}, place and height together.{height}{known}"
    )
