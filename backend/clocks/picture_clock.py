"""Delay of the pictures' clock behind the gyro's, and steps of it, from the posterior over all delays.

The posterior decides, not the curvature at one minimum of the cost: where another delay explains the turns
nearly as well, the standard deviation is as large as the distance of the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import (
    DelayResiduals,
    delay_residuals,
    residuals_at,
    thinned,
    turn_costs,
)
from backend.clocks.grid_posterior import grid_posterior
from backend.measurements import InertialReadings
from backend.significance import RIVAL_CHI_SQUARE

Array = NDArray[np.float64]

NOTABLE_S = 0.025
"""Largest delay that exposure, transfer and the jitter of cheap cameras' stamps cause on one clock."""
SURE = 6.0
"""Standard deviations by which a delay must differ from none, or from that before a step. A step is looked
for between any two pictures, so that chance has thousands of trials."""
LEAST_TURNS = 15
"""Fewer determine the noise of an axis, its bias and the delay too poorly."""
_BLOCKS = 12
"""Blocks of time whose scores are compared."""
_ROUNDS = 3
_FINE_STEP_S, _FINE_S = 0.001, NOTABLE_S
"""Step and reach of the search around a delay: within a step, a lively vehicle changes its rate by less than
the noise of gyro and pictures."""
GAIN_ERROR, _GAIN_SURE = 0.1, 3.0
"""Largest error of a gyro's gain, three times what makers of small ones state, and standard deviations of the
gain that are allowed besides."""


@dataclass(frozen=True)
class ClockPiece:
    """A time in which the delay of the pictures' stamps is constant."""

    begin_s: float
    """Stamp of its first picture; minus infinity for the first piece."""
    delay_s: float
    """Mean of the posterior: how much later a picture is stamped than the gyro's reading of that moment."""
    std_s: float
    """Standard deviation of the posterior, which covers all delays that explain the turns as well, and what
    the sampling of the gyro leaves open."""
    far_std_s: float = 0.0
    """Its share from delays that are farther away than the reach of the finer search."""
    after_s: float = float("-inf")
    """Stamp of the last picture that is surely of the piece before."""

    @property
    def known(self) -> bool:
        """Return whether no delay that matters could hide."""
        return self.std_s < NOTABLE_S / 2

    def differs(self, delay_s: float, std_s: float = 0.0) -> bool:
        """Return whether its delay differs notably and surely from another one."""
        return abs(self.delay_s - delay_s) >= max(NOTABLE_S, SURE * float(np.hypot(self.std_s, std_s)))


@dataclass(frozen=True)
class PictureClock:
    """Delay of the pictures' stamps behind the gyro's."""

    pieces: tuple[ClockPiece, ...]
    """In order of time; more than one where the clock steps."""
    longest_s: float
    """Longest delay that was looked for."""

    def stds_at(self, stamps_s: Array) -> Array:
        """Return the standard deviation (n,) of the delay of pictures stamped ``stamps_s`` (n,)."""
        return np.array([piece.std_s for piece in self.pieces])[self.numbers_at(stamps_s)]

    def numbers_at(self, stamps_s: Array) -> NDArray[np.int64]:
        """Return the number of the piece (n,) of pictures stamped ``stamps_s`` (n,)."""
        return np.searchsorted([piece.begin_s for piece in self.pieces[1:]], stamps_s, side="right")

    def begun_at_pictures(self, stamps_s: Array) -> PictureClock:
        """Return the clock whose pieces begin at pictures, of all pictures' stamps (n,) in order of time.

        A step lies between any two pictures of the turn in which it was found, or near it where few turns are
        left. A clock that is set forward makes the time between two pictures longer by the step. Elsewhere
        pictures would get earlier stamps than those before them.
        """
        lasts_s, pieces = np.diff(stamps_s), list(self.pieces)
        for k, (before, after) in enumerate(zip(self.pieces, self.pieces[1:], strict=False), start=1):
            step_s = after.delay_s - before.delay_s
            possible = np.flatnonzero(lasts_s > step_s)
            if len(possible):
                outside_s = np.maximum(
                    after.after_s - stamps_s[possible], stamps_s[possible + 1] - after.begin_s
                )
                unusual_s = np.abs(lasts_s[possible] - step_s - np.median(lasts_s))
                best = possible[np.lexsort((unusual_s, np.maximum(outside_s, 0.0)))[0]]
                pieces[k] = replace(after, begin_s=float(stamps_s[best + 1]))
        return replace(self, pieces=tuple(pieces))

    def delayed(self, delay_s: float, std_s: float) -> PictureClock:
        """Return the clock with another ``delay_s`` in every piece, whose standard deviation is then
        ``std_s``."""
        pieces = [replace(p, delay_s=p.delay_s + delay_s, std_s=std_s) for p in self.pieces]
        return replace(self, pieces=tuple(pieces))

    def delays_at(self, stamps_s: Array) -> Array:
        """Return the delay (n,) of pictures stamped ``stamps_s`` (n,); 0 where it is not known."""
        delays_s = [piece.delay_s if piece.known else 0.0 for piece in self.pieces]
        return np.array(delays_s)[self.numbers_at(stamps_s)]


