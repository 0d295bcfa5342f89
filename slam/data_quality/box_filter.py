"""Likeliest boxes below the vehicle's path, by a multiple-hypothesis filter.

The residual is b + e over the floor and b - H + e over a box of height H. b is a random walk, e has Student's
tails, and each box has its own H. Several hypotheses of edges are followed, each with a filter of b and H.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from slam.core.arrays import Array

EDGE_NATS = 8.0
"""Cost of an edge at any place, in nats."""
SELDOM_NATS = 1.0
"""Cost of a beginning over a box, in nats."""
TINY_M = 1e-6
TAIL, LARGEST_OUTLIER_COST = 4.0, 12.0
"""Degrees of freedom of a reading's error, and its greatest cost in nats. It is less than that of two edges,
so that a false echo is no box."""
OUTLIER = 4.0
"""Standard deviations beyond which a reading does not update the filter, except at a new box."""
KEPT, KEPT_ENDS = 6, 2
"""Number of hypotheses kept, and number of those whose box may end at a reading."""
FIRST = 4
"""Number of readings that give the initial b of a segment."""


@dataclass(frozen=True)
class BoxNoise:
    """Noise of the residuals from reading to reading."""

    std_m: float
    drift_m: float
    """Drift of a height predicted without the sonar, in metres per reading."""


@dataclass(frozen=True)
class BoxHeights:
    """Gaussian prior of the heights of boxes."""

    mean_m: float = 0.15
    std_m: float = 0.12


@dataclass(frozen=True)
class BoxFit:
    """Likeliest boxes of a segment."""

    over_m: Array
    """(readings,) height of the box below, estimated at its end; 0 over the floor."""
    edges: list[int]
    """First reading after each edge."""
    nats: float
    """Log likelihood, ..."""
    level_nats: float
    """... and that of a level floor."""


class _Hypothesis(NamedTuple):
    """One hypothesis of the readings so far, and its filter of b and H."""

    cost: float
    b: float
    h: float
    p_bb: float
    p_bh: float
    p_hh: float
    boxed: bool = False
    before: Any = None
    """Previous segment: the reading at its end, its height, and the segment before it."""


def likeliest_boxes(height_m: Array, noise: BoxNoise, heights: BoxHeights) -> BoxFit:
    """Return the likeliest boxes below (readings,) residual heights."""
    noise_2, drift_2, spread_2 = noise.std_m**2, noise.drift_m**2, heights.std_m**2
    first, usual = float(np.median(height_m[:FIRST])), heights.mean_m
    level = _Hypothesis(0.0, first, 0.0, 4.0 * noise_2, 0.0, 0.0)
    on_box = _Hypothesis(
        SELDOM_NATS, first + usual, usual, 4.0 * noise_2 + spread_2, spread_2, spread_2, True
    )
    hypotheses = [level, on_box]
    for k, y in enumerate(height_m.tolist()):
        level = _update(_predict(level, drift_2), y, noise_2)
        moved = [_predict(hypothesis, drift_2) for hypothesis in hypotheses]
        boxed = [hypothesis for hypothesis in moved if hypothesis.boxed][:KEPT_ENDS]
        turned = [_enter_box(hypothesis, k, 0.0, heights) for hypothesis in moved if not hypothesis.boxed][:1]
        turned += [_enter_box(hypothesis, k, hypothesis.h, heights) for hypothesis in boxed[:1]]
        after = [_update(hypothesis, y, noise_2) for hypothesis in moved]
        after += [_update(hypothesis, y, noise_2, new=True) for hypothesis in turned]
        # A reading of the floor also updates the height of the previous box.
        landed = (_update(_leave_box(hypothesis), y, noise_2) for hypothesis in boxed)
        after += [hypothesis._replace(before=(k, hypothesis.h, hypothesis.before)) for hypothesis in landed]
        hypotheses = sorted(after, key=attrgetter("cost"))[:KEPT]
    best = hypotheses[0]
    over = np.full(len(height_m), max(best.h, TINY_M) if best.boxed else 0.0)
    edges, before = [], best.before
    while before is not None:
        end, height, before = before
        edges.append(end)
        over[:end] = max(height, TINY_M) if height else 0.0
    return BoxFit(over, [k for k in reversed(edges) if k > 0], -best.cost, -level.cost)


def _predict(hypothesis: _Hypothesis, drift_2: float) -> _Hypothesis:
    return hypothesis._replace(p_bb=hypothesis.p_bb + drift_2)


def _enter_box(hypothesis: _Hypothesis, at: int, height_m: float, heights: BoxHeights) -> _Hypothesis:
    """Return the hypothesis over a new box, after a segment of ``height_m``."""
    return hypothesis._replace(
        cost=hypothesis.cost + EDGE_NATS, h=heights.mean_m, p_bh=0.0, p_hh=heights.std_m**2, boxed=True,
        before=(at, height_m, hypothesis.before),
    )  # fmt: skip


def _leave_box(hypothesis: _Hypothesis) -> _Hypothesis:
    """Return the hypothesis after the end of its box."""
    return hypothesis._replace(cost=hypothesis.cost + EDGE_NATS, boxed=False)


def _update(hypothesis: _Hypothesis, y: float, noise_2: float, new: bool = False) -> _Hypothesis:
    """Return the hypothesis after one more reading; ``new`` marks the first reading over a box."""
    cost, b, h, p_bb, p_bh, p_hh, boxed, before = hypothesis
    k_b, k_h = (p_bb - p_bh, p_bh - p_hh) if boxed else (p_bb, p_bh)
    s = (k_b - k_h if boxed else k_b) + noise_2
    off = y - (b - h if boxed else b)
    z_2 = off * off / s
    outlier_cost = min(0.5 * (TAIL + 1.0) * math.log1p(z_2 / TAIL), LARGEST_OUTLIER_COST)
    cost += outlier_cost + 0.5 * math.log(s / noise_2)
    if z_2 > OUTLIER**2 and not new:
        return hypothesis._replace(cost=cost)
    k_b, k_h = k_b / s, k_h / s
    if boxed and h + k_h * off < 0.0:
        # A box cannot increase the range.
        cost += EDGE_NATS
    return _Hypothesis(
        cost, b + k_b * off, h + k_h * off, p_bb - k_b * k_b * s, p_bh - k_b * k_h * s,
        p_hh - k_h * k_h * s, boxed, before,
    )  # fmt: skip
