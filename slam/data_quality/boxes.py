"""Steps in the floor: boxes of any height below a vehicle's path, or pits.

The residual of a sonar against a height predicted without it drifts slowly over a level floor and is lower
over a box. A spike returns at once. The effects of a lag, a scale, a tilt or a slope depend on height, climb,
tilt or place, and are removed first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from frontend.robust import robust_std
from slam.core.arrays import Array, Ints
from slam.data_quality.box_filter import BoxHeights, BoxNoise, likeliest_boxes

LEAST_NOISE_M = 1e-4
DRIFTS_M = (1e-3, 2e-3, 4e-3, 8e-3)
"""Candidate drifts from reading to reading; the likelihood chooses one."""
FEWEST_EDGES, FEWEST_BOXES = 4, 2
LEAST_NATS = 25.0
SHARP = 0.6
"""Least mean share of an edge's height between two successive readings."""
SHORTEST_S = 0.22
"""Least median time over a box; spikes are shorter."""
LEAST_SPREAD_M = 0.02
"""Least spread of the heights of boxes, since few boxes hardly show it."""
ROUNDS = 2
"""Rounds in which the effects of the motion are fitted again with the boxes known."""
LONGEST_GAP_S, LONGEST_GAP = 0.2, 2.5
"""Longest gap within a segment, in seconds and in median intervals."""
APART = 10
"""Distance in readings of the differences from which the effects of the motion are fitted."""
FEWEST_READINGS = 20
REJECTED, FIT_ROUNDS = 4.7, 5
"""Rejection limit in robust standard deviations (Tukey's biweight), and rounds of the fit."""
TINY = 1e-12


@dataclass(frozen=True)
class RangeResiduals:
    """Residuals of one flight's sonar against a height predicted without it."""

    rows: Ints
    """(readings,) index of each reading in the air among all events of the flight."""
    times_s: Array
    off_m: Array
    """(readings,) measured minus predicted height, in metres."""
    motion: Array
    """(readings, signals) regressors for the errors of instruments and vehicle."""
    upright: Array
    """(readings,) ratio of height to range."""

    @cached_property
    def segments(self) -> list[slice]:
        """Segments without a gap, with at least ``FEWEST_READINGS`` readings."""
        between_s = np.diff(self.times_s)
        longest_s = max(LONGEST_GAP_S, LONGEST_GAP * float(np.median(between_s))) if len(between_s) else 0.0
        bounds = [0, *(np.flatnonzero(between_s > longest_s) + 1).tolist(), len(self.times_s)]
        return [slice(begin, end) for begin, end in pairwise(bounds) if end - begin >= FEWEST_READINGS]

    def without_motion(self, over_m: Array) -> Array:
        """Return (readings,) ``off_m`` without the effects of the motion; ``over_m`` is a known part."""
        later = [self.later(x, APART) for x in (self.motion, self.off_m - over_m)]
        return np.asarray(self.off_m - self.motion @ _robust_fit(*later))

    def later(self, x: Array, count: int) -> Array:
        """Return the changes over ``count`` readings within segments."""
        changes = [x[s][count:] - x[s][:-count] for s in self.segments]
        return np.concatenate([np.zeros((0, *x.shape[1:])), *changes])


@dataclass(frozen=True)
class Boxes:
    """Likeliest boxes of one flight."""

    seen: RangeResiduals
    height_m: Array
    """(readings,) residual height without the effects of the motion."""
    over_m: Array
    """(readings,) height of the box below; 0 over the floor."""
    edges: Ints
    """(edges,) index of the first reading after each."""
    nats: float
    """Log likelihood, ..."""
    level_nats: float
    """... and that of a level floor."""
    noise: BoxNoise
    sign: float
    """1 for boxes, -1 for pits."""

    @property
    def gain_nats(self) -> float:
        """Gain of the boxes over a level floor."""
        return self.nats - self.level_nats

    def at_edges(self, x: Array) -> Array:
        """Return the changes of (readings,) at the edges."""
        return np.asarray(x[self.edges] - x[self.edges - 1])

    @property
    def heights_m(self) -> Array:
        """(boxes,) height of each box that is entered."""
        over = self.over_m[self.edges]
        return np.asarray(over[over > 0.0])

    @property
    def stays_s(self) -> Array:
        """(boxes,) time over each box."""
        if not len(self.edges):
            return np.zeros(0)
        ends = np.append(self.edges, len(self.over_m) - 1)
        return np.asarray(np.diff(self.seen.times_s[ends])[self.over_m[self.edges] > 0.0])


