"""Path, keyframes and links of an estimate as the page's script reads them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from backend.measurements import CONTRADICTED, UNPROVEN
from frontend.photographs import LoadsReduced
from frontend.workers import Workers
from slam.core.control_points import ControlReport
from slam.core.errors import one_line
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.streams import Frames, Image
from slam.core.units import length
from slam.report.answers.left_out import reason_in_words
from slam.report.facts import median_height_m
from slam.report.gaps import Gap
from slam.report.map_page.rasters import webp

Array = NDArray[np.float64]

MOST_LINKS = 4000
"""Links of a kind on the page: more hide the map. loops.csv and graph.g2o have all of them."""
MOST_POINTS = 6000
"""Points of the ground on the page: a mark every nine pixels of a map that fills a screen, 130 kB."""
_MOST_PICTURES = 120
_MOST_DECODED_PIXELS = 300_000_000
"""Pixels of the pictures that are decoded for the page: about three seconds on two cores."""
_PICTURE_PX = 200
_PICTURE_QUALITY = 60
_BRIGHTEST = 99.0
"""Percentile of the numbers of keyframes that has the brightest colour: few points are seen by far more."""
_COARSER = 1.1
_DIGITS = 6
"""Significant digits of coordinates: a millimetre in a kilometre."""


def keyframes(estimate: Estimate, flight: Flight | None, gaps: Sequence[Gap]) -> dict[str, Any]:
    """Return the placed keyframes: columns of equal length, with None where a value is not known.

    ``gaps`` are those of the path.
    """
    placed = np.flatnonzero(estimate.placed)
    x, y = estimate.w_T_b[placed, :2, 3].T
    z = estimate.over_floor_T_b[placed, 2, 3]
    variance = np.trace(estimate.covariances[placed, 3:, 3:], axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variance >= 0, variance, np.nan))
    time = estimate.stamps_s[placed] - estimate.stamps_s[0]
    behind_gaps = {gap.j for gap in gaps}
    return {
        "number": placed.tolist(),
        "name": [estimate.frame_names[k] if k < len(estimate.frame_names) else "" for k in placed.tolist()],
        "x": _rounded(x),
        "y": _rounded(y),
        "height": _rounded(z - estimate.floor_z_m),
        "time": _rounded(time) if flight is not None else [None] * len(placed),
        "sigma": _rounded(sigma),
        "part": estimate.component[placed].tolist(),
        "unseen": [k in behind_gaps for k in placed.tolist()],
        "picture": dict(_pictures(estimate, flight, placed)) if flight is not None else {},
    }


def links(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """Return the links by kind, of which a rejection's is its verdict: pairs of keyframe numbers, why they
    were rejected, and how many there are."""
    placed = estimate.placed
    height_m = median_height_m(estimate)
    edges = {"odometry": list[Any](), "loop": list[Any]()}
    for edge in estimate.relative_poses:
        if edge.kind in edges:  # no pictures link the ends of a bridge by instruments
            edges[edge.kind].append((edge.i, edge.j, ""))
    rejected = {CONTRADICTED: list[Any](), UNPROVEN: list[Any]()}
    for loop in estimate.loops:
        if loop.rejection:
            why = reason_in_words(loop.rejection, height_m)
            rejected[loop.finding].append((loop.i, loop.j, why))
    found = {}
    for kind, pairs in {**edges, **rejected}.items():
        shown = [pair for pair in pairs if placed[pair[0]] and placed[pair[1]]]
        some = shown[:: max(1, -(-len(shown) // MOST_LINKS))]
        found[kind] = {"count": len(pairs), "pairs": some}
    return found


def surveyed_points(report: ControlReport | None) -> list[dict[str, Any]]:
    """Return the control and check points that were surveyed on the ground of the map, in words."""
    found = []
    for point in () if report is None else report.points:
        if point.surveyed_m is None:
            continue
        role = f"{'Control' if point.role == 'control' else 'Check'} point {one_line(point.name)}"
        off = np.isfinite(point.distance_m)
        lines = [f"the map has it {length(point.distance_m)} from its survey"] if off else []
        lines += [f"not used: {one_line(point.reason)}"] if point.reason else []
        x, y, _ = point.surveyed_m
        found.append({"x": x, "y": y, "words": [role, *lines]})
    return found


def floor_points(estimate: Estimate) -> dict[str, Any] | None:
    """Return the points of the ground, thinned evenly over it; None where there are none.

    ``data`` holds rows of x, y, height over the floor and number of keyframes, float32 in base64.
    """
    found = estimate.floor_points
    if found is None:
        return None
    place = found.on_map(estimate.w_T_b)
    known = np.isfinite(place).all(axis=1)
    place, views = place[known], found.views[known]
    if len(place) == 0:
        return None
    chosen = spread(place[:, :2], views, MOST_POINTS)
    height = place[chosen, 2] - estimate.floor_z_m
    rows = np.column_stack([place[chosen, :2], height, views[chosen]]).astype("<f4")
    return {
        "count": len(place),
        "high": max(float(np.percentile(views[chosen], _BRIGHTEST)), 3.0),
        "data": base64.b64encode(rows.tobytes()).decode("ascii"),
    }


def spread(xy: Array, weight: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return the numbers of at most ``most`` points (t, 2): from each square cell the one of most weight."""
    if len(xy) <= most:
        return np.arange(len(xy))
    order = np.argsort(-weight, kind="stable")
    size = np.ptp(xy, axis=0)
    # A line of points has no area; the cells then share its length.
    cell = max(float(np.sqrt(np.prod(size) / most)), float(size.max()) / most, np.finfo(float).tiny)
    while True:
        _, first = np.unique(np.floor(xy[order] / cell), axis=0, return_index=True)
        if len(first) <= most:
            return np.sort(order[first])
        cell *= _COARSER


def _pictures(estimate: Estimate, flight: Flight, placed: NDArray[np.int64]) -> Iterator[tuple[str, str]]:
    """Yield number and small picture of keyframes spread evenly over the flight."""
    frames, camera = flight.frames, flight.camera
    if frames is None or camera is None or len(placed) == 0:
        return
    affordable = _MOST_DECODED_PIXELS // (camera.size_px[0] * camera.size_px[1])
    count = max(1, min(_MOST_PICTURES, affordable, len(placed)))
    chosen = placed[np.unique(np.linspace(0, len(placed) - 1, count).round().astype(int))].tolist()

    def small(shared: Frames, k: int) -> str | None:
        frame, load = int(estimate.frame_index[k]), shared.load
        picture = load.load_reduced(frame, _PICTURE_PX) if isinstance(load, LoadsReduced) else load(frame)
        return None if picture is None else _small(picture)

    for k, code in zip(chosen, Workers().map(small, frames, chosen), strict=True):
        if code is not None:
            yield str(k), code


def _small(picture: Image) -> str:
    factor = min(1.0, _PICTURE_PX / max(picture.shape[:2]))
    size = max(1, round(picture.shape[1] * factor)), max(1, round(picture.shape[0] * factor))
    return webp(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), _PICTURE_QUALITY)


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]
