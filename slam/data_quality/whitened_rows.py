"""Whitened rows of a comparison: differences averaged about moments half a second apart, of unit variance.

Inertial consistency compares readings with the integrals of the imu, and gives the effect of each error. The
difference of reading and integral (``slam/data_quality/inertial_comparison.py``) is averaged. Between moments
it may change (twice, for the height) by noise alone, or by an effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from frontend.robust import robust_std
from slam.core.arrays import Array, Ints
from slam.core.flight import Flight
from slam.data_quality.comparison_derivatives import DELAY, LAGGING, SMOOTHING, derivatives, with_lags
from slam.data_quality.finding import Remark
from slam.data_quality.inertial_comparison import (
    BETWEEN_SAMPLES,
    CHANNELS,
    FEWEST,
    INTEGRATED,
    LONGEST_GAP_S,
    Averages,
    comparisons,
    imu_of,
    moments_of,
    near_floor,
    segment_numbers,
    with_finite_imu,
)
from slam.data_quality.lag import PROMPT, Lag

LEAST_SHARE = 0.05
FAR_OFF = 5.0
TWICE_INTEGRATED = 0.25
"""Correlation of successive second differences of a twice integrated white noise."""


@dataclass(frozen=True)
class WhitenedRows:
    """Differences of unit variance, and their derivatives by each effect."""

    kind: str
    """``attitude``, ``velocity`` or ``height``, compared with the imu; or ``pictures``, compared with all."""
    times_s: Array
    """(n,)."""
    off: Array
    """(n,)."""
    traces: dict[str, Array]
    """Column -> (n,)."""
    noise: float
    """Standard deviation that divided a difference: rad, m/s or m, for pictures in units of their noise."""
    averages: Averages | None
    """Averages that they are differences of; None for pictures."""
    log_likelihood: float = 0.0
    """Log likelihood of the differences, with noise and errors fitted; 0 for pictures."""

    def shifted(self, column: str, size: float) -> WhitenedRows:
        """Return the rows of readings with an error, from rows about a size of it."""
        if size == 0.0 or column not in self.traces:
            return self
        averages = self.averages
        if averages is not None:
            table = averages.table.copy()
            table[:, 0] += size * table[:, averages.column(column)]
            averages = replace(averages, table=table)
        return replace(self, off=self.off + size * self.traces[column], averages=averages)

    def by_own_noise(self) -> WhitenedRows:
        """Return the rows in units of the noise that successive ones show (von Neumann, 1941), where it is
        smaller: an error that begins at a moment makes all rows scatter, but hardly their differences."""
        std = float(np.sqrt(0.5 * np.mean(np.diff(self.off) ** 2)))
        if self.averages is None or not 0.0 < std < 1.0:
            return self
        return replace(self, off=self.off / std, traces={n: t / std for n, t in self.traces.items()})


FlightRows = Sequence[Sequence[WhitenedRows]]
"""Rows of each flight."""


def columns_of(rows: FlightRows) -> list[str]:
    """Return the columns that some of the rows have."""
    return list(dict.fromkeys(n for flight in rows for r in flight for n in r.traces))


def table_of(rows: FlightRows, columns: Sequence[str]) -> Array:
    """Return (rows, columns) the change of all rows with each column."""
    every = [r for flight in rows for r in flight]
    table = np.zeros((sum(len(r.off) for r in every), len(columns)))
    for k, name in enumerate(columns):
        table[:, k] = np.concatenate([r.traces.get(name, np.zeros(len(r.off))) for r in every])
    return table


def begin_of(rows: Sequence[WhitenedRows], otherwise_s: float = 0.0) -> float:
    """Return the first moment of a flight's comparisons, from which its segments are counted.

    Stamps begin anywhere: segments from a fixed second would differ between copies of one recording.
    """
    return min((float((r.averages or r).times_s[0]) for r in rows), default=otherwise_s)


def segments_of(rows: FlightRows, segment_s: float, before_s: float = 0.0) -> tuple[Ints, Array, Ints]:
    """Return (segments, 2) flight and number, (segments,) begin in s, and (rows,) the segment of each row.
    The first segments begin ``before_s`` before the flights."""
    begin_s = np.array([begin_of(found) - before_s for found in rows])
    flight = np.concatenate([np.full(len(r.off), k) for k, found in enumerate(rows) for r in found])
    times_s = np.concatenate([r.times_s for found in rows for r in found])
    number = segment_numbers(times_s, begin_s[flight], segment_s)
    labels, segment = np.unique(np.column_stack([flight, number]), axis=0, return_inverse=True)
    return labels, begin_s[labels[:, 0]] + segment_s * labels[:, 1], segment


def noise_of(rows: FlightRows) -> dict[str, float]:
    """Return kind of comparison -> root mean square noise of its differences."""
    squares: dict[str, list[float]] = {}
    for found in (r for flight in rows for r in flight):
        squares.setdefault(found.kind, []).append(found.noise**2)
    return {kind: float(np.sqrt(np.mean(of))) for kind, of in squares.items()}


def whitened_rows(
    kind: str, stamps: Array, off: Array, traces: dict[str, Array], near_floor: Array, order: int
) -> list[WhitenedRows]:
    """Return one set of whitened rows for each component of ``off`` (n, components)."""
    moments = moments_of(stamps, near_floor)
    nodes, begin, end, whole = moments
    far = np.diff(stamps, append=np.inf) > LONGEST_GAP_S
    gaps = np.concatenate([[0], np.cumsum(far)])
    late = np.concatenate([[0.0], np.cumsum(stamps)])
    count = np.maximum(end - begin, 1)
    late = np.where(end > begin, (late[end] - late[begin]) / count - nodes, 0.0)
    made = []
    for c in range(off.shape[1]):
        table = np.column_stack([off[:, c], *(t[:, c] for t in traces.values())])
        means = moments.means(table)
        # A double integral drifts: a delayed reading would show the drift, and not the motion.
        means -= late[:, None] * np.gradient(means, nodes + late, axis=0)
        pause = gaps[np.minimum(begin, len(stamps) - 1)]
        averages = Averages(*CHANNELS[kind][c], order, nodes, whole, pause, list(traces), means)
        steps = np.diff(means, n=order, axis=0)
        kept = moments.together(order)
        kept &= gaps[end[order:] - 1] == gaps[begin[: len(begin) - order]]
        if kept.sum() >= FEWEST:
            made.append(_white(kind, nodes[order:][kept], np.flatnonzero(kept), steps[kept], averages))
    return made


def _white(kind: str, times_s: Array, place: Ints, table: Array, averages: Averages) -> WhitenedRows:
    """Whiten the rows by their own scatter, which is that of the averages and that of the integral."""
    names = averages.names
    variance, of_averages, of_integral = _noise(table[:, 0], place, averages.order)
    if BETWEEN_SAMPLES in names:
        between = table[:, 1 + names.index(BETWEEN_SAMPLES)]
        of_integral += np.outer(between, between) / 12.0
    root = np.linalg.cholesky(of_integral + of_averages)
    inverse = solve_triangular(root, np.eye(len(root)), lower=True)
    # Reading and integral both contain noise that is in the difference too; their weighted mean does not: the
    # weights are the shares of their noise in white rows. Where there is little else in them, they are no
    # evidence for a scale.
    read = 1.0 - float(np.sum((inverse @ of_integral) * inverse)) / len(root)
    for k in [k for k, name in enumerate(names) if name + INTEGRATED in names]:
        beside = names.index(names[k] + INTEGRATED)
        moves = names[k].endswith(SMOOTHING)
        moves |= float(np.mean(table[:, 1 + k] * table[:, 1 + beside])) > variance
        both = (1.0 - read) * table[:, 1 + k] + read * table[:, 1 + beside]
        table[:, 1 + k] = both if moves else 0.0
    white = inverse @ table
    # Effects are no scatter, and no reason to leave rows out.
    mixed = [n for n in names if n + INTEGRATED in names or n.endswith(INTEGRATED)]
    own = [1 + k for k, n in enumerate(names) if n not in (*mixed, BETWEEN_SAMPLES)]
    size = np.linalg.lstsq(white[:, own], white[:, 0], rcond=RANK)[0]
    left = white[:, 0] - white[:, own] @ size
    far = np.abs(left) > FAR_OFF * robust_std(left)
    free = max(int(np.sum(~far)) - len(size), 1)
    scatter = max(float(np.sqrt(np.sum(left[~far] ** 2) / free)), 1e-9)
    white /= scatter
    white[far] = 0.0
    effects = [n for n in names if not n.endswith(INTEGRATED) and n != BETWEEN_SAMPLES]
    traces = {n: white[:, 1 + names.index(n)] for n in effects}
    log_likelihood = -float(np.sum(np.log(scatter * np.diag(root))))
    std = scatter * float(np.sqrt(variance))
    return WhitenedRows(kind, times_s, white[:, 0], traces, std, averages, log_likelihood)


def _noise(off: Array, place: Ints, order: int) -> tuple[float, Array, Array]:
    """Return the variance of differences (n,), and the covariances (n, n) of their noise by the averages and
    by the integral, from the correlation of successive ones. ``place`` (n,) numbers their moments."""
    off = np.clip(off, *np.quantile(off, [0.02, 0.98]))
    variance = float(np.mean(off**2))
    successive = float(np.mean((off[1:] * off[:-1])[np.diff(place) == 1]))
    # Covariances over none, one and two moments of unit noise: of averages, and of the integral.
    averaged = np.array([2.0, -1.0, 0.0] if order == 1 else [6.0, -4.0, 1.0])
    integrated = np.array([1.0, 0.0 if order == 1 else TWICE_INTEGRATED, 0.0])
    share = (integrated[1] * variance - successive) / (integrated[1] * averaged[0] - averaged[1])
    share = float(np.clip(share, 0.0, (1 - LEAST_SHARE) * variance / averaged[0]))
    apart = np.minimum(np.abs(place[:, None] - place), len(averaged))
    both = share * averaged, (variance - averaged[0] * share) * integrated
    of_averages, of_integral = (np.append(covariance, 0.0)[apart] for covariance in both)
    return variance, of_averages, of_integral


DELAYS_S = (-0.16, -0.08, 0.0, 0.08, 0.16, 0.24, 0.32)
"""Delays about which rows may be linear: half of the 0.2 s over which a speed is averaged, either way."""
HINT_NATS = 4.0
"""Lead in nats by which the slope of the rows points to a delay: about three standard deviations."""
CERTAIN_NATS = 12.5
"""Least lead of a lag: half the square of five standard deviations."""
ROUNDS = 2
"""Most steps of Gauss and Newton from the grid to the likeliest lag."""
RANK = 1e-6
"""Least share of the strongest combination of errors that a fit tells from none."""


def inertial_residuals(flight: Flight, lags: Mapping[str, Lag] | None = None) -> list[WhitenedRows]:
    """Return the rows of every comparison that the flight's streams allow, linear about its ``lags``."""
    finite, low_s, found = with_finite_imu(flight), near_floor(flight), list[WhitenedRows]()
    lags = lags_of([flight]) if lags is None else lags
    if (imu := imu_of(finite, lags)) is None:
        return found
    for kind, seen in comparisons(finite, lags):
        traces = derivatives(finite, imu, kind, seen.off) | seen.others()
        rows = whitened_rows(kind, seen.stamps_s, seen.off, traces, low_s, seen.order)
        for stream, lag in lags.items():
            rows = [r.shifted(stream + DELAY, lag.delay_s) for r in rows]
        found += rows
    return found


