"""Steps in the floor: the range falls from one reading to the next, and later rises by as much.

The height is predicted without the sonar; what the sonar reads beside it drifts slowly over a level floor and
jumps at the edges of boxes. Spikes come back at once, and their size differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.cause import Interval
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import RANGE, SONAR
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.setting import Setting
from slam.criticism.residuals.oddities import Oddity, foretold
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BESIDE = 5
"""Readings before and after an edge whose medians are compared."""
SHARP = 5.0
"""An edge is so many standard deviations of a reading high."""
MOST_OF_IT = 0.5
"""Share of an edge that lies between two readings in a row."""
FEWEST_EDGES = 3
SAME_HEIGHT = 0.7
"""Share of the edges that must have one height."""
MOST_JUMPS = 3.0
"""Jumps of that height for each edge: spikes jump there and back again."""
LOWEST_M = 0.3
"""Nearer to the floor the gear and the sonar's own limit make edges."""
LONGEST_GAP_S = 0.2
EDGE_NATS, MOST_MISS = 5.0, 20.0
"""What an edge costs, and the most that one odd reading does."""


@dataclass(frozen=True)
class _Edges:
    """Of one flight."""

    rows: Ints
    """(readings,) events of the sonar's readings."""
    at: Ints
    """(edges,) index of the first reading after each."""
    height_m: Array
    """(edges,) rise of the range."""
    jump_m: Array
    """(readings,) rise of the range beside its prediction from one reading to the next."""


def without_boxes(records: Sequence[Record], setting: Setting) -> tuple[list[Record], list[Oddity]]:
    """The records with ranges as over a level floor, and the steps where there are some."""
    edges = in_threads(lambda record: _edges(record, setting), records)
    heights = np.concatenate([e.height_m for e in edges])
    if len(heights) < FEWEST_EDGES or heights.min() > 0 or heights.max() < 0:
        return list(records), []
    height = float(np.median(np.abs(heights)))
    noise = float(np.median([r.noise_std[RANGE] for r in records]))
    same = np.abs(np.abs(heights) - height) < np.maximum(3.0 * noise, 0.15 * height)
    if same.sum() < max(FEWEST_EDGES, SAME_HEIGHT * len(heights)):
        return list(records), []
    height = float(np.abs(heights[same]).mean())
    jumps = np.concatenate([e.jump_m for e in edges])
    if np.sum(np.abs(np.abs(jumps) - height) < 0.3 * height) > MOST_JUMPS * len(heights):
        return list(records), []
    above = [_above(e, height, noise) if len(e.at) else np.zeros(len(e.rows)) for e in edges]
    share = float(np.concatenate(above).mean())
    if share > 0.5:
        # What most readings of all flights are over is the floor, and there are pits in it.
        above, share = [a - 1.0 for a in above], 1.0 - share
    std = float(np.abs(heights[same]).std() / np.sqrt(same.sum()))
    spread = np.sqrt(share * (1 - share) / max(len(heights), 1))
    parameters = {
        "height": Interval(height, "m", height - 1.96 * std, height + 1.96 * std),
        "share": Interval(
            share, "1", max(share - 1.96 * float(spread), 0.0), min(share + 1.96 * float(spread), 1.0)
        ),
    }
    nats = tuple(float(0.5 * np.sum((e.height_m / noise) ** 2)) for e in edges)

    def beside(own: Array, others: Sequence[Array]) -> float:
        """Nats of the flight's edges for edges of the others' height."""
        known = np.abs(np.concatenate(others))
        if len(known) == 0:
            return 0.0
        miss = np.minimum(0.5 * ((np.abs(own) - np.median(known)) / noise) ** 2, MOST_MISS)
        return float(np.sum(0.5 * (own / noise) ** 2 - miss - EDGE_NATS))

    told = foretold([e.height_m for e in edges], beside)
    levelled = [_levelled(r, e, a, height) for r, e, a in zip(records, edges, above, strict=True)]
    return levelled, [Oddity("floor_steps", parameters, nats, told)]


def _edges(record: Record, setting: Setting) -> _Edges:
    sonar = record.kinds == SONAR
    rows = np.flatnonzero(sonar & np.isfinite(record.values[:, 0]))
    none = _Edges(rows, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(len(rows)))
    if len(rows) < 4 * BESIDE:
        return none
    blind = record.values.copy()
    blind[sonar] = np.nan
    states = whole(replace(record, values=blind), setting).states[rows]
    read = record.values[rows, 0]
    beside = read - states[:, 2] / (np.cos(states[:, 6]) * np.cos(states[:, 7]))
    windows = np.median(np.lib.stride_tricks.sliding_window_view(beside, BESIDE), axis=1)
    rise = np.zeros(len(rows))
    rise[BESIDE : len(rows) - BESIDE + 1] = windows[BESIDE:] - windows[:-BESIDE]
    jump = np.diff(beside, prepend=beside[0])
    steady = np.diff(record.times_s[rows], prepend=-np.inf) < LONGEST_GAP_S
    high = np.minimum(read, np.roll(read, 1)) > LOWEST_M
    sharp = (np.abs(rise) > SHARP * record.noise_std[RANGE]) & (jump * rise > MOST_OF_IT * rise**2)
    found = np.flatnonzero(sharp & steady & high)
    kept = [k for k in found if np.abs(rise[k]) == np.abs(rise[max(k - 2, 0) : k + 3]).max()]
    at = np.array(kept, dtype=np.int64)
    return replace(none, at=at, height_m=rise[at], jump_m=jump)


def _above(edges: _Edges, height: float, noise: float) -> Array:
    """(readings,) 1 where the vehicle is over a box: the likeliest of all comings and goings (Viterbi)."""
    cost, back = np.zeros(2), np.zeros((len(edges.rows), 2), dtype=np.int64)
    for k in range(1, len(edges.rows)):
        # From state i to j the range rises by (i - j) height.
        due = height * (np.arange(2)[:, None] - np.arange(2))
        miss = np.minimum(0.25 * ((edges.jump_m[k] - due) / noise) ** 2, MOST_MISS)
        total = cost[:, None] + miss + EDGE_NATS * (1 - np.eye(2))
        back[k] = np.argmin(total, axis=0)
        cost = total.min(axis=0)
    state = np.zeros(len(edges.rows))
    at = int(np.argmin(cost))
    for k in range(len(edges.rows) - 1, -1, -1):
        state[k] = at
        at = int(back[k, at])
    return state


def _levelled(record: Record, edges: _Edges, above: Array, height: float) -> Record:
    values = record.values.copy()
    values[edges.rows, 0] += height * above
    return replace(record, values=values)
