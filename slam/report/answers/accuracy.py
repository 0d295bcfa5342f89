"""Answers about the accuracy of a map: places, scale and faults of a mosaic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted
from slam.core.estimate import Estimate
from slam.core.units import SPACE, length, percent
from slam.report.answers.advice import main_cause
from slam.report.answers.checked_lengths import CHECKED, RESULT, basis, unless_checked
from slam.report.answers.streams import doubts
from slam.report.coordinates import at
from slam.report.facts import Facts, typical_axis_stds
from slam.report.mosaic_facts import MosaicFacts

if TYPE_CHECKING:
    from slam.core.summary import Summary

_STREAMS = {"height sensor": "sonar0", "accelerometer": "imu0", "GPS": "gps0"}
"""Instrument that tells the scale -> name of its stream in warnings."""
_MAINLY = 0.5
"""Share of a deviation above which it is mainly another one: three quarters of the variance are its."""
_IF_WRONG = "Lengths told 1 % too long make the map 1 % too large."


def place(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    """Return how accurate a point of the mosaic is, and how accurate a keyframe."""
    if not np.isfinite(facts.sigma_median_m):
        return "Not known: no uncertainty could be computed for most of it."
    relative = facts.against.rstrip(",")
    thing = "pose" if facts.is_graph else "camera at a keyframe (a picture that the map is made of)"
    camera = f"a {thing} is typically known to ±{SPACE}{facts.error(facts.sigma_median_m)} {relative}"
    text = f"{camera[0].upper()}{camera[1:]}, one standard deviation."
    if mosaic is not None and np.isfinite(mosaic.typical_std_m):
        pixel = f"a pixel is {facts.length(mosaic.pixel_m)} wide"
        text = (
            f"A point on the mosaic is typically known to ±{SPACE}{facts.error(mosaic.typical_std_m)} "
            f"{relative}, and to ±{SPACE}{facts.error(mosaic.worst_std_m)} where it is least certain: one "
            f"standard deviation, x and y together; {pixel}. The {camera.removeprefix('a ')}, all axes "
            "together."
        )
        if mosaic.typical_std_m > facts.sigma_median_m:
            text += (
                " The ground is typically less certain than the camera, because its place on the map also "
                "depends on the camera's tilt, its height over the ground and its lens, the more the farther "
                "the ground lies from the middle of a "
                f"picture{main_cause(estimate.information_shares, ('ground',))}."
            )
    text += " Two times out of three the error is smaller; an error three times as large is rare."
    if not facts.relative_to and not facts.controlled and np.isfinite(facts.gps_std_m):
        text += (
            " This is how well the fixes of the GPS agree with each other. It does not count a shift that "
            "all of them share, which may be as large as what is "
            f"{facts.gps_accuracy} for one fix, ±{SPACE}{facts.error(facts.gps_std_m)}, and larger where a "
            f"base station is wrong: {_by_point(estimate)}."
        )
    return text + _axes_apart(estimate, facts) + uncounted(summary)


def _by_point(estimate: Estimate) -> str:
    """Return what checks a place on Earth."""
    if estimate.control is not None and estimate.control.checks:
        return f"the check points tell it ({RESULT})"
    return "a point of known coordinates on the ground checks the place"


def _axes_apart(estimate: Estimate, facts: Facts) -> str:
    """Return why fixes of a GPS tell the height of a camera much better than its x and y, with a space in
    front; empty where they do not."""
    level_m, up_m = typical_axis_stds(estimate)
    by_fix = facts.gps_std_m if not facts.relative_to and not facts.controlled else float("nan")
    if not (level_m > _MAINLY * by_fix and up_m < _MAINLY * level_m):
        return ""
    return (
        f" The camera's z is known better (±{SPACE}{facts.error(up_m)}) than its x and y (±{SPACE}"
        f"{facts.length(level_m)} each). To its pictures a shift looks like a tilt, so that x and y rest "
        "mainly on the camera's own fix. A wrong height changes the size of all that a picture shows: the "
        "pictures hold the heights of all cameras together, and the scatter of all fixes averages out."
    )


def uncounted(summary: Summary) -> str:
    """Return that a figure does not count what the status names, with a space in front; empty for ``ok``."""
    return " It does not count what “Check this first” above names." if summary.status != "ok" else ""


def least_certain(estimate: Estimate, facts: Facts, mosaic: MosaicFacts | None) -> str:
    """Return the least certain ground and the least certain keyframe."""
    k = facts.least_certain
    if k is None:
        return ""
    x, y, _ = estimate.w_T_b[k, :3, 3].tolist()
    what = "pose" if facts.is_graph else "keyframe"
    name = estimate.frame_names[k] if k < len(estimate.frame_names) and not facts.is_graph else ""
    path = f"Around {at(estimate, x, y)} ({what} {k}{f', {name}' * bool(name)})"
    path += f", where a position is known to ±{SPACE}{facts.error(facts.sigma_max_m)}, all axes together"
    path += ": no usable picture lies on one side of it." if _borders_gap(facts, k) else "."
    if mosaic is None or not np.isfinite(mosaic.worst_std_m):
        return f"{path} map.html colours the path by it."
    return (
        f"The ground around {at(estimate, mosaic.x_m, mosaic.y_m)}, known to "
        f"±{SPACE}{facts.error(mosaic.worst_std_m)}, x and y together: the ring in the middle one "
        f"of the three maps below.{_why_uncertain(facts, mosaic)}{_unmeasured(estimate)} "
        f"The path: {path[0].lower()}{path[1:]}"
    )


def _borders_gap(facts: Facts, k: int) -> bool:
    return any(k in (gap.i, gap.j) for gap in facts.gaps)


def _unmeasured(estimate: Estimate) -> str:
    """Return what counts where the height of uneven ground was not measured, with a space in front."""
    ground = estimate.ground
    if ground is None or not ground.is_measured_in_part:
        return ""
    return (
        " Where no height was measured, a place counts as less certain (pale in the picture of heights): the "
        "ground is drawn as level or filled in, but may be as uneven as the rest."
    )


def _why_uncertain(facts: Facts, mosaic: MosaicFacts) -> str:
    """Return what makes the least certain ground so, in one sentence with a space in front."""
    shown = counted(mosaic.worst_pictures, "picture shows it", "pictures show it")
    lines = [f"{shown} (left map)"] if mosaic.worst_pictures else []
    if facts.relative_to:
        away = facts.length(float(np.hypot(mosaic.x_m, mosaic.y_m)))
        lines.append(
            f"it lies {away} from the first keyframe, and errors of scale and heading grow with that"
        )
    text = "; ".join(lines)
    return f" {text[0].upper()}{text[1:]}." if text else ""


def scale(estimate: Estimate, facts: Facts, summary: Summary) -> str:
    """Return by which instruments the lengths of a map are known, and whether they agree."""
    if facts.is_graph:
        return "As right as the edges of the graph, which give it."
    if not facts.metric:
        return "Not known: no instrument measured a length. Record a height sensor or GPS."
    known = f"to ±{SPACE}{percent(facts.scale_std)}" if facts.scale_std else "with an unknown uncertainty"
    upper = f"{known[0].upper()}{known[1:]}"
    if estimate.accuracy_basis:
        first = "" if summary.status == "ok" else "Only after you have checked “Check this first” above. "
        alone = basis(estimate.accuracy_basis)
        return f"{first}{upper}, {facts.condition}. {_IF_WRONG} {alone}{_too_vague(estimate, facts)}"
    if summary.status != "ok":
        return f"By {facts.scale_source}, {known}; but read “Check this first” above."
    if " and " not in facts.scale_source:
        return f"{upper}, {facts.condition}. {_IF_WRONG}"
    doubted = [
        stream
        for name, stream in _STREAMS.items()
        if name in facts.scale_source and any(doubt.about == stream for doubt in doubts(summary.messages))
    ]
    if doubted:
        return (
            f"{upper}, by {facts.scale_source} together. But a warning below names "
            f"{' and '.join(doubted)}: measure one distance on the ground to be sure."
        )
    checked = unless_checked("", f" {CHECKED}")
    return f"Yes, {known}: {facts.scale_source} tell it, and they agree.{checked}{_beside(estimate)}"


def _too_vague(estimate: Estimate, facts: Facts) -> str:
    """Return that the accelerometer agrees with lengths that it checks badly, with a space in front; empty
    where it does not tell, and where known distances have checked them."""
    found = estimate.instruments.accelerometer
    if found is None or found.used or not abs(found.scale - 1) < 2 * found.scale_std:
        return ""
    if not found.scale_std > facts.scale_std / _MAINLY:
        return ""
    return unless_checked(
        f" The accelerometer agrees with the lengths, but tells them only to ±{SPACE}"
        f"{percent(found.scale_std)}, which is no check of this accuracy."
    )


def _beside(estimate: Estimate) -> str:
    """Return how the lengths by the accelerometer compare with those by the other instruments."""
    found = estimate.instruments.accelerometer
    if found is None or not found.used or found.others_std is None:
        return ""
    off, std = found.scale - 1, found.scale_std
    return (
        f" Before they were joined, lengths by the accelerometer were {percent(abs(off))} "
        f"{'longer' if off > 0 else 'shorter'} (±{SPACE}{percent(std)}) than those by the other "
        f"instruments, which were known to ±{SPACE}{percent(found.others_std)}: no more than these "
        "uncertainties explain. The map weighs both by them."
    )


def not_as_it_is(estimate: Estimate, mosaic: MosaicFacts | None) -> str:
    """Return what a mosaic may show cut, twice or displaced."""
    if mosaic is None:
        return ""
    is_uneven = estimate.ground is not None and estimate.ground.relief_share > 0
    hidden = ", or what higher ground hides" if is_uneven else ""
    text = "What moved, or stands above the ground, may be cut, doubled or lean"
    if np.isfinite(mosaic.seam_share):
        text += (
            f": look first around {at(estimate, mosaic.seam_x_m, mosaic.seam_y_m)}, where two pictures "
            f"differ most, by {percent(mosaic.seam_share)} of the brightness. Typically they differ by "
            f"{percent(mosaic.seam_typical)}"
        )
    text += (
        ". The right one of the three maps below is the darker, the more two pictures differ; a ring is "
        f"around its darkest place. Grey is what no picture shows{hidden}; mosaic.png is "
        "transparent there. Any other area of one colour is no fault: the camera saw the ground so."
    )
    ground = estimate.ground
    if ground is not None and np.isfinite(ground.misregistration_px[-1]):
        shift_m = ground.misregistration_px[-1] * mosaic.pixel_m
        text += (
            f" At the seams the pictures fit to {ground.misregistration_px[-1]:.2g} pixels "
            f"({length(shift_m, estimate.metric)}) on 95 % of the ground."
        )
    return text
