"""Steps in the floor: boxes of any height under the way, or pits in it.

The height is predicted without the sonar. What the sonar reads beside it drifts slowly over a level floor,
b + e with a random walk b, and is less by a height H as long as a box is below. Where boxes begin and end is
the likeliest of all comings and goings (Viterbi), each way with its own filter of b and H. Spikes come back
at once; what a lag, a scale, a tilt or a slope makes goes with height, climb, tilt or place, and is taken out
before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam.criticism.cause import Interval
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.setting import Setting
from slam.criticism.residuals.oddities import Oddity, foretold
from slam.criticism.threads import in_threads
from slam.simulation.dynamics import PITCH, ROLL, VX, VY, VZ, X, Y, Z

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

USUAL_M, SPREAD_M = 0.15, 0.12
"""Heights of boxes before any was seen."""
EDGE_NATS = 8.0
"""What an edge costs, of a height that nobody knows."""
SELDOM_NATS = 1.0
"""What it costs to begin over a box."""
TINY_M = 1e-6
LEAST_NOISE_M = 1e-4
DRIFTS_M = (1e-3, 2e-3, 4e-3, 8e-3)
"""From reading to reading: how far a height predicted without the sonar may go astray."""
TAIL = 4.0
"""Degrees of freedom of a reading's error: so no odd reading is a box."""
ODD = 4.0
"""Standard deviations beyond which a reading tells the filter nothing."""
FEWEST_EDGES, FEWEST_READINGS = 4, 20
LEAST_NATS = 25.0
SHARP = 0.6
"""Share of an edge that lies between two readings in a row, in the mean over all."""
SHORTEST = 4
"""Readings over a box, in the median: spikes are shorter."""
LOWEST_M = 0.3
"""Nearer to the floor the gear and the sonar's own limit make edges."""
LONGEST_GAP_S = 0.2
KEPT, KEPT_ENDS = 6, 2
"""Ways that are followed, and those of them whose box may end at a reading."""
APART = 10
"""Readings apart whose differences tell what a drift, and what goes with the motion, is."""
REJECTED, ROUNDS = 4.7, 5
"""Of a robust standard deviation (Tukey's biweight)."""


@dataclass(frozen=True)
class _Beside:
    """Of one flight: what its sonar reads beside a height predicted without it."""

    rows: Ints
    """(readings,) events, in the air; ..."""
    begins: tuple[int, ...]
    """... and where stretches without a gap begin among them."""
    height_m: Array
    """(readings,) less what goes with the motion."""
    changes_m: Array
    """Of it, from one reading to the next."""


@dataclass(frozen=True)
class _Boxes:
    """The likeliest boxes of one flight."""

    over_m: Array
    """(readings,) height of the box below; 0 over the floor."""
    edges: Ints
    """(edges,) index of the first reading after each."""
    rise_m: Array
    """(edges,) change of ``over_m`` there."""
    nats: float
    """Log likelihood, ..."""
    level_nats: float
    """... and that of a level floor."""

    @property
    def gain_nats(self) -> float:
        """What the boxes explain."""
        return self.nats - self.level_nats


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


def without_boxes(records: Sequence[Record], setting: Setting) -> tuple[list[Record], list[Oddity]]:
    """The records with ranges as over a level floor, and the steps where there are some."""
    beside = in_threads(lambda record: _beside(record, setting), records)
    noise_m = max(_scale(np.concatenate([b.changes_m for b in beside])) / math.sqrt(2.0), LEAST_NOISE_M)
    sign, boxes = 1.0, _found(beside, noise_m, 1.0)
    if _share(boxes) > 0.5:
        # What most readings of all flights are over is the floor, and there are pits in it.
        sign, boxes = -1.0, _found(beside, noise_m, -1.0)
    if not _are_boxes(beside, boxes, sign):
        return list(records), []
    heights = [np.abs(found.rise_m) for found in boxes]
    every = np.concatenate(heights)
    share, std = _share(boxes), float(every.std() / np.sqrt(len(every)))
    spread = float(np.sqrt(share * (1.0 - share) / len(every)))
    height = float(every.mean())
    parameters = {
        "height": Interval(height, "m", height - 1.96 * std, height + 1.96 * std),
        "share": Interval(share, "1", max(share - 1.96 * spread, 0.0), min(share + 1.96 * spread, 1.0)),
    }

    def by_others(own: Array, others: Sequence[Array]) -> float:
        """Nats of the flight's edges for edges of such heights as the others' have."""
        known = np.concatenate(others)
        if len(known) < 2:
            return 0.0
        wide = math.hypot(float(known.std()), noise_m)
        gain = _surprise(own / noise_m) - _surprise((own - known.mean()) / wide) - np.log(wide / noise_m)
        return float(np.sum(gain)) - EDGE_NATS * len(own)

    nats = tuple(found.gain_nats for found in boxes)
    levelled = [
        _levelled(r, seen, sign * found.over_m) for r, seen, found in zip(records, beside, boxes, strict=True)
    ]
    return levelled, [Oddity("floor_steps", parameters, nats, foretold(heights, by_others))]


