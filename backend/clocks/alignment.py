"""Alignment of two recordings of one flight whose clocks have nothing in common.

One recording shows how the vehicle turned from moment to moment (pictures, an attitude, or a second gyro),
the other has a gyro. The rates of turn give candidates for the lag (`lag_profile`). At each candidate
the turns themselves give the mount of one body in the other, the lag, and the drift between the clocks
(`picture_clock`). The candidate that explains the turns best is taken, if it is much better than no relation
and clearly better than every other.

Source: Kelly, Roy and Sukhatme 2014 (IEEE Transactions on Robotics 30) for lag and mount from turns; Kabsch
1976 (Acta Crystallographica A32) for the mount; Vuong 1989 (Econometrica 57) for the comparison.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.clocks.delay_residuals import (
    DelayResiduals,
    delay_residuals,
    readings_between,
    turn_costs,
)
from backend.clocks.lag_profile import STEP_S, Signal, lag_profile
from backend.clocks.picture_clock import (
    GAIN_ERROR,
    LEAST_TURNS,
    SURE,
    clock_of,
    finer,
    piece_of,
)
from backend.measurements import InertialReadings
from backend.preintegration.integrals import integrate
from backend.significance import RIVAL_CHI_SQUARE

Array = NDArray[np.float64]

LARGEST_DRIFT = 1e-3
"""Prior standard deviation of the drift of a wrong rate: a video of 29.97 pictures a second that says 30."""
_CRYSTAL_TOLERANCE = 5e-5
"""Rate error within which makers guarantee plain quartz crystals, with temperature: 10 to 50 ppm."""
CRYSTAL_DRIFT = float(np.sqrt(2 / 3)) * _CRYSTAL_TOLERANCE
"""Prior standard deviation of the drift between two crystals: any error within the tolerance is as likely."""
_SEARCH_S = 0.5
"""Error of a candidate from the rates of turn: some steps of the signals."""
_CANDIDATES = 8
_LONGEST_GAP_S = 0.5
"""Over longer turns the turn says little about the rate."""
_WINDOWS = 12
"""Windows of time whose lags show the drift."""
_BLOCK_S = 1.0
"""Duration of blocks whose evidence counts as independent: turns of a vehicle last about so long."""


@dataclass(frozen=True)
class Turns:
    """How a vehicle turned, by pictures, by an attitude, or by a second gyro."""

    stamps_s: Array
    """(n,) increasing."""
    w_R_b: Array
    """(n, 3, 3)."""
    chain: NDArray[np.int64]
    """(n,) attitudes of one chain are relative to each other."""
    gain_error: float = GAIN_ERROR
    """Largest relative error of the turns, such as that of a focal length."""

    def after(self, lag_s: float, drift: float = 0.0, middle_s: float = 0.0) -> Turns:
        """Return the same turns with the lag taken out of their stamps."""
        return replace(self, stamps_s=self.stamps_s - lag_s - drift * (self.stamps_s - middle_s))

    def between(self, begin_s: float, end_s: float) -> Turns:
        """Return the attitudes between two stamps."""
        inside = (self.stamps_s > begin_s) & (self.stamps_s < end_s)
        return replace(
            self, stamps_s=self.stamps_s[inside], w_R_b=self.w_R_b[inside], chain=self.chain[inside]
        )

    def mounted(self, b_R_m: Array) -> Turns:
        """Return the same turns in other body axes."""
        return replace(self, w_R_b=self.w_R_b @ b_R_m.T)


@dataclass(frozen=True)
class ClockAlignment:
    """The clock of one recording relative to that of another."""

    middle_s: float
    """Stamp of the first recording at which the lag holds: the middle of the turns."""
    lag_s: float
    """Stamp in the first recording less that of the same moment in the second one."""
    lag_std_s: float
    drift: float
    """Growth of the lag in seconds per second."""
    drift_std: float
    b_R_m: Array
    """(3, 3) from the body axes of the first recording to those of the second."""
    mount_std_rad: Array
    """(3,) about the axes of the second recording's body."""
    turns: int
    """Number of turns that were compared."""
    steps: int
    """Number of steps of the clock that the turns show besides."""

    def lag_at(self, stamps_s: Array) -> Array:
        """Return the lag at stamps (n,) of the first recording."""
        return np.asarray(self.lag_s + self.drift * (stamps_s - self.middle_s))

    def std_at(self, stamps_s: Array) -> Array:
        """Return the standard deviation of the lag at stamps (n,) of the first recording."""
        return np.hypot(self.lag_std_s, self.drift_std * (stamps_s - self.middle_s))


@dataclass(frozen=True)
class AlignmentResult:
    """The alignment, or what stands against one."""

    found: ClockAlignment | None
    rivals_s: tuple[float, ...] = ()
    """Lags that explain the turns as well as the best one, the best one first; empty where there are none."""


