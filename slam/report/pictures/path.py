"""Drawings of a path for a report as PNG: no global state, legible in print, colour-blind safe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from backend.measurements import CONTRADICTED, UNPROVEN
from slam.core.estimate import Estimate
from slam.core.plot_style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
    ground_labels,
    legend_below,
    new_figure,
    png,
    round_factor,
)
from slam.core.units import error_length, unit
from slam.evaluation.aligned_maps import chain_on_result
from slam.report.facts import heights_over_floor, is_placed
from slam.report.gaps import Gap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_MOST_KEPT, _MOST_REJECTED = 200, 60
"""Largest number of loops drawn: a thousand lines hide the map, and rejected loops lie right across it."""
_MOST_ELLIPSES = 60
_ELLIPSE_SHARE = 0.05
"""Ellipses are scaled until the median one spans at most this share of the map."""


def trajectory_picture(estimate: Estimate, gaps: Sequence[Gap] = (), before: str = "") -> bytes:
    """Draw the top view: path, 2-sigma ellipses, loops kept (solid) and rejected (dashed).

    Over ``gaps`` the path is dotted. ``before`` names ``chain_w_T_b``, which is then drawn behind.
    """
    figure, axes = new_figure(6.6, 6.4)
    known = is_placed(estimate)
    position = np.where(known[:, None], estimate.w_T_b[:, :3, 3], np.nan)
    if before:
        _path(axes, chain_on_result(estimate)[:, :3, 3], color=GREY, linewidth=0.9, label=before)
    _loops(axes, estimate, position)
    for part in range(int(estimate.component.max(initial=0)) + 1):
        own = np.where((estimate.component == part)[:, None], position, np.nan)
        _path(axes, _broken(own, gaps), color=BLUE, linewidth=1.6, label="path" if part == 0 else None)
    _dotted(axes, position[:, 0], position[:, 1], gaps)
    size = _ellipses(axes, estimate, position, known)
    if known.any():
        start = position[known][0]
        axes.plot(start[0], start[1], "o", color=BLUE, markersize=6, markerfacecolor="white", label="start")
    x, y = ground_labels(estimate.origin is not None, estimate.metric)
    axes.set(xlabel=x, ylabel=y)
    axes.set_aspect("equal", adjustable="datalim")
    if size:
        axes.plot([], [], "o", color=PURPLE, markerfacecolor="none", label=f"2σ ellipse{_drawn(size)}")
    legend_below(axes, columns=3)
    return png(figure)


def altitude_picture(estimate: Estimate, gaps: Sequence[Gap] = ()) -> bytes:
    """Draw the height above the floor over time, with its 2-sigma band and the height without loops.

    Over ``gaps`` the height is dotted, and the band is open.
    """
    figure, axes = new_figure(9.0, 3.2)
    time = estimate.stamps_s - estimate.stamps_s[0]
    height, sigma = heights_over_floor(estimate)
    before = estimate.odometry_w_T_b[:, 2, 3] - estimate.floor_z_m
    if np.isfinite(before).any():
        axes.plot(
            *_broken(np.column_stack([time, before]), gaps).T,
            color=GREY,
            linewidth=1.4,
            linestyle=(0, (5, 2)),
            zorder=2.5,
            label="without loops",
        )
    # The band is often narrower than a line, so the legend gives its size.
    known = sigma[np.isfinite(sigma)]
    size = (
        f" (typically ± {error_length(2 * float(np.median(known)), estimate.metric)})" if len(known) else ""
    )
    # Between the keyframes at both ends of a gap nothing is known of the uncertainty: a straight edge of the
    # band would claim that it stays small.
    edges = _broken(np.column_stack([time, height - 2 * sigma, height + 2 * sigma]), gaps)
    axes.fill_between(*edges.T, color=ORANGE, alpha=0.6, linewidth=0, label=f"± 2σ{size}")
    curve = _broken(np.column_stack([time, height]), gaps)
    axes.plot(curve[:, 0], curve[:, 1], color=BLUE, linewidth=1.2, label="height above the floor")
    _dotted(axes, time, height, gaps)
    axes.set_xlabel("time since the first keyframe [s]")
    axes.set_ylabel(f"height [{unit(estimate.metric)}]")
    legend_below(axes, columns=3)
    return png(figure)


def _path(axes: Axes, position: Array, **style: Any) -> None:
    if np.isfinite(position).any():
        axes.plot(position[:, 0], position[:, 1], **style)


def _broken(points: Array, gaps: Sequence[Gap]) -> Array:
    """Return the points (n, k) with a row of NaN behind each keyframe before a gap, which ends a line."""
    return np.insert(points, [gap.i + 1 for gap in gaps], np.nan, axis=0)


def _dotted(axes: Axes, x: Array, y: Array, gaps: Sequence[Gap]) -> None:
    label: str | None = "no usable picture"
    for gap in gaps:
        ends = [gap.i, gap.j]
        axes.plot(x[ends], y[ends], color=BLUE, linewidth=1.4, linestyle=(0, (1, 2)), label=label)
        label = None


def _loops(axes: Axes, estimate: Estimate, position: Array) -> None:
    from matplotlib.collections import LineCollection

    kept = [(edge.i, edge.j) for edge in estimate.relative_poses if edge.kind == "loop"]
    contradicted = [(loop.i, loop.j) for loop in estimate.loops if loop.finding == CONTRADICTED]
    unproven = [(loop.i, loop.j) for loop in estimate.loops if loop.finding == UNPROVEN]
    for pairs, most, color, dash, alpha, what in (
        (unproven, _MOST_REJECTED, GREY, (0, (1, 2)), 1.0, UNPROVEN),
        (contradicted, _MOST_REJECTED, VERMILLION, (0, (4, 3)), 0.7, CONTRADICTED),
        (kept, _MOST_KEPT, GREEN, "-", 0.6, "kept"),
    ):
        shown = pairs[:: max(1, -(-len(pairs) // most))]
        some = f", {len(shown)} drawn" if len(shown) < len(pairs) else ""
        label = f"match {what} ({len(pairs)}{some})"
        lines = [(position[i, :2], position[j, :2]) for i, j in shown]
        lines = [line for line in lines if np.isfinite(line).all()]
        if lines:
            axes.add_collection(
                LineCollection(
                    lines, colors=color, linestyles=[dash], linewidths=0.8, alpha=alpha, label=label
                )
            )


def _drawn(size: float) -> str:
    if size == 1:
        return ""
    return f", enlarged {size:.0f} x" if size > 1 else f", reduced {1 / size:.0f} x"


def _ellipses(axes: Axes, estimate: Estimate, position: Array, placed: NDArray[np.bool_]) -> float:
    """Draw 2-sigma ellipses of the horizontal position; return the factor on their size, 0 if there are
    none."""
    from matplotlib.collections import EllipseCollection

    R = estimate.w_T_b[:, :3, :3]
    covariance = (R @ estimate.covariances[:, 3:, 3:] @ np.swapaxes(R, 1, 2))[:, :2, :2]
    known = np.flatnonzero(placed & np.isfinite(covariance).all(axis=(1, 2)))
    if len(known) == 0:
        return 0
    known = known[:: max(1, -(-len(known) // _MOST_ELLIPSES))]
    variance, direction = np.linalg.eigh(covariance[known])
    diameter = 4 * np.sqrt(np.maximum(variance, 0))
    typical = float(np.median(diameter[:, 1]))
    extent = float(np.ptp(position[placed][:, :2], axis=0).max())
    factor = round_factor(_ELLIPSE_SHARE * extent / typical) if typical > 0 else 1
    axes.add_collection(
        EllipseCollection(
            diameter[:, 1] * factor, diameter[:, 0] * factor,
            np.degrees(np.arctan2(direction[:, 1, 1], direction[:, 0, 1])),
            units="xy", offsets=position[known, :2], offset_transform=axes.transData,
            facecolors="none", edgecolors=PURPLE, linewidths=1.0, zorder=3,
        )
    )  # fmt: skip
    return factor
