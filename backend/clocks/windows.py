"""Spans of a flight in which the pictures' clock disagrees with the gyro's after all delays were taken out.

The search for delays and steps (`picture_clock`) leaves out both ends of the flight, and knows no drift. Here
each window of time is asked by itself whether some delay explains its turns better than none. A step near an
end, two steps and a drift all show as windows that ask for a delay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from backend.clocks.delay_residuals import (
    GRID_STEP_S,
    LONGEST_DELAY_S,
    readings_between,
    residuals_at,
    thinned,
    turn_costs,
)
from backend.clocks.picture_clock import (
    GAIN_ERROR,
    NOTABLE_S,
    ClockPiece,
    explained,
    piece_of,
    robust_cost,
)
from backend.measurements import InertialReadings
from backend.significance import FALSE_ALARM

Array = NDArray[np.float64]

_TURNS = 8
"""Fewest turns of a window: 24 components, which determine seven parameters and leave twice as many."""
_FITTED = 7
"""Parameters of a window: bias and kind of noise of three axes, and the delay."""
_SHORTEST_S = 1.0
"""Shortest window: turns of a vehicle last about so long."""
_LARGEST_GAIN_ERROR = 0.5
"""Largest share of the turns that a wrong clock may hide from the comparison at the stamps as they are. It is
all of them where the gyro has a wrong sign, axis or unit."""
_MOST = 40
"""Windows of a long flight; each end has shorter ones besides."""


@dataclass(frozen=True)
class ClockDisagreement:
    """A span of time whose turns ask for a delay of the pictures' stamps."""

    begin_s: float
    end_s: float
    delay_s: float
    """How much later a picture is stamped than the gyro's reading, in the window that shows it best."""
    std_s: float


def clock_disagreements(
    stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings
) -> tuple[ClockDisagreement, ...]:
    """Return the spans of time in which a gyro contradicts the stamps (n,) of attitudes (n, 3, 3).

    ``stamps_s`` is sorted, and ``chain`` (n,) is that of ``picture_clock``. Delays below ``NOTABLE_S`` count
    as none. A flight without such delays has a span with the probability ``FALSE_ALARM`` at most. There is
    none where the gyro contradicts the pictures in other ways: a turned axis may look like a delay.
    """
    imu_s = readings.stamps_s
    inside = (stamps_s >= imu_s[0]) & (stamps_s <= imu_s[-1])
    stamps_s, w_R_b, chain = stamps_s[inside], w_R_b[inside], chain[inside]
    rows = thinned(stamps_s)
    stamps_s, w_R_b, chain = stamps_s[rows], w_R_b[rows], chain[rows]
    if not _is_related(stamps_s, w_R_b, chain, readings):
        return ()
    windows = _windows(stamps_s)
    surely = FALSE_ALARM / max(len(windows), 1)
    found = [
        shown
        for rows in windows
        if (shown := _shown(stamps_s[rows], w_R_b[rows], chain[rows], readings, surely)) is not None
    ]
    return _joined(found)


def _is_related(stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings) -> bool:
    """Return whether the gyro shows most of the turns of the whole flight without any delay."""
    residuals = residuals_at(GRID_STEP_S * np.arange(-2.0, 3.0), stamps_s, w_R_b, chain, readings)
    none = ClockPiece(float("-inf"), 0.0, 0.0)
    return residuals is not None and explained(residuals, [none], _LARGEST_GAIN_ERROR)


def _windows(stamps_s: Array) -> list[slice]:
    """Return windows that overlap by half, and shorter ones at both ends, in the order of time."""
    n = len(stamps_s)
    if n <= _TURNS:
        return []
    least = max(_TURNS + 1, int(np.ceil(_SHORTEST_S / np.median(np.diff(stamps_s)))))
    usual = max(least, int(np.ceil(2 * n / _MOST)))
    if n < usual:
        return []
    begins = np.append(np.arange(0, n - usual, usual // 2), n - usual)
    spans = {(int(begin), int(begin) + usual) for begin in begins}
    while least < usual:  # an error of the last second is a small share of a long window
        spans |= {(0, least), (n - least, n)}
        least *= 2
    return [slice(*span) for span in sorted(spans)]


def _shown(
    stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings, surely: float
) -> tuple[float, ClockDisagreement] | None:
    """Return the disagreement of a window and the probability of it by chance, if below ``surely``."""
    imu_s = readings.stamps_s
    lowest_s = max(-LONGEST_DELAY_S, float(stamps_s[-1] - imu_s[-1]))
    highest_s = min(LONGEST_DELAY_S, float(stamps_s[0] - imu_s[0]))
    steps = np.arange(np.ceil(lowest_s / GRID_STEP_S), np.floor(highest_s / GRID_STEP_S) + 1)
    near = readings_between(readings, float(stamps_s[0]) - highest_s, float(stamps_s[-1]) - lowest_s)
    if len(steps) < 4 or len(near.stamps_s) < 2:  # too few for a spline
        return None
    residuals = residuals_at(steps * GRID_STEP_S, stamps_s, w_R_b, chain, near)
    if residuals is None or len(residuals.begin_s) < _TURNS:
        return None
    chance = len(steps) * _chance(turn_costs(residuals.squares), residuals.delays_s)
    piece = piece_of(residuals, float("-inf"))
    if chance > surely or not _is_a_delay(piece) or not explained(residuals, [piece], GAIN_ERROR):
        return None
    span = float(residuals.begin_s[0]), float(residuals.end_s[-1])
    return chance, ClockDisagreement(*span, piece.delay_s, piece.std_s)


def _chance(turn_cost: Array, delays_s: Array) -> float:
    """Return the probability that noise makes one other delay so much likelier than each small one.

    ``turn_cost`` (n, g). The ratio of the likelihoods is that of the residuals' sums of squares, whose excess
    over one is distributed as the square of Student's t over its degrees of freedom.
    """
    components = 3 * len(turn_cost)
    small = np.abs(delays_s) <= NOTABLE_S
    excess = float(robust_cost(turn_cost)[small].min())
    free = components - _FITTED
    t = np.sqrt(free * np.expm1(excess / components))
    return float(2 * stdtr(free, -t))


def _is_a_delay(piece: ClockPiece) -> bool:
    return abs(piece.delay_s) >= NOTABLE_S and piece.known


def _joined(found: list[tuple[float, ClockDisagreement]]) -> tuple[ClockDisagreement, ...]:
    """Join windows that overlap and ask for delays of one sign; the least likely by chance gives the size."""
    spans: list[list[tuple[float, ClockDisagreement]]] = []
    for chance, shown in found:
        last = spans[-1] if spans else []
        if (
            last
            and shown.begin_s <= max(s.end_s for _, s in last)
            and last[-1][1].delay_s * shown.delay_s > 0
        ):
            last.append((chance, shown))
        else:
            spans.append([(chance, shown)])
    joined = []
    for span in spans:
        best = min(span, key=lambda pair: pair[0])[1]
        end_s = max(shown.end_s for _, shown in span)
        joined.append(ClockDisagreement(span[0][1].begin_s, end_s, best.delay_s, best.std_s))
    return tuple(joined)
