"""The answer how accurate a distance or an area on the map is, and how that grows with its size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.estimate import Estimate
from slam.core.units import SPACE, error_length, percent, round_length
from slam.report.answers.accuracy import uncounted
from slam.report.facts import Facts
from slam.report.mosaic_facts import MosaicFacts

if TYPE_CHECKING:
    from slam.core.summary import Summary

_SIZES_M = tuple(one * 10.0**ten for ten in range(-1, 4) for one in (1, 2, 5))
"""Lengths of which examples are taken, from 0.1 m to 5 km."""
_LITTLE = 0.1
"""Share of a standard deviation whose square is a hundredth of the variance."""
_EXAMPLES = 3
"""Number of examples: the growth with the length shows in three."""


def distance(estimate: Estimate, facts: Facts, summary: Summary, mosaic: MosaicFacts | None) -> str:
    """Return how accurate a distance between two points of the mosaic is, and an area."""
    if not facts.metric:
        return "In metres not at all: no sensor measured a length. Ratios of distances are right."
    if not np.isfinite(facts.sigma_median_m):
        return "Not known."
    if not known(estimate):
        return _at_most(estimate, facts, mosaic) + uncounted(summary)
    examples = example_lengths(estimate, float(np.hypot(*facts.extent_m)))
    longest_m = examples[-1]
    stds = [length_std(estimate, size_m) for size_m in examples]
    text = "; ".join(
        f"{round_length(size_m)} apart: ±{SPACE}{error_length(typical_m)} "
        f"(badly placed ones: ±{SPACE}{error_length(worst_m)})"
        for size_m, (typical_m, worst_m) in zip(examples, stds, strict=True)
    )
    typical_m = stds[-1][0]
    by_scale_m = facts.scale_std * longest_m
    rest_m = float(np.sqrt(max(typical_m**2 - by_scale_m**2, 0.0)))
    sides = (round_length(size_m) for size_m in examples)
    shares = (area_share(estimate, facts, size) for size in examples)
    areas = "; ".join(
        f"{side} x {side}: ±{SPACE}{percent(share)}" for side, share in zip(sides, shares, strict=True)
    )
    rest = f"the rest, ±{SPACE}{error_length(rest_m)}" if rest_m > _LITTLE * typical_m else "almost nothing"
    why = (
        f"Of the longest, the scale causes ±{SPACE}{error_length(by_scale_m)} "
        f"({percent(facts.scale_std)} of any length), and the places of both ends {rest}."
        if facts.scale_std
        else "It is caused by the places of both ends."
    )
    moves = "" if facts.relative_to else " What moves the whole map on Earth does not change a distance."
    ground = estimate.ground
    heights = " whose heights were measured" if ground is not None and ground.is_measured_in_part else ""
    uneven = ground is not None and ground.relief_share > 0
    level = " Distances on the map are level ones: hold the tape level, too." if uneven else ""
    check = f"if several differ by more, the map or the tape is wrong.{level}"
    return (
        f"Two places on the map{heights} that are {text}. This is one standard deviation; one distance "
        f"in 20 is less certain than the figure in brackets.{uncounted(summary)} {why}{moves} A tape over "
        f"{round_length(longest_m)} differs from the map by less than {error_length(2 * typical_m)} (badly "
        f"placed: {error_length(2 * stds[-1][1])}) nineteen times out of twenty: {check} "
        f"The area of a square, one standard deviation: {areas}. The scale counts "
        "twice in an area; the places of the corners count less on larger areas. map.html measures "
        "any distance and area with its uncertainty."
    )


def known(estimate: Estimate) -> bool:
    """Return whether the accuracy of distances follows from the joint covariance of their ends."""
    return len(estimate.length_stds) > 0 and bool(np.isfinite(estimate.length_stds).all())


def length_std(estimate: Estimate, length_m: float) -> tuple[float, float]:
    """Return the standard deviation of a typical and of a badly known distance of this length.

    Shorter ones than those of the table count as its shortest, longer ones grow in proportion.
    """
    lengths, *stds = np.array(estimate.length_stds).T
    beyond = max(length_m / lengths[-1], 1.0)
    typical_m, worst_m = (float(beyond * np.interp(length_m, lengths, std)) for std in stds)
    return typical_m, worst_m


def area_share(estimate: Estimate, facts: Facts, side_m: float) -> float:
    """Return the relative standard deviation of the area of a square whose sides are typical distances.

    What is not the scale is split between both ends of a side. Each corner moves the area by half of a
    diagonal, four corners by the root of two of a side.
    """
    of_side = length_std(estimate, side_m)[0] / side_m
    by_ends = np.sqrt(max(of_side**2 - facts.scale_std**2, 0.0))
    return float(np.hypot(2 * facts.scale_std, by_ends))


def example_lengths(estimate: Estimate, widest_m: float) -> tuple[float, ...]:
    """Return round lengths from the shortest of the table of a map to the longest on it."""
    lengths = np.array(estimate.length_stds)[:, 0]
    longest_m = max(lengths[-1], widest_m)
    inside = [size for size in _SIZES_M if lengths[0] / 2 <= size <= longest_m] or [float(lengths[-1])]
    picked = np.unique(np.linspace(0, len(inside) - 1, _EXAMPLES).round().astype(int))
    return tuple(inside[index] for index in picked.tolist())


def _at_most(estimate: Estimate, facts: Facts, mosaic: MosaicFacts | None) -> str:
    """Return the accuracy of a distance whose ends have no joint covariance.

    The places of both ends contain the scale.
    """
    end_m, worst_end_m = _ends(estimate, facts, mosaic)
    ends, worst_ends = (f"±{SPACE}{facts.error(np.sqrt(2) * each)}" for each in (end_m, worst_end_m))
    moves = "" if facts.relative_to else " What moves the whole map on Earth does not change a distance."
    return (
        f"A distance between two far places is typically known to about {ends}, and to {worst_ends} "
        f"where both are least certain; one between near places better.{moves} map.html measures any "
        "distance and area with its uncertainty."
    )


def _ends(estimate: Estimate, facts: Facts, mosaic: MosaicFacts | None) -> tuple[float, float]:
    """Return the standard deviation of an end of a distance: a typical one and the least certain one."""
    if mosaic is None or not np.isfinite(mosaic.typical_std_m):
        return facts.sigma_median_m, facts.sigma_max_m
    common_m = estimate.middle_std_m or 0.0  # what moves the whole ground moves both ends
    typical_m, worst_m = (float(np.sqrt(max(std_m**2 - common_m**2, 0.0))) for std_m in mosaic.ground_std_m)
    return typical_m, worst_m