def _are_boxes(beside: Sequence[_Beside], boxes: Sequence[_Boxes], sign: float) -> bool:
    """Whether what was found is enough, sharp, and no spikes."""
    if sum(len(found.edges) for found in boxes) < FEWEST_EDGES:
        return False
    jumps = np.concatenate(
        [-sign * (s.height_m[f.edges] - s.height_m[f.edges - 1]) for s, f in zip(beside, boxes, strict=True)]
    )
    rises = np.concatenate([found.rise_m for found in boxes])
    stays = np.concatenate([_stays(found) for found in boxes])
    return bool(
        sum(found.gain_nats for found in boxes) > LEAST_NATS
        and jumps @ rises > SHARP * (rises @ rises)
        and len(stays)
        and np.median(stays) >= SHORTEST
    )


def _share(boxes: Sequence[_Boxes]) -> float:
    over = np.concatenate([found.over_m for found in boxes])
    return float(np.mean(over > 0.0)) if len(over) else 0.0


def _stays(found: _Boxes) -> Array:
    """Readings over each box."""
    ends = np.append(found.edges, len(found.over_m))
    return np.diff(ends)[found.over_m[found.edges] > 0.0]


def _beside(record: Record, setting: Setting) -> _Beside:
    sonar = record.kinds == SONAR
    rows = np.flatnonzero(sonar & np.isfinite(record.values[:, 0]))
    blind = record.values.copy()
    blind[sonar] = np.nan
    states = whole(replace(record, values=blind), setting).states[rows]
    upright = np.cos(states[:, ROLL]) * np.cos(states[:, PITCH])
    high = record.values[rows, 0] > LOWEST_M
    rows, states, upright = rows[high], states[high], upright[high]
    apart = np.diff(record.times_s[rows], prepend=-np.inf) > LONGEST_GAP_S
    begins = tuple(np.flatnonzero(apart).tolist())
    none = _Beside(rows[:0], (), np.zeros(0), np.zeros(0))
    height = record.values[rows, 0] * upright - states[:, Z]
    elapsed = record.times_s[rows] / record.duration_s
    motion = np.column_stack(
        [
            states[:, [Z, VZ, ROLL, PITCH, X, Y]],
            record.stick.at(record.times_s[rows])[:, 2], elapsed, elapsed**2,
            states[:, ROLL] ** 2 + states[:, PITCH] ** 2, np.hypot(states[:, VX], states[:, VY]),
        ]
    )  # fmt: skip
    together = np.cumsum(apart)
    same = together[APART:] == together[:-APART]
    if same.sum() < FEWEST_READINGS:
        return none
    height = height - motion @ _robust_fit(
        (motion[APART:] - motion[:-APART])[same], _later(height, APART)[same]
    )
    return _Beside(rows, begins, height, _later(height, 1)[together[1:] == together[:-1]])


def _later(x: Array, count: int) -> Array:
    """(n - count,) changes over so many readings."""
    return np.asarray(x[count:] - x[:-count])


def _robust_fit(table: Array, values: Array) -> Array:
    """Coefficients of the columns, whatever a part of the values is (iterated least squares)."""
    scale = np.sqrt(np.mean(table**2, axis=0)) + 1e-12
    weight = np.ones(len(values))
    found = np.zeros(table.shape[1])
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(table / scale * root[:, None], values * root, rcond=1e-9)[0] / scale
        miss = values - table @ found
        weight = np.clip(1.0 - (miss / (REJECTED * _scale(miss))) ** 2, 0.0, None) ** 2
    return found


def _scale(x: Array) -> float:
    """Robust standard deviation."""
    return float(np.median(np.abs(x - np.median(x))) / 0.6745) + 1e-9 if len(x) else 1e-9


def _surprise(z: Array) -> Array:
    """Nats that errors of so many standard deviations cost."""
    return np.asarray(0.5 * (TAIL + 1.0) * np.log1p(z * z / TAIL))


def _found(beside: Sequence[_Beside], noise_m: float, sign: float) -> list[_Boxes]:
    """The likeliest boxes (``sign`` 1) or pits (-1), whatever the drift; a level floor may have another."""
    tried = [[_boxes(seen, noise_m, drift_m, sign) for seen in beside] for drift_m in DRIFTS_M]
    best = max(tried, key=lambda found: sum(f.nats for f in found))
    level = max(tried, key=lambda found: sum(f.level_nats for f in found))
    return [replace(f, level_nats=flat.level_nats) for f, flat in zip(best, level, strict=True)]