def align_turns(turns: Turns, readings: InertialReadings) -> AlignmentResult:
    """Align the clock of ``turns`` with that of a gyro, whatever lies between them."""
    if len(turns.stamps_s) <= LEAST_TURNS or len(readings.stamps_s) < 2:
        return AlignmentResult(None)
    rates = _turn_rates(turns)
    if rates is None:
        return AlignmentResult(None)
    candidates = lag_profile(rates, _gyro_rates(readings)).peaks(2 * _SEARCH_S, _CANDIDATES)
    tried = [fit for lag_s in candidates.tolist() if (fit := _fit(turns, readings, lag_s)) is not None]
    tried.sort(key=lambda fit: -fit.evidence)
    if not tried or tried[0].surely < SURE**2:
        return AlignmentResult(None)
    best = tried[0]
    others = [fit for fit in tried[1:] if abs(fit.found.lag_s - best.found.lag_s) > _SEARCH_S]
    rivals = [fit.found.lag_s for fit in others if _surely(best.blocks - fit.blocks) < RIVAL_CHI_SQUARE]
    return AlignmentResult(None, (best.found.lag_s, *rivals)) if rivals else AlignmentResult(best.found)


def _gyro_rates(readings: InertialReadings) -> Signal:
    """Return the mean rate of turn in each step; a single reading would alias vibrations."""
    stamps_s = readings.stamps_s
    signal = Signal.sampled(stamps_s, integrate(stamps_s, readings.gyro_rad_s), _LONGEST_GAP_S)
    rates = np.diff(signal.values, axis=0, append=np.nan) / STEP_S
    return Signal(signal.begin_s + 0.5 * STEP_S, rates)


def _turn_rates(turns: Turns) -> Signal | None:
    """Return the rate of turn between successive attitudes of a chain; None where these are too few."""
    lasts_s = np.diff(turns.stamps_s)
    good = (turns.chain[1:] == turns.chain[:-1]) & (lasts_s <= _LONGEST_GAP_S) & (lasts_s > 0)
    if good.sum() < LEAST_TURNS:
        return None
    attitude = Rotation.from_matrix(turns.w_R_b)
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec()[good] / lasts_s[good, None]
    return Signal.sampled((turns.stamps_s[:-1] + 0.5 * lasts_s)[good], rate, 2 * _LONGEST_GAP_S)


@dataclass(frozen=True)
class _Fit:
    found: ClockAlignment
    blocks: Array
    """(b,) evidence of the turns of each block of the first recording's time."""

    @property
    def evidence(self) -> float:
        return float(self.blocks.sum())

    @property
    def surely(self) -> float:
        return _surely(self.blocks)


def _surely(blocks: Array) -> float:
    """Return the sum of the evidence of blocks, or less where the blocks disagree (Vuong, equation 3.1)."""
    total, spread = float(blocks.sum()), float(((blocks - blocks.mean()) ** 2).sum())
    return min(total, total * abs(total) / max(spread, 1e-300))


def _fit(turns: Turns, readings: InertialReadings, lag_s: float) -> _Fit | None:
    """Return the best alignment near a candidate; None where the gyro does not explain the turns there."""
    moved = turns.after(lag_s).between(float(readings.stamps_s[0]), float(readings.stamps_s[-1]))
    if len(moved.stamps_s) <= LEAST_TURNS:
        return None
    reach_s = _SEARCH_S + 0.5 * LARGEST_DRIFT * float(np.ptp(moved.stamps_s))
    near = readings_between(
        readings, float(moved.stamps_s[0]) - 2 * reach_s, float(moved.stamps_s[-1]) + 2 * reach_s
    )
    middle_s = 0.5 * float(moved.stamps_s[0] + moved.stamps_s[-1])
    residuals = _residuals(moved, near, reach_s)
    if residuals is None:
        return None
    b_R_m, mount_std_rad = _mount(residuals)
    moved = moved.mounted(b_R_m)
    residuals = _residuals(moved, near, reach_s)
    if residuals is None:
        return None
    drift, drift_std = _drift(residuals)
    moved = moved.after(0.0, drift, middle_s)
    residuals = _residuals(moved, near, reach_s)
    clock = None if residuals is None else clock_of(residuals, turns.gain_error)
    if residuals is None or clock is None or not clock.pieces[0].known:
        return None
    piece = clock.pieces[0]
    if len(clock.pieces) == 1:
        piece = finer(piece, moved.stamps_s, moved.w_R_b, moved.chain, near)
    found = ClockAlignment(
        middle_s=middle_s + lag_s,
        lag_s=lag_s + piece.delay_s,
        lag_std_s=piece.std_s,
        drift=drift,
        drift_std=drift_std,
        b_R_m=b_R_m,
        mount_std_rad=mount_std_rad,
        turns=len(residuals.begin_s),
        steps=len(clock.pieces) - 1,
    )
    number = np.maximum(residuals.begin_s + lag_s - turns.stamps_s[0], 0.0) / _BLOCK_S
    count = int(np.ptp(turns.stamps_s) / _BLOCK_S) + 2
    blocks = np.bincount(number.astype(np.int64), _evidence(residuals), count)
    return _Fit(found, np.asarray(blocks, dtype=np.float64))


