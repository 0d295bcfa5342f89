"""Small HTML tables of an estimate and of a flight, as notebooks show them."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, ORANGE
from slam.core.units import length

if TYPE_CHECKING:
    from slam.core.estimate import Estimate
    from slam.core.flight import Flight

Array = NDArray[np.float64]

SIDE_PX, MARGIN_PX = 320, 8
MAX_POINTS, MAX_LOOPS = 300, 100
"""Limits of a picture: more keyframes or loops than these are thinned out, so that it takes a few kB."""


def estimate_html(estimate: Estimate) -> str:
    """Return a table with the main figures and a picture of the trajectory, keyframes and loops."""
    positions = estimate.w_T_b[estimate.placed, :3, 3]
    path_m = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()) if len(positions) else 0.0
    kept = [loop for loop in estimate.loops if loop.verdict == "kept"]
    rows = [
        ("status", estimate.status),
        ("keyframes", f"{len(positions)} of {len(estimate.stamps_s)} placed, from {estimate.frames} frames"),
        ("loops", f"{len(kept)} of {len(estimate.loops)} candidates kept"),
        ("path length", length(path_m, estimate.metric)),
        ("warnings", str(len(estimate.warnings))),
    ]
    loops = np.array([(loop.i, loop.j) for loop in kept], dtype=np.int64).reshape(-1, 2)
    return _table(f"Estimate {estimate.name}", rows) + trajectory_svg(estimate.w_T_b[:, :2, 3], loops)


def flight_html(flight: Flight) -> str:
    """Return a table with one row for each stream: number of rows, rate and duration."""
    from slam.core.flight_info import describe

    info = describe(flight)
    rows = [
        (s.name, f"{s.count} rows, {s.rate_hz:.3g} Hz, {s.duration_s:.1f} s" if s.count > 1 else "1 row")
        for s in info.streams
    ]
    rows.append(("warnings", str(len(info.warnings))))
    return _table(f"Flight {flight.name}, {info.duration_s:.1f} s", rows)


def _table(title: str, rows: list[tuple[str, str]]) -> str:
    lines = [f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows]
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"


def trajectory_svg(xy: Array, loops: NDArray[np.int64]) -> str:
    """Return a top view as inline SVG; empty where no keyframe is placed.

    ``xy`` (n, 2) are positions, NaN where unknown, and ``loops`` (l, 2) pairs of keyframes.
    """
    placed = np.asarray(np.isfinite(xy).all(axis=1))
    if not placed.any():
        return ""
    low, high = xy[placed].min(axis=0), xy[placed].max(axis=0)
    scale = (SIDE_PX - 2 * MARGIN_PX) / max(float((high - low).max()), 1e-9)
    px = (xy - low) * [scale, -scale] + [MARGIN_PX, MARGIN_PX + scale * (high - low)[1]]
    lines = loops[placed[loops].all(axis=1)]
    lines = lines[:: len(lines) // MAX_LOOPS + 1]
    points = np.flatnonzero(placed)
    points = points[:: len(points) // MAX_POINTS + 1]
    route = " ".join(f"{x:.1f},{y:.1f}" for x, y in px[points])
    chords = "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in px[lines])
    height = scale * float((high - low)[1]) + 2 * MARGIN_PX
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIDE_PX}" height="{height:.0f}">'
        f'<path d="{chords}" stroke="{ORANGE}" fill="none"/>'
        f'<polyline points="{route}" stroke="{BLUE}" fill="none"/>'
        f'<circle cx="{px[points[0]][0]:.1f}" cy="{px[points[0]][1]:.1f}" r="4" fill="{GREY}"/></svg>'
    )