def _boxes(seen: _Beside, noise_m: float, drift_m: float, sign: float) -> _Boxes:
    over, nats, level_nats = np.zeros(len(seen.rows)), 0.0, 0.0
    edges: list[int] = []
    for begin, end in zip(seen.begins, (*seen.begins[1:], len(seen.rows)), strict=True):
        if end - begin < FEWEST_READINGS:
            continue
        found, first, costs = _likeliest(sign * seen.height_m[begin:end], noise_m**2, drift_m**2)
        over[begin:end] = found
        edges += [begin + k for k in first]
        nats, level_nats = nats - costs[0], level_nats - costs[1]
    at = np.array(edges, dtype=np.int64)
    return _Boxes(over, at, over[at] - over[at - 1], nats, level_nats)


def _likeliest(
    height_m: Array, noise_2: float, drift_2: float
) -> tuple[Array, list[int], tuple[float, float]]:
    """Heights of the boxes below each reading, where these change, and what they and a level floor cost."""
    first, spread_2 = float(np.median(height_m[:SHORTEST])), SPREAD_M**2
    level = _Way(0.0, first, 0.0, 4.0 * noise_2, 0.0, 0.0)
    on_box = _Way(SELDOM_NATS, first + USUAL_M, USUAL_M, 4.0 * noise_2 + spread_2, spread_2, spread_2, True)
    ways = [level, on_box]
    for k, y in enumerate(height_m.tolist()):
        level = _met(_moved(level, drift_2), y, noise_2)
        moved = [_moved(way, drift_2) for way in ways]
        boxed = [way for way in moved if way.boxed][:KEPT_ENDS]
        turned = [_entered(way, k, 0.0) for way in moved if not way.boxed][:1]
        turned += [_entered(way, k, way.h) for way in boxed[:1]]
        after = [_met(way, y, noise_2) for way in (*moved, *turned)]
        # What is read of the floor tells the height of the box before, too.
        landed = (_met(_left(way), y, noise_2) for way in boxed)
        after += [way._replace(before=(k, way.h, way.before)) for way in landed]
        ways = sorted(after, key=_cost)[:KEPT]
    best = ways[0]
    over, edges = np.full(len(height_m), max(best.h, TINY_M) if best.boxed else 0.0), []
    before = best.before
    while before is not None:
        end, height, before = before
        edges.append(end)
        over[:end] = max(height, TINY_M) if height else 0.0
    return over, [k for k in reversed(edges) if k > 0], (best.cost, level.cost)


def _moved(way: _Way, drift_2: float) -> _Way:
    return way._replace(p_bb=way.p_bb + drift_2)


def _entered(way: _Way, at: int, height_m: float) -> _Way:
    """Over a box of some height, beyond what was ``height_m`` high."""
    return way._replace(
        cost=way.cost + EDGE_NATS, h=USUAL_M, p_bh=0.0, p_hh=SPREAD_M**2, boxed=True,
        before=(at, height_m, way.before),
    )  # fmt: skip


def _left(way: _Way) -> _Way:
    """Beyond the box."""
    return way._replace(cost=way.cost + EDGE_NATS, boxed=False)


def _cost(way: _Way) -> float:
    return way.cost


def _met(way: _Way, y: float, noise_2: float) -> _Way:
    """The way after one more reading, less its height over a box; one that is far off tells it nothing."""
    cost, b, h, p_bb, p_bh, p_hh, boxed, before = way
    k_b, k_h = (p_bb - p_bh, p_bh - p_hh) if boxed else (p_bb, p_bh)
    s = (k_b - k_h if boxed else k_b) + noise_2
    off = y - (b - h if boxed else b)
    # As ``_surprise``, of one number.
    z_2 = off * off / s
    cost += 0.5 * ((TAIL + 1.0) * math.log1p(z_2 / TAIL) + math.log(s / noise_2))
    if z_2 > ODD**2:
        return way._replace(cost=cost)
    k_b, k_h = k_b / s, k_h / s
    if boxed and h + k_h * off < 0.0:
        # Over a box nothing is farther away.
        cost += EDGE_NATS
    return _Way(
        cost, b + k_b * off, h + k_h * off, p_bb - k_b * k_b * s, p_bh - k_b * k_h * s,
        p_hh - k_h * k_h * s, boxed, before,
    )  # fmt: skip


def _levelled(record: Record, seen: _Beside, over_m: Array) -> Record:
    values = record.values.copy()
    values[seen.rows, 0] += over_m
    return replace(record, values=values)
