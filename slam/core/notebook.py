"""HTML tables and pictures that notebooks show for an estimate or a flight."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, ORANGE

Array = NDArray[np.float64]

SIDE_PX, MARGIN_PX = 320, 8
MAX_POINTS, MAX_LOOPS = 300, 100
"""Limits of a picture: more keyframes or loops than these are thinned out, so that it takes a few kB."""


def table_html(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a table with two columns, the texts escaped."""
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
