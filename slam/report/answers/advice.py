"""The limit of a map's accuracy, and what a pilot can do about it with the instruments at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.lost_pictures import BARE_GROUND
from slam.core.messages import by_kind
from slam.core.units import percent
from slam.report.answers.checked_lengths import RESULT, unless_checked
from slam.report.facts import Facts, heights_over_floor
from slam.report.gaps import picture_over_height
from slam.report.tables.evaluation import EVALUATE

if TYPE_CHECKING:
    from slam.core.summary import Summary
    from slam.report.mosaic_facts import MosaicFacts

WORDS: Mapping[str, str] = {
    "range": "the height sensor",
    "pictures": "the pictures themselves",
    "flat_floor": "how uneven the ground is",
    "attitude": "the attitude sensor",
    "position": "the GPS",
    "control": "the control points",
    "imu": "the accelerometer of the IMU",
    "velocity": "the vehicle's own velocity",
    "barometer": "the barometer",
    "assumed": "assumed values, which no instrument measured",
}
"""Name of a share in `backend.bundle.accuracy.information_shares` -> in words."""
_CARRIER_PHASE_M = 0.1
"""Receivers that state less have corrections of the carrier phase (RTK, PPK), and errors of centimetres.
Without it, corrections leave half a metre at least (Groves, Principles of GNSS, 2013, chapter 10)."""
_GROUND, _CAMERA, _LENGTHS, _HEIGHT = ("ground",), ("x", "y"), ("scale",), ("height",)
_STEPS: Mapping[str, str] = {
    "attitude": "calibrate its level, or fly the same rows in both directions",
    "control": "mark more control points, spread to the corners of the ground",
    "imu": "measure control points on the ground, which tell the lengths better, or calibrate the gain of "
    "the accelerometer: record it at rest on each of its six sides; docs/recipes.md of the project says "
    "under accel_scale how the map then takes the gain",
    "velocity": "avoid stretches of floor without texture, or record the IMU",
    "barometer": "climb and descend more, or add a height sensor or GPS",
    "assumed": "record the instrument that measures them, or state them with their accuracy in sensor.yaml",
}


_SURVEYS = ("measure one distance", "measure heights", "measure control points")
"""Measurements on the ground that a step asks for."""
_PLACE = "the place of a camera"
HEIGHTS = "heights over the ground"
"""Name of the heights that may hang on the focal length, as lengths may."""
_SAME_SIZE = np.sqrt(0.5), np.sqrt(2.0)
"""Ratios of two deviations between which one may be the main cause of the other: half of its variance."""


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


def main_cause(shares: Mapping[str, Mapping[str, float]], axes: Sequence[str]) -> str:
    """Return the end of a sentence with what causes most of an uncertainty; empty where it is not known."""
    found = limit(shares, axes)
    return "" if found is None else f"; {percent(found[1])} of what is left comes from {in_words(found[0])}"


def limit_sentence(
    shares: Mapping[str, Mapping[str, float]], metric: bool = True, on_ground: bool = False
) -> str:
    """Return what limits the accuracy of places and lengths of a map, in one sentence; empty where it is not
    known.

    ``on_ground``: the places are those of the ground on a mosaic, and else those of the camera. Without
    metres nothing is said of lengths.
    """
    of_ground = limit(shares, _GROUND) if on_ground else None
    found, place = (of_ground, "a point on the ground") if of_ground else (limit(shares, _CAMERA), _PLACE)
    of_lengths = limit(shares, _LENGTHS) if metric else None
    if found is None:
        return ""
    name, share = found
    left = f"{in_words(name)} ({percent(share)} of the uncertainty that is left)"
    if of_lengths is None or of_lengths[0] == name:
        return f"What limits this: {left}."
    lengths = f"{in_words(of_lengths[0])} ({percent(of_lengths[1])})"
    return f"What limits this: for {place}, {left}; for lengths, {lengths}."


def further_limits(shares: Mapping[str, Mapping[str, float]], metric: bool, on_ground: bool) -> str:
    """Return what else than the limit of places limits the height and the place of a camera, in one sentence;
    the rest of `limit_sentence`."""
    first = limit(shares, _GROUND if on_ground and _GROUND[0] in shares else _CAMERA)
    others: list[tuple[str, tuple[str, ...]]] = []
    others += [("the height of a camera over the ground", _HEIGHT)] if metric else []
    if on_ground and _GROUND[0] in shares:
        others.append((_PLACE, _CAMERA))
    found = [(what, limit(shares, axes)) for what, axes in others]
    lines = [
        f"for {what}, {in_words(by[0])} ({percent(by[1])})"
        for what, by in found
        if by is not None and first is not None and by[0] != first[0]
    ]
    text = "; ".join(lines)
    return f"{text[0].upper()}{text[1:]}." if text else ""


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
    elif asked := [m for m in by_kind(summary.messages).warnings if m.about != BARE_GROUND]:
        what = "warning" if len(asked) == 1 else f"{len(asked)} warnings"
        step = f": {asked[0].next_step}" if len(asked) == 1 and asked[0].next_step else ""
        steps.append(f"first act on the {what} below{step}")
    if ground_missing:  # what a warning of bare ground asks for, with the height of this map
        higher = f"higher{_as_high(estimate, facts)}"
        steps.append(
            f"if you need the ground that is missing, cross it {higher}, with more light, or with marks on it"
        )
    if not facts.loops_kept and not facts.is_graph:
        why = "errors do not add up" if facts.relative_to else "the map does not rest on positions alone"
        steps.append(f"cross or repeat an earlier part of the path, so that {why}")
    if not facts.metric:
        steps.append("record a height sensor or GPS, which give lengths in metres")
    on_ground = mosaic is not None and _GROUND[0] in estimate.information_shares
    found = limit(estimate.information_shares, _GROUND if on_ground else _CAMERA)
    if found is not None and (step := _step(found[0], estimate, facts)):
        steps.append(f"to be more accurate than now, {step}")
    if lens_step := _lens_step(estimate):
        steps.append(lens_step)
    if facts.has_truth:
        steps.append(
            unless_checked(
                f"Compare the map with the true path that this flight holds: {EVALUATE}",
                f"The map was compared with the true path of its flight ({RESULT})",
            )
        )
    if any(wanted in step for step in steps for wanted in _SURVEYS) and not facts.controlled:
        steps.append(
            "What you measure on the ground, places with heights and so lengths too, can be given to the "
            "program as at least three points that two pictures each show: slam optimize --gcp FILE "
            "(docs/method/control-points.md of the project has its columns)"
        )
    return " ".join(f"{step[0].upper()}{step[1:]}." for step in steps)


def focal_std_ratio(estimate: Estimate) -> float:
    """Return the relative standard deviation of an estimated focal length; 0 where it is held."""
    numbers = estimate.instruments.lens or {}
    ratios = [numbers[name].std / numbers[name].value for name in ("fx", "fy") if name in numbers]
    return max((ratio for ratio in ratios if np.isfinite(ratio)), default=0.0)


def hangs_on_lens(estimate: Estimate) -> tuple[str, ...]:
    """Return which of lengths and heights hang on the focal length: the pictures limit them, and they are as
    uncertain as it is."""
    lens = focal_std_ratio(estimate)
    if not lens:
        return ()
    height_m, std_m = heights_over_floor(estimate)
    known = np.isfinite(std_m) & (height_m > 0)
    of_heights = float(np.median(std_m[known] / height_m[known])) if known.any() else 0.0
    found = []
    for what, axes, std in (
        ("lengths", _LENGTHS, estimate.scale_std or 0.0),
        (HEIGHTS, _HEIGHT, of_heights),
    ):
        of_all = limit(estimate.information_shares, axes)
        if of_all is not None and of_all[0] == "pictures" and std > 0:
            found += [what] * int(_SAME_SIZE[0] < lens / std < _SAME_SIZE[1])
    return tuple(found)


def _lens_step(estimate: Estimate) -> str:
    """Return what makes the focal length better known, where lengths or heights hang on it."""
    limited = hangs_on_lens(estimate)
    if not limited:
        return ""
    lens = estimate.instruments.lens or {}
    whence = "by the pictures" if lens["fx"].estimated else "mostly by what was told before the flight"
    return (
        f"for truer {' and '.join(limited)}, calibrate the camera, or fly part of the ground at another "
        f"height: its focal length is known to {percent(focal_std_ratio(estimate))}, {whence}"
    )


def _as_high(estimate: Estimate, facts: Facts) -> str:
    """Return from which height a picture shows the longest stretch without pictures from end to end."""
    longest_m = max((gap.length_m for gap in facts.gaps), default=0.0)
    if estimate.camera is None or not longest_m:
        return ""
    height_m = longest_m / picture_over_height(estimate.camera)
    return f" (from {facts.length(height_m)}, one picture shows both ends of the longest stretch)"


def _step(name: str, estimate: Estimate, facts: Facts) -> str:
    """Return what improves the instrument that limits a map, by what is at hand."""
    if name == "pictures":
        return _closer_pictures(estimate, facts)
    if name == "flat_floor":
        return _more_views(estimate)
    if name == "position":
        return _better_positions(facts)
    if name == "range":
        return _better_ranges(facts)
    return _STEPS.get(name, "")


def _closer_pictures(estimate: Estimate, facts: Facts) -> str:
    """Return how to make an error in pixels shorter on the ground, with the height of now."""
    height_m = heights_over_floor(estimate)[0]
    known = height_m[np.isfinite(height_m)]
    now = f" than the {facts.length(float(np.median(known)))} of now" if len(known) else ""
    return (
        f"fly lower{now}, because an error of a pixel is half as long on the ground from half the height; or "
        "with more overlap, or with a sharper camera"
    )


def _more_views(estimate: Estimate) -> str:
    """Return how to measure the ground instead of taking it as level, with the number of views of now."""
    points = estimate.floor_points
    now = (
        f" (a point of it is in {np.median(points.views):.0f} of them now, in the median)"
        if points is not None and len(points.views)
        else ""
    )
    return (
        f"take more pictures of each place of the uneven ground{now}: the more pictures show a point "
        "from different sides, the better they measure its height, and the less the map takes the ground as "
        "level; also fly a row beyond the ground that you need, because the fewest pictures show the edge"
    )


def _better_positions(facts: Facts) -> str:
    more = "mark more control points" if facts.controlled else "measure control points on the ground"
    if facts.gps_std_m < _CARRIER_PHASE_M:
        return f"{more}: the GPS already has corrections (RTK), and no receiver is much better"
    return f"use a GPS with corrections (RTK), or {more} and mark them in the pictures"


def _better_ranges(facts: Facts) -> str:
    if facts.range_exact:
        return (
            "fly longer over the same ground, so that the scatter of the height sensor's readings averages "
            "out"
            + unless_checked(
                "; and measure one distance on the ground and compare it with map.html, because its gain and "
                "zero are taken as exact"
            )
        )
    return (
        unless_checked("measure one distance on the ground and compare it with map.html; or ")
        + "hold the drone at two heights measured by tape, correct the readings in sonar0/data.csv by the "
        "gain and the zero of the height sensor that follow, and state how sure these are as scale_std and "
        "datum_std in sonar0/sensor.yaml"
    )
