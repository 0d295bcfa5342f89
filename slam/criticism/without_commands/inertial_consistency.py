"""Inertial consistency: readings beside the integrals of the imu, and the effect of each error.

The difference of reading and integral (``slam/data_quality/inertial_comparison.py``) is averaged about
moments half a second apart. Between these it may change (twice, for the height) by noise alone, or by an
effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.arrays import Array
from slam.core.flight import Flight
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS
from slam.criticism.without_commands.whitened_rows import INTEGRATED, WhitenedRows, whitened_rows
from slam.data_quality.inertial_comparison import (
    DELAY,
    READ_AS,
    ImuReadings,
    compared,
    comparisons,
    imu_of,
    in_body_axes,
    near_floor,
    with_finite_imu,
)
from slam.simulation.terms import CATALOGUE, Term

SMALL = 0.2
"""Size at which a term is undone for its derivative, as a share of its usual range: a delay of only some
milliseconds would show the noise of the attitude between two samples."""
DELAYS_S = (-0.16, -0.08, 0.0, 0.08, 0.16, 0.24, 0.32)
"""Delays about which rows may be linear: half of the 0.2 s over which a speed is averaged, either way."""
CERTAIN_NATS = 12.5
"""Least lead of a delay: half the square of five standard deviations, as for every effect."""
FAINT = 1e-9
"""Greatest entry of a column that is rounding."""


def inertial_residuals(flight: Flight) -> list[WhitenedRows]:
    """Return the rows of every comparison that the flight's streams allow."""
    finite = with_finite_imu(flight)
    imu, low_s, found = imu_of(finite), near_floor(flight), list[WhitenedRows]()
    if imu is None:
        return found
    for kind, seen in comparisons(finite):
        traces = _traces(finite, imu, kind, seen.off) | seen.others()
        late_s = _delay(finite, imu, kind, traces, low_s)
        if late_s != 0.0:
            late = replace(imu, stamps_s=imu.stamps_s + late_s)
            seen = compared(finite, late, kind)
            traces = _traces(finite, late, kind, seen.off) | seen.others()
        rows = whitened_rows(kind, seen.stamps_s, seen.off, traces, low_s, seen.order)
        found += [r.shifted(READ_AS[kind] + DELAY, late_s) for r in rows]
    return found


def _delay(flight: Flight, imu: ImuReadings, kind: str, traces: dict[str, Array], low_s: Array) -> float:
    """Return the delay of a stream, of those on the grid, about which its rows are linear.

    Far from the truth the noise of the rows has the delay in it. Where their slope points to a delay, the
    profile likelihood is therefore compared, with the noise and all other errors fitted anew at each. Without
    motion slope and profile are chance: both must agree.
    """
    column = READ_AS[kind] + DELAY

    def rows(late_s: float) -> list[WhitenedRows]:
        seen = compared(flight, replace(imu, stamps_s=imu.stamps_s + late_s), kind)
        return whitened_rows(kind, seen.stamps_s, seen.off, traces, low_s, seen.order)

    now = rows(0.0) if column in traces else []
    slope = sum(float(r.traces[column] @ r.off) for r in now)
    known = sum(float(r.traces[column] @ r.traces[column]) for r in now)
    if 0.5 * slope**2 <= VERY_SIMILAR_NATS * known:
        return 0.0
    nats = {late_s: sum(r.log_likelihood for r in rows(late_s)) for late_s in DELAYS_S if late_s * slope >= 0}
    best = max(nats, key=lambda late_s: nats[late_s])
    return best if nats[best] - nats[0.0] > CERTAIN_NATS else 0.0


def _traces(flight: Flight, imu: ImuReadings, kind: str, off: Array) -> dict[str, Array]:
    """Return column -> (n, components) the change of the differences with each parameter of the terms.

    The catalogue's own corrections say how an error acts: the differences are compared with the term undone
    at a small size of either sign. A scale has two columns: by the quantity as read, and as integrated.
    """
    traces: dict[str, Array] = {}
    for term in CATALOGUE.values():
        if term.undo is None or not term.in_differences or term.stream not in ("imu", READ_AS[kind]):
            continue
        for k, parameter in enumerate(term.smooth):
            size = SMALL * (parameter.high - parameter.low)
            values = np.array([[p.neutral for p in term.parameters]] * 2)
            values[:, k] += -size, size
            less, more = (_off(term.undo(flight, v, None), imu, term, kind) for v in values)
            column = (less - more) / (2.0 * size)
            if np.abs(column).max() < FAINT:
                continue
            name = f"{term.name}.{parameter.name}"
            traces[name] = column
            if term.scales:
                other = column - off
                by_read, by_integral = (other, column) if term.stream == "imu" else (column, other)
                traces[name], traces[name + INTEGRATED] = by_read, by_integral
    return traces


def _off(undone: Flight, imu: ImuReadings, term: Term, kind: str) -> Array:
    """Return the differences (n, components) of a flight without a term; ``imu`` is that with the term."""
    changed = replace(imu, **in_body_axes(undone)) if term.stream == "imu" else imu
    return compared(undone, changed, kind).off
