"""Answers about the heights of a map: where they begin, how accurate they are, and what measured them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.units import SPACE, percent, round_length
from slam.report.answers.advice import HEIGHTS, focal_std_ratio, hangs_on_lens, main_cause
from slam.report.answers.streams import is_tilt_doubted
from slam.report.facts import Facts, heights_over_floor, largest_height_std
from slam.report.floor_scatter import floor_scatter

if TYPE_CHECKING:
    from slam.core.summary import Summary


def heights(estimate: Estimate, facts: Facts, summary: Summary) -> tuple[str, tuple[str, ...]]:
    """Return whether heights are true and from where they count; and lines about those of the ground, about
    differences near each other, and about those of a camera."""
    tilted = is_tilt_doubted(summary.messages)
    over_m, worst_m = typical_height_std(estimate), largest_height_std(estimate)
    text = (
        f"{_verdict(estimate, facts, summary.status, over_m if not tilted else None)} Heights {facts.datum}."
    )
    if tilted:
        text += " A warning below names the attitude sensor (attitude0), by which the whole map may lean."
    camera = ""
    if np.isfinite(over_m):
        camera = f" typically known to ±{SPACE}{facts.error(over_m)}{_by(facts)}{_cause(estimate)}."
        if facts.altitude_known:
            camera += (
                " The altitude of the ground on Earth is known no better than that: it moves as a whole."
            )
    if np.isfinite(worst_m) and (facts.relative_to or facts.altitude_known):
        camera += _of_camera(facts, over_m, worst_m, tilted)
    lines = (
        ("Heights of the ground:", _of_ground(estimate)),
        ("Differences in height near each other:", _near_each_other(estimate, facts, tilted)),
        (f"Height of a camera over the {_level(estimate)}:", camera),
    )
    return text, tuple(f"{name}{line}" for name, line in lines if line)


def _level(estimate: Estimate) -> str:
    """Return in words what the height of a camera counts from."""
    if estimate.ground is not None and estimate.ground.is_measured:
        return "floor (the level plane that fits the ground best)"
    return "ground, which is taken as level"


def _by(facts: Facts) -> str:
    """Return by which instruments the height of a camera is known, without metres none."""
    return f", by the pictures together with {facts.scale_source}" if facts.metric else ""


def typical_height_std(estimate: Estimate) -> float:
    """Return the median standard deviation of the height of a keyframe over the floor; NaN without any."""
    std_m = heights_over_floor(estimate)[1]
    return float(np.nanmedian(std_m)) if np.isfinite(std_m).any() else float("nan")


def _of_ground(estimate: Estimate) -> str:
    ground = estimate.ground
    if ground is None:
        return ""
    if ground.is_measured:
        untrusted = (
            f" Of all ground, {ground.untrusted}: trust no height there. It is pale in the picture of "
            "heights. In elevation.tif its source is 3 (filled in) or 5 (level); doubted heights have source "
            "1 and no standard deviation."
            if ground.is_measured_in_part
            else ""
        )
        return (
            f" {percent(ground.relief_share)} of the ground does not lie on one plane. The pictures measured "
            "heights, with what stands on it such as trees, over the floor: the level plane that fits "
            f"best.{untrusted}"
        )
    if ground.relief_share > 0:
        return " None. The ground is not flat, but no two pictures show its height: trust no height of it."
    return (
        " None were measured. The ground is taken as flat, because the pictures show no hills; a height in "
        "elevation.tif is that of a thing that stands on it."
    )


def _near_each_other(estimate: Estimate, facts: Facts, tilted: bool) -> str:
    ground, text = estimate.ground, ""
    if ground is not None and ground.is_measured:
        std = ground.height_std_m
        text = (
            f" On the ground typically to ±{SPACE}{facts.error(np.sqrt(2.0) * std)}, as each of the two is "
            f"known to ±{SPACE}{facts.error(std)}.{_shared(estimate, facts)}"
            if std
            else ""
        )
    elif ground is not None and not ground.relief_share and estimate.elevation is not None:
        text = " The picture of heights below and elevation.tif show what the height sensor found on it."
        if scatter := floor_scatter(estimate.elevation.height_m):
            text += f" Heights from {scatter} cannot be told from the floor, whose echoes scatter that far."
    if tilted:
        tilt_rad = _tilt_rad(estimate)
        text += (
            f" A lean of {np.degrees(tilt_rad):.1f}° changes them by "
            f"{facts.error(float(np.tan(tilt_rad)))} for each {round_length(1.0, estimate.metric)} between "
            "the places."
        )
    return text


def _shared(estimate: Estimate, facts: Facts) -> str:
    """Return the error of heights that is proportional to them, with its size at the greatest, and a space
    in front; empty where there is none."""
    ground, share = estimate.ground, _error_ratio(estimate, facts)
    if ground is None or not share:
        return ""
    greatest_m = max(abs(ground.lowest_m), abs(ground.highest_m))
    why = "focal length" if HEIGHTS in hangs_on_lens(estimate) else "scale"
    return (
        f" The {why} adds {percent(share)} of the height: ±{SPACE}{facts.error(share * greatest_m)} at "
        f"{facts.length(greatest_m)} from the floor, the most."
    )


def _error_ratio(estimate: Estimate, facts: Facts) -> float:
    """Return the error of a height over the height itself, by the focal length or the scale; 0 without."""
    return focal_std_ratio(estimate) if HEIGHTS in hangs_on_lens(estimate) else facts.scale_std


def _cause(estimate: Estimate) -> str:
    """Return what causes the error of heights over the floor; empty where it is not known."""
    if HEIGHTS in hangs_on_lens(estimate):
        lens = percent(focal_std_ratio(estimate))
        return f", because the camera's focal length is known to {lens} only, and heights hang on it"
    return main_cause(estimate.information_shares, ("height",))


def _of_camera(facts: Facts, over_m: float, worst_m: float, tilted: bool) -> str:
    """Return how accurate the height of a camera is in the world, beside that over the floor."""
    against = facts.against.rstrip(",")
    shared = "tilt" if facts.relative_to else "altitude and tilt"
    text = (
        f" The camera's own {'z' if facts.relative_to else 'altitude'}, {against}, is known to "
        f"±{SPACE}{facts.error(worst_m)} where it is least certain. This counts the {shared} of the whole "
        f"map as far as the measurements tell{', but not the lean above' if tilted else ''}."
    )
    if not facts.relative_to and not facts.controlled:
        text += " It does not count a shift of all fixes together."
    if not worst_m < over_m:
        return text
    why = (
        "the error of the level of the floor, which all keyframes share, is no part of it"
        if facts.relative_to
        else f"{'control points' if facts.controlled else 'the GPS'} measured the camera itself, and the "
        "ground is seen from there"
    )
    return f"{text} That is better than the height over the floor, because {why}."


def only_near(estimate: Estimate, facts: Facts) -> str:
    """Return which heights hold on a map that may lean."""
    of_camera = " of the camera" if without_heights(estimate) else ""
    return f"heights{of_camera} only near each other, because the map may lean: {_lean(estimate, facts)}"


def without_heights(estimate: Estimate) -> bool:
    """Return whether the ground has no measured heights, so that the camera alone has some."""
    return estimate.ground is not None and not estimate.ground.is_measured


def _lean(estimate: Estimate, facts: Facts) -> str:
    """Return what a tilt of the map does to heights: that of the attitude sensor, or else a degree."""
    tilt_rad, across_m = _tilt_rad(estimate), max(facts.extent_m)
    return (
        f"{np.degrees(tilt_rad):.1f}° raise one end of the path by "
        f"{facts.length(float(np.tan(tilt_rad)) * across_m)} against the other, over the "
        f"{facts.length(across_m)} that it spans"
    )


def _tilt_rad(estimate: Estimate) -> float:
    found = estimate.instruments.attitude
    return found.tilt_rad if found is not None else float(np.radians(1.0))


def _as_altitudes(facts: Facts) -> str:
    """Return what heights are as altitudes on Earth; empty where that is no question."""
    if facts.relative_to or (facts.controlled and facts.altitude_known):
        return ""
    if not facts.altitude_known:
        return " As altitudes, no, because none is recorded."
    return " As altitudes, only as the GPS counts them."


def _verdict(estimate: Estimate, facts: Facts, status: str, over_m: float | None) -> str:
    """Return whether heights are true. ``over_m``: the deviation of a camera's height over the floor; None on
    a map that may lean."""
    if not facts.metric:
        return "Only in ratio to each other, because the map has no metres."
    if status != "ok":
        return "Only after you have checked what “Check this first” above names."
    if over_m is None:
        near = "Those of the camera near each other" if without_heights(estimate) else "Near each other"
        return f"{near}, yes; across the map, no, because it may lean: {_lean(estimate, facts)}."
    altitudes = _as_altitudes(facts)
    if without_heights(estimate):
        ground = "the ground has no measured heights"
        return f"Those of the camera, yes, within the figures that follow; {ground}.{altitudes}"
    over = "Over the floor, yes" if altitudes else "Yes"
    std_m = None if estimate.ground is None else estimate.ground.height_std_m
    if not std_m or not np.isfinite(over_m):
        return f"{over}, within the figures that follow.{altitudes}"
    ratio = _error_ratio(estimate, facts)
    beside = f" and {percent(ratio)} of the height" if ratio else ""
    where, rest, uneven = "", "", estimate.ground
    if uneven is not None and uneven.is_measured_in_part:
        where = f" on {percent(uneven.trusted_share)} of the ground"
        rest = "; trust none on the rest, pale in the picture of heights"
    return (
        f"{over}{where}: those of the ground typically to ±{SPACE}{facts.error(std_m)}{beside}, those of the "
        f"camera over it to ±{SPACE}{facts.error(over_m)}{rest}.{altitudes}"
    )