def picture_clock(
    stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings
) -> PictureClock | None:
    """Estimate the delay of pictures with attitudes (n, 3, 3) at ``stamps_s`` (n,), sorted.

    Turns within one ``chain`` (n,) of attitudes are known, turns between two are not. Returns None where too
    few pictures overlap with the readings, or where the gyro does not explain how the pictures turn, whatever
    the delay.
    """
    residuals = delay_residuals(stamps_s, w_R_b, chain, readings)
    clock = None if residuals is None else clock_of(residuals)
    if clock is None:
        return None
    clock = clock.begun_at_pictures(stamps_s)
    number = clock.numbers_at(stamps_s)
    pieces = [
        finer(piece, stamps_s[number == k], w_R_b[number == k], chain[number == k], readings)
        for k, piece in enumerate(clock.pieces)
    ]
    return replace(clock, pieces=tuple(pieces))


def clock_of(residuals: DelayResiduals, gain_error: float = GAIN_ERROR) -> PictureClock | None:
    """Estimate the delay from the turns; None as for ``picture_clock``.

    ``gain_error`` is the largest relative error of the turns that an instrument causes.
    """
    if len(residuals.begin_s) < LEAST_TURNS:
        return None
    pieces = _pieces(residuals, float("-inf"), piece_of(residuals, float("-inf")))
    if not explained(residuals, pieces, gain_error):
        return None
    return PictureClock(tuple(pieces), float(residuals.delays_s[-1]))


def piece_of(residuals: DelayResiduals, begin_s: float) -> ClockPiece:
    """Return mean and standard deviation of the posterior over the delays."""
    turn_cost = turn_costs(residuals.squares)
    delays_s, weight = grid_posterior(residuals.delays_s, turn_cost.sum(axis=0))
    mean_s = float(weight @ delays_s)
    weight = grid_posterior(residuals.delays_s, robust_cost(turn_cost))[1]
    off_s = delays_s - mean_s
    # A width below the step of the grid is not resolved.
    variance = weight @ off_s**2 + (delays_s[1] - delays_s[0]) ** 2 / 12 + residuals.sampling_std_s**2
    far = weight @ np.where(np.abs(off_s) > _FINE_S, off_s, 0.0) ** 2
    return ClockPiece(begin_s, mean_s, float(np.sqrt(variance)), float(np.sqrt(far)))


def finer(
    piece: ClockPiece, stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings
) -> ClockPiece:
    """Return the piece after a search with small steps around its delay; itself where its width exceeds them.

    The arguments are those of ``picture_clock`` for the pictures of the piece. In a lively flight the
    likelihood is narrower than a step of the search over all delays.
    """
    if 4 * np.sqrt(piece.std_s**2 - piece.far_std_s**2) > _FINE_S:
        return piece
    rows, steps = thinned(stamps_s), round(_FINE_S / _FINE_STEP_S)
    delays_s = piece.delay_s + _FINE_STEP_S * np.arange(-steps, steps + 1, dtype=np.float64)
    residuals = residuals_at(delays_s, stamps_s[rows], w_R_b[rows], chain[rows], readings)
    if residuals is None or len(residuals.begin_s) < LEAST_TURNS:
        return piece
    found = piece_of(residuals, piece.begin_s)
    return replace(found, std_s=float(np.hypot(found.std_s, piece.far_std_s)), far_std_s=piece.far_std_s)


def robust_cost(turn_cost: Array) -> Array:
    """Return how much each delay (g,) costs more than the best one, from the costs (n, g) of the turns.

    Where turns, or blocks of time, disagree by more than the model implies, the difference is known no better
    than its variation between them allows (Vuong 1989, Econometrica 57, equation 3.1). That is so at other
    periods of a regular motion: the gyro's own noise then makes one of equal delays the best by chance.
    """
    excess = turn_cost - turn_cost[:, [int(turn_cost.sum(axis=0).argmin())]]
    total = excess.sum(axis=0)
    return np.asarray(np.minimum(total, 4 * total**2 / np.maximum(variation(excess, excess), 1e-300)))