def lags_of(flights: Sequence[Flight]) -> dict[str, Lag]:
    """Return the delays of the vehicle's attitude and velocity about which their rows are linear. That of the
    attitude acts on all comparisons, as it turns the accelerometer into the world: it is sought first."""
    lags: dict[str, Lag] = {}
    for stream in LAGGING:
        lags[stream] = _delay([with_finite_imu(flight) for flight in flights], lags, stream)
    return lags


def _delay(flights: Sequence[Flight], lags: Mapping[str, Lag], stream: str) -> Lag:
    """Return the delay of a stream about which its rows are linear. Far from the truth their noise holds the
    delay. Where their slope points to one, the profile likelihood is compared, with noise and other errors
    fitted anew: without motion both are chance, and must agree. Steps of Gauss and Newton follow."""
    known = []
    for flight in (f for f in flights if any(kind == stream for kind, _ in comparisons(f))):
        imu, off = imu_of(flight, lags), with_lags(flight, lags, stream).off
        assert imu is not None
        traces = derivatives(flight, imu, stream, off)
        # To first order a filter is a delay.
        traces = {name: t for name, t in traces.items() if not name.startswith(stream + SMOOTHING)}
        known.append((flight, near_floor(flight), traces))

    def rows(delay_s: float) -> list[WhitenedRows]:
        each = ((with_lags(f, {**lags, stream: Lag(delay_s)}, stream), low_s, t) for f, low_s, t in known)
        return [
            row for seen, low_s, traces in each
            for row in whitened_rows(stream, seen.stamps_s, seen.off, traces, low_s, seen.order)
        ]  # fmt: skip

    now = [(r.traces[stream + DELAY], r) for r in rows(0.0) if stream + DELAY in r.traces]
    slope = sum(float(delay @ r.off) for delay, r in now)
    if 0.5 * slope**2 <= HINT_NATS * sum(float(delay @ delay) for delay, _ in now):
        return PROMPT
    nats = {late_s: _nats(rows(late_s)) for late_s in DELAYS_S if late_s * slope >= 0.0}
    best = max(nats, key=lambda late_s: nats[late_s])
    best = best if nats[best] - nats[0.0] > CERTAIN_NATS else 0.0
    for _ in range(ROUNDS):
        about = rows(best)
        nearer = best + _size(about, stream + DELAY)
        if _nats(rows(nearer)) <= _nats(about):
            break
        best = nearer
    return Lag(best)


def _nats(rows: Sequence[WhitenedRows]) -> float:
    return sum(r.log_likelihood for r in rows)


def _size(rows: Sequence[WhitenedRows], column: str) -> float:
    """Return the size of one error by a least-squares fit of all."""
    names, off = columns_of([rows]), np.concatenate([r.off for r in rows])
    return float(np.linalg.lstsq(table_of([rows], names), off, rcond=RANK)[0][names.index(column)])


PICTURES = "pictures"
"""Kind of the rows of pictures, which are compared with the path of all other instruments."""
CONTRADICTED = 2.0
"""Ratio of residuals to their noise beyond which pictures contradict the path; 1 for healthy flights."""


def contradiction(rows: FlightRows) -> list[Remark]:
    """Return whether pictures and path disagree by more than all errors together explain."""
    over = [r.noise for flight in rows for r in flight if r.kind == PICTURES]
    if not over or float(np.median(over)) < CONTRADICTED:
        return []
    by = f"{min(over):.1f} to {max(over):.1f} times their noise"
    text = f"pictures disagree with the path of the other instruments by {by}"
    return [Remark(text, channel="pictures")]