def _residuals(turns: Turns, readings: InertialReadings, reach_s: float) -> DelayResiduals | None:
    found = delay_residuals(turns.stamps_s, turns.w_R_b, turns.chain, readings, reach_s)
    return found if found is not None and len(found.begin_s) >= LEAST_TURNS else None


def _evidence(residuals: DelayResiduals) -> Array:
    """Return how much better the best delay explains each turn (n,) than a gyro that says nothing."""
    tried = np.concatenate([residuals.difference, residuals.change[:, None]], axis=1)
    cost = turn_costs(replace(residuals, difference=tried).squares)
    return np.asarray(cost[:, -1] - cost[:, int(cost[:, :-1].sum(axis=0).argmin())])


def _mount(residuals: DelayResiduals) -> tuple[Array, Array]:
    """Return the rotation that turns the first body's turns into the gyro's, and its deviations (3,).

    An axis about which the turns say nothing keeps its direction.
    """
    lasts_s = residuals.end_s - residuals.begin_s
    seen = _without_bias(residuals.change[:, None], lasts_s)[:, 0]
    by_gyro = _without_bias(residuals.change[:, None] - residuals.difference, lasts_s)
    products = np.einsum("ngi,nj->gij", by_gyro, seen)
    alike = np.linalg.svd(products, compute_uv=False).sum(axis=1)
    off = (by_gyro**2).sum(axis=(0, 2)) + (seen**2).sum() - 2.0 * alike
    best = int(off.argmin())
    variance = max(float(off[best]) / (3 * len(lasts_s)), 1e-12)
    # Products of noise alone add up to this; they must not turn an axis that nothing shows.
    noise = 2.0 * variance * np.sqrt(len(lasts_s))
    u, _, vt = np.linalg.svd(products[best] + noise * np.eye(3))
    b_R_m = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    turned = by_gyro[:, best]
    information = (np.eye(3) * (turned**2).sum() - turned.T @ turned) / variance
    return b_R_m, np.sqrt(np.diag(np.linalg.inv(information + np.eye(3))))


def _without_bias(turns_rad: Array, lasts_s: Array) -> Array:
    """Return turns (n, g, 3) without what is proportional to their durations (n,)."""
    rate = np.einsum("n,ngi->gi", lasts_s, turns_rad) / float(lasts_s @ lasts_s)
    return np.asarray(turns_rad - lasts_s[:, None, None] * rate)


def _drift(residuals: DelayResiduals) -> tuple[float, float]:
    """Return the growth of the delay per second and its deviation, from the delays of windows of time.

    The prior is that of crystals, unless that of a wrong rate makes these delays more likely.
    """
    windows = min(_WINDOWS, len(residuals.begin_s) // LEAST_TURNS)
    if windows < 2:
        return 0.0, LARGEST_DRIFT
    # What the sampling of the gyro leaves open is common to all windows.
    apart = replace(residuals, sampling_std_s=0.0)
    parts = [
        apart.part(slice(int(rows[0]), int(rows[-1]) + 1))
        for rows in np.array_split(np.arange(len(residuals.begin_s)), windows)
    ]
    pieces = [piece_of(part, 0.0) for part in parts]
    at_s = np.array([0.5 * float(part.begin_s[0] + part.end_s[-1]) for part in parts])
    delay_s, weight = np.array([p.delay_s for p in pieces]), np.array([p.std_s for p in pieces]) ** -2.0
    at_s, delay_s = at_s - np.average(at_s, weights=weight), delay_s - np.average(delay_s, weights=weight)
    information = float(weight @ at_s**2)
    drift = float(weight @ (at_s * delay_s)) / information
    # Windows that disagree by more than their deviations show that these are too small.
    excess = float(weight @ (delay_s - drift * at_s) ** 2) / max(windows - 2, 1)
    variance = max(excess, 1.0) / information

    def unlikely(prior: float) -> float:
        return float(np.log(prior**2 + variance) + drift**2 / (prior**2 + variance))

    prior = min(CRYSTAL_DRIFT, LARGEST_DRIFT, key=unlikely)
    share = prior**2 / (prior**2 + variance)
    return share * drift, float(np.sqrt(share * variance))
