"""The likeliest boxes below a way: b + e is read over the floor, b - H + e over a box of height H.

b is a random walk, e has Student's tails, and H is each box's own. Several ways of coming and going are
followed at once, each with its own filter of b and H.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EDGE_NATS = 8.0
"""What an edge costs, wherever it may be."""
SELDOM_NATS = 1.0
"""What it costs to begin over a box."""
TINY_M = 1e-6
TAIL, MOST_ODD = 4.0, 12.0
"""Degrees of freedom of a reading's error, and the most that one costs: less than two edges, so that an echo
from elsewhere is no box."""
ODD = 4.0
"""Standard deviations beyond which a reading tells the filter nothing, but of a box that was not seen yet."""
KEPT, KEPT_ENDS = 6, 2
"""Ways that are followed, and those of them whose box may end at a reading."""
FIRST = 4
"""Readings that say where a stretch begins."""


@dataclass(frozen=True)
class Noise:
    """From reading to reading."""

    std_m: float
    drift_m: float
    """That a height predicted without the sonar goes astray."""


@dataclass(frozen=True)
class Heights:
    """Of boxes, before one is seen: Gaussian."""

    mean_m: float = 0.15
    std_m: float = 0.12


@dataclass(frozen=True)
class Ways:
    """The likeliest boxes of a stretch."""

    over_m: Array
    """(readings,) height of the box below, as it is known at its end; 0 over the floor."""
    edges: list[int]
    """First reading after each."""
    nats: float
    """Log likelihood, ..."""
    level_nats: float
    """... and that of a level floor."""


class _Way(NamedTuple):
    """One way through the readings so far, and its filter of b and H."""

    cost: float
    b: float
    h: float
    p_bb: float
    p_bh: float
    p_hh: float
    boxed: bool = False
    before: Any = None
    """Of each stretch before: the reading it ended at, its height, and the same of what was before."""


def likeliest(height_m: Array, noise: Noise, heights: Heights) -> Ways:
    """Of (readings,) heights beside those predicted."""
    noise_2, drift_2, spread_2 = noise.std_m**2, noise.drift_m**2, heights.std_m**2
    first, usual = float(np.median(height_m[:FIRST])), heights.mean_m
    level = _Way(0.0, first, 0.0, 4.0 * noise_2, 0.0, 0.0)
    on_box = _Way(SELDOM_NATS, first + usual, usual, 4.0 * noise_2 + spread_2, spread_2, spread_2, True)
    ways = [level, on_box]
    for k, y in enumerate(height_m.tolist()):
        level = _met(_moved(level, drift_2), y, noise_2)
        moved = [_moved(way, drift_2) for way in ways]
        boxed = [way for way in moved if way.boxed][:KEPT_ENDS]
        turned = [_entered(way, k, 0.0, heights) for way in moved if not way.boxed][:1]
        turned += [_entered(way, k, way.h, heights) for way in boxed[:1]]
        after = [_met(way, y, noise_2) for way in moved]
        after += [_met(way, y, noise_2, new=True) for way in turned]
        # What is read of the floor tells the height of the box before, too.
        landed = (_met(_left(way), y, noise_2) for way in boxed)
        after += [way._replace(before=(k, way.h, way.before)) for way in landed]
        ways = sorted(after, key=attrgetter("cost"))[:KEPT]
    best = ways[0]
    over = np.full(len(height_m), max(best.h, TINY_M) if best.boxed else 0.0)
    edges, before = [], best.before
    while before is not None:
        end, height, before = before
        edges.append(end)
        over[:end] = max(height, TINY_M) if height else 0.0
    return Ways(over, [k for k in reversed(edges) if k > 0], -best.cost, -level.cost)


def _moved(way: _Way, drift_2: float) -> _Way:
    return way._replace(p_bb=way.p_bb + drift_2)


def _entered(way: _Way, at: int, height_m: float, heights: Heights) -> _Way:
    """Over a box of some height, beyond what was ``height_m`` high."""
    return way._replace(
        cost=way.cost + EDGE_NATS, h=heights.mean_m, p_bh=0.0, p_hh=heights.std_m**2, boxed=True,
        before=(at, height_m, way.before),
    )  # fmt: skip


def _left(way: _Way) -> _Way:
    """Beyond the box."""
    return way._replace(cost=way.cost + EDGE_NATS, boxed=False)


def _met(way: _Way, y: float, noise_2: float, new: bool = False) -> _Way:
    """The way after one more reading, less its height over a box (``new``: over it for the first time)."""
    cost, b, h, p_bb, p_bh, p_hh, boxed, before = way
    k_b, k_h = (p_bb - p_bh, p_bh - p_hh) if boxed else (p_bb, p_bh)
    s = (k_b - k_h if boxed else k_b) + noise_2
    off = y - (b - h if boxed else b)
    z_2 = off * off / s
    odd = min(0.5 * (TAIL + 1.0) * math.log1p(z_2 / TAIL), MOST_ODD)
    cost += odd + 0.5 * math.log(s / noise_2)
    if z_2 > ODD**2 and not new:
        return way._replace(cost=cost)
    k_b, k_h = k_b / s, k_h / s
    if boxed and h + k_h * off < 0.0:
        # Over a box nothing is farther away.
        cost += EDGE_NATS
    return _Way(
        cost, b + k_b * off, h + k_h * off, p_bb - k_b * k_b * s, p_bh - k_b * k_h * s,
        p_hh - k_h * k_h * s, boxed, before,
    )  # fmt: skip