def find_boxes(seen: Sequence[RangeResiduals]) -> list[Boxes]:
    """Return the boxes, or pits, of each flight; none where the floor is level in all of them."""
    boxes = _found(seen, 1.0)
    if share_over(boxes) > 0.5:
        # The level below most readings is the floor, so the others are pits.
        boxes = _found(seen, -1.0)
    return boxes if _are_boxes(boxes) else []


def nats_by_others(own: Boxes, others: Sequence[Boxes]) -> float:
    """Return the nats of the flight's boxes with the heights of the others' as prior."""
    known = np.concatenate([found.heights_m for found in others])
    if len(known) == 0 or len(own.edges) == 0:
        return 0.0
    usual = BoxHeights(float(known.mean()), math.hypot(float(known.std()), LEAST_SPREAD_M))
    return _boxes(own.seen, own.height_m, own.noise, own.sign, usual).nats - own.level_nats


def _are_boxes(boxes: Sequence[Boxes]) -> bool:
    """Return whether the boxes are enough, have sharp edges and are no spikes."""
    rises = np.concatenate([found.at_edges(found.over_m) for found in boxes])
    stays = np.concatenate([found.stays_s for found in boxes])
    heights = np.concatenate([found.heights_m for found in boxes])
    if len(rises) < FEWEST_EDGES or np.sum(heights > boxes[0].noise.std_m) < FEWEST_BOXES:
        return False
    jumps = np.concatenate([-found.sign * found.at_edges(found.height_m) for found in boxes])
    return bool(
        sum(found.gain_nats for found in boxes) > LEAST_NATS
        and jumps @ rises > SHARP * (rises @ rises)
        and np.median(stays) >= SHORTEST_S
    )


def share_over(boxes: Sequence[Boxes]) -> float:
    """Return the share of all readings that are over a box."""
    over = np.concatenate([found.over_m for found in boxes])
    return float(np.mean(over > 0.0)) if len(over) else 0.0


def _found(seen: Sequence[RangeResiduals], sign: float) -> list[Boxes]:
    """Return the likeliest boxes (``sign`` 1) or pits (-1) over all drifts; a level floor has its own."""
    over, levels = [np.zeros(len(flight.rows)) for flight in seen], []
    for _ in range(ROUNDS):
        heights = [flight.without_motion(-sign * o) for flight, o in zip(seen, over, strict=True)]
        flown = list(zip(seen, heights, strict=True))
        jumps = np.concatenate([flight.later(height, 1) for flight, height in flown])
        std_m = max(robust_std(jumps) / math.sqrt(2.0), LEAST_NOISE_M) if len(jumps) else LEAST_NOISE_M
        tried = [[_boxes(*of, BoxNoise(std_m, drift_m), sign) for of in flown] for drift_m in DRIFTS_M]
        found = max(tried, key=lambda boxes: sum(f.nats for f in boxes))
        levels.append(max(tried, key=_level_nats))
        over = [boxes.over_m for boxes in found]
        if not any(len(boxes.edges) for boxes in found):
            break
    level = max(levels, key=_level_nats)
    return [replace(f, level_nats=flat.level_nats) for f, flat in zip(found, level, strict=True)]


def _level_nats(boxes: Sequence[Boxes]) -> float:
    return sum(found.level_nats for found in boxes)


def _boxes(
    seen: RangeResiduals, height_m: Array, noise: BoxNoise, sign: float, heights: BoxHeights = BoxHeights()
) -> Boxes:
    over, nats, level_nats = np.zeros(len(height_m)), 0.0, 0.0
    edges: list[int] = []
    for segment in seen.segments:
        fit = likeliest_boxes(sign * height_m[segment], noise, heights)
        over[segment] = fit.over_m
        edges += [segment.start + k for k in fit.edges]
        nats, level_nats = nats + fit.nats, level_nats + fit.level_nats
    return Boxes(seen, height_m, over, np.array(edges, dtype=np.int64), nats, level_nats, noise, sign)


def _robust_fit(table: Array, values: Array) -> Array:
    """Return the coefficients of the columns by robust, iterated least squares."""
    found, weight = np.zeros(table.shape[1]), np.ones(len(values))
    if len(values) < 2 * table.shape[1]:
        return found
    scale = np.sqrt(np.mean(table**2, axis=0)) + TINY
    for _ in range(FIT_ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(table / scale * root[:, None], values * root, rcond=1e-9)[0] / scale
        miss = values - table @ found
        weight = np.clip(1.0 - (miss / (REJECTED * robust_std(miss) + TINY)) ** 2, 0.0, None) ** 2
    return found