def variation(excess: Array, of_blocks: Array) -> Array:
    """Return the variance of the sum of costs (n, ...), by their scatter or that of ``of_blocks`` (m, ...) of
    them in blocks of time, whichever is larger."""
    spread = ((excess - excess.mean(axis=0)) ** 2).sum(axis=0)
    blocks = np.stack([block.sum(axis=0) for block in np.array_split(of_blocks, _BLOCKS)])
    between = ((blocks - blocks.mean(axis=0)) ** 2).sum(axis=0) * _BLOCKS / (_BLOCKS - 1)
    return np.asarray(np.maximum(spread, between))


def _pieces(residuals: DelayResiduals, begin_s: float, whole: ClockPiece) -> list[ClockPiece]:
    """Split at a step of the clock, and again on both sides of it, as long as the delays differ surely."""
    if len(residuals.begin_s) < 2 * LEAST_TURNS + 1:
        return [whole]
    stop, start = _likeliest_step(residuals)
    before, after = residuals.part(slice(None, stop)), residuals.part(slice(start, None))
    first, second = piece_of(before, begin_s), piece_of(after, float(after.begin_s[0]))
    if not first.differs(second.delay_s, second.std_s):
        return [whole]
    second = replace(second, after_s=float(before.end_s[-1]))
    return [*_pieces(before, begin_s, first), *_pieces(after, second.begin_s, second)]


def _likeliest_step(residuals: DelayResiduals) -> tuple[int, int]:
    """Return the end of the turns before the likeliest step of the clock, and the beginning of those after.

    The step lies within the turn between them, which no delay explains, or between two turns.
    """
    squares, n = residuals.squares, len(residuals.begin_s)
    variance = squares[:, :, int(turn_costs(squares).sum(axis=0).argmin())].mean(axis=1)
    start = np.arange(LEAST_TURNS + 1, n - LEAST_TURNS + 1)
    parted = start[residuals.begin_s[start] > residuals.end_s[start - 1]]
    stops, starts = np.concatenate([start - 1, parted]), np.concatenate([start, parted])
    # A turn that is left out would have cost as much as its three components have variances.
    left_out, cost, step_s = np.where(stops < starts, 3.0, 0.0), np.zeros(len(stops)), 0.0
    for _ in range(_ROUNDS):
        sums = np.cumsum(np.tensordot(1 / np.maximum(variance, 1e-24), squares, axes=1), axis=0)
        before, after = sums[stops - 1], sums[-1] - sums[starts - 1]
        cost = before.min(axis=1) + after.min(axis=1) + left_out
        best = int(np.argmin(cost))
        first, second = int(before[best].argmin()), int(after[best].argmin())
        sides = squares[:, : stops[best], first], squares[:, starts[best] :, second]
        variance = np.concatenate(sides, axis=1).mean(axis=1)
        step_s = float(residuals.delays_s[second] - residuals.delays_s[first])
    # Of the turns that are as likely, the step lies in that whose duration it makes unusual.
    lasts_s = residuals.begin_s[starts] - residuals.end_s[stops - 1]
    usual_s = float(np.median(residuals.end_s - residuals.begin_s))
    unusual = np.abs(lasts_s - step_s - np.where(stops < starts, usual_s, 0.0))
    best = int(np.argmin(np.where(cost < cost.min() + RIVAL_CHI_SQUARE, unusual, np.inf)))
    return int(stops[best]), int(starts[best])


def explained(residuals: DelayResiduals, pieces: list[ClockPiece], gain_error: float) -> bool:
    """Return whether pictures and gyro turn by the same angles, bias apart.

    A wrong sign, axis or unit of the gyro leaves another ratio of the two at any delay; at a false delay of
    an irregular motion it is below 1 as well.
    """
    delays_s = PictureClock(tuple(pieces), 0.0).delays_at(residuals.begin_s)
    nearest = np.abs(residuals.delays_s - delays_s[:, None]).argmin(axis=1)
    difference = np.take_along_axis(residuals.difference, nearest[:, None, None], axis=1)[:, 0]
    lasts_s = residuals.end_s - residuals.begin_s
    left, turned = (
        values - np.outer(lasts_s, lasts_s @ values / (lasts_s @ lasts_s))
        for values in (difference, residuals.change)
    )
    by_gyro = turned - left
    size = max(float((by_gyro**2).sum()), 1e-300)
    off = float((by_gyro * left).sum()) / size
    std = np.sqrt(float((left**2).mean()) / size)
    return bool(abs(off) < gain_error + _GAIN_SURE * std)
