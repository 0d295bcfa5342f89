"""Errors of the integrals of the inertial unit after a while, before and after what was found.

They correspond to roll-outs with commands, in the same units. From a moment at which an instrument is
trusted, the gyro or the accelerometer alone predicts its reading. A height is predicted from two moments, the
begin and the middle: no instrument measures its initial rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slam.criticism.cause import ChannelError
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.without_commands.likelihood import Sizes
from slam.criticism.without_commands.whitened_rows import NODE_S, Averages, WhitenedRows
from slam.simulation.replay.compare import HORIZONS_S

Array = NDArray[np.float64]


def channel_errors(
    rows: Sequence[Sequence[WhitenedRows]], sizes: Sequence[Mapping[float, Sizes]], by: str
) -> tuple[ChannelError, ...]:
    """Return root mean square errors over each horizon, before and after the ``sizes`` are removed.

    ``sizes``: for each flight, number of a segment -> sizes there, by all other parts, which are ``by``
    flight or segment.
    """
    squares: dict[tuple[str, str, float], list[Array]] = {}
    for flight, of_segment in zip(rows, sizes, strict=True):
        for averages in (r.averages for r in flight if r.averages is not None):
            for horizon in HORIZONS_S:
                found = _errors_of(averages, horizon, of_segment, by == "flight")
                squares.setdefault((averages.channel, averages.unit, horizon), []).append(found**2)
    errors = []
    for (channel, unit, horizon), of in squares.items():
        pooled = np.concatenate(of)
        if len(pooled):
            before, after = np.sqrt(pooled.mean(axis=0))
            errors.append(ChannelError(channel, unit, horizon, float(before), float(after)))
    return tuple(sorted(errors, key=lambda e: e.horizon_s))


def _errors_of(
    averages: Averages, horizon_s: float, sizes: Mapping[float, Sizes], whole_flight: bool
) -> Array:
    """Return errors (n, 2) before and after, from every moment whose horizon lies within one part."""
    ahead = round(horizon_s / NODE_S)
    last = len(averages.times_s) - ahead
    if last < 1 or ahead % averages.order:
        return np.zeros((0, 2))
    segment = averages.times_s // SEGMENT_S
    lost = np.concatenate([[0], np.cumsum(~averages.whole)])
    kept = (lost[ahead + 1 :] == lost[:last]) & (averages.pause[ahead:] == averages.pause[:last])
    kept &= whole_flight | (segment[ahead:] == segment[:last])
    kept &= np.isin(segment[:last], list(sizes))
    apart = averages.table[ahead:] - averages.table[:last]
    if averages.order == 2:
        apart -= 2.0 * (averages.table[ahead // 2 : last + ahead // 2] - averages.table[:last])
    explained = np.zeros(last)
    for number, of in sizes.items():
        own = segment[:last] == number
        for name, size in of.items():
            explained[own] += size * apart[own, averages.column(name)] if averages.knows(name) else 0.0
    return np.asarray(np.column_stack([apart[:, 0], apart[:, 0] - explained])[kept])
