"""The time offset between camera and instruments: found with the map, and taken out of the pictures' stamps.

The pictures show how the vehicle turned, and the gyro measured it: the offset is what makes both agree
(`backend.clocks.picture_clock`). All other instruments are assumed to share the gyro's clock.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.clocks.picture_clock import ClockPiece, PictureClock
from backend.clocks.windows import ClockDisagreement
from slam.core.clock_steps import step_sizes
from slam.core.instrument_errors import ClockErrors, ClockSpan
from slam.core.messages import Message, note, warning
from slam.core.units import with_error

Array = NDArray[np.float64]

_EDGE_S = 0.02
"""A delay this near to the longest one of the search may in truth be longer; two steps of the search."""
NO_CORRECTION = PictureClock((ClockPiece(float("-inf"), 0.0, 0.0),), float("inf"))


def clock_correction(clock: PictureClock | None, stamps_s: Array) -> PictureClock:
    """Return the delays to be taken out of the pictures' stamps (n,); none where they are too small or vague.

    A clock that steps is corrected as a whole or not at all, because one side alone would tear the order of
    the pictures. Delays that would tear it cannot be true.
    """
    if clock is None or not all(_correctable(piece, clock) for piece in clock.pieces):
        return NO_CORRECTION
    in_order, corrected_s = np.diff(stamps_s) > 0, stamps_s - clock.delays_at(stamps_s)
    if (in_order & (np.diff(corrected_s) <= 0)).any():
        return NO_CORRECTION
    kept = [piece if piece.differs(0.0) else replace(piece, delay_s=0.0) for piece in clock.pieces]
    return replace(clock, pieces=tuple(kept)) if any(piece.delay_s for piece in kept) else NO_CORRECTION


def finer_correction(clock: PictureClock | None, taken_out: PictureClock, stamps_s: Array) -> PictureClock:
    """Return the whole correction of the pictures' stamps (n,) after ``clock`` was found in a map that lacks
    the delays ``taken_out``.

    It is ``taken_out`` itself where nothing is left that exceeds the estimate's own error.
    """
    if taken_out is NO_CORRECTION:
        return clock_correction(clock, stamps_s)
    if clock is None or len(clock.pieces) > 1 or not clock.pieces[0].known:
        return taken_out
    (left,) = clock.pieces
    return taken_out if abs(left.delay_s) < 2 * left.std_s else taken_out.delayed(left.delay_s, left.std_s)


def clock_displacements(clock: PictureClock, w_T_b: Array, stamps_s: Array, camera_stamps_s: Array) -> Array:
    """Return (n, 6, pieces) right perturbations of poses (n, 4, 4) by one standard deviation of each delay.

    ``stamps_s`` (n,) are their times, and ``camera_stamps_s`` (n,) those of the pictures' clock. An error of
    the time moves a pose along its own motion, which is that between its neighbours in time.
    """
    found = np.zeros((len(w_T_b), 6, len(clock.pieces)))
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    if len(placed) < 2:
        return found
    poses, at_s = w_T_b[placed], stamps_s[placed]
    number = np.arange(len(placed))
    before, after = np.maximum(number - 1, 0), np.minimum(number + 1, len(placed) - 1)
    lasts_s = np.maximum(at_s[after] - at_s[before], 1e-9)
    speed = se3.log(se3.inverse(poses[before]) @ poses[after]) / lasts_s[:, None]
    piece = clock.numbers_at(camera_stamps_s[placed])
    found[placed, :, piece] = speed * clock.stds_at(camera_stamps_s[placed])[:, None]
    return found


def clock_errors(clock: PictureClock | None, taken_out: PictureClock) -> ClockErrors | None:
    """Summarise the delays of the pictures' clock: those taken out, or else those found; None without any."""
    found = clock if taken_out is NO_CORRECTION else taken_out
    if found is None:
        return None
    spans = [
        ClockSpan(
            begin_s=None if np.isinf(piece.begin_s) else piece.begin_s,
            delay_s=piece.delay_s,
            delay_std_s=piece.std_s,
            taken_out=found is taken_out,
        )
        for piece in found.pieces
    ]
    return ClockErrors(tuple(spans))


def clock_warning(clock: PictureClock | None, taken_out: PictureClock) -> Message | None:
    """Describe a delay or a step that was corrected, or that the flight does not determine; else None."""
    if taken_out is not NO_CORRECTION:
        return _corrected(taken_out)
    if clock is None or all(piece.known for piece in clock.pieces):
        return None
    return warning(
        "the time offset between camera and imu0 cannot be determined from this flight and is taken as zero",
        "to have it found, fly with more turns and tilts",
    )


def clock_contradiction(clock: PictureClock | None, taken_out: PictureClock) -> Message | None:
    """Describe a delay or a step that remains in the map, so that its poses carry wrong times; else None."""
    if clock is None or not any(piece.differs(0.0) for piece in clock.pieces):
        return None
    if taken_out is not NO_CORRECTION:
        return warning(
            "the clocks of camera and imu0 still disagree after correction: the stamps of some poses may be "
            "wrong",
            "check the stamps in cam0/data.csv",
        )
    if len(clock.pieces) > 1:
        return warning(
            f"{_steps(clock)}",
            "one side of it is too vague to correct: stamps of poses, and instruments read at them, are "
            "wrong",
            "check the stamps in cam0/data.csv",
        )
    (piece,) = clock.pieces
    return warning(
        f"{_offset(piece)}, or more, too much to correct: the instruments are read at wrong times",
        f"shift the stamps in cam0/data.csv by {-1e3 * piece.delay_s:+.0f} ms and run again",
    )


def disagreement_warning(left: tuple[ClockDisagreement, ...]) -> Message | None:
    """Describe when and by how much the pictures' stamps are still wrong; None where they are nowhere."""
    if not left:
        return None
    spans = [
        f"{with_error(span.delay_s, span.std_s, '+')} s from {span.begin_s:.2f} to {span.end_s:.2f} s"
        for span in left[:3]
    ]
    more = f" and in {len(left) - 3} more spans of time" if len(left) > 3 else ""
    return warning(
        f"the clock of cam0 differs from imu0's by {', '.join(spans)}{more} (a step or a drift), which is "
        "not corrected: poses there may be wrong by more than is told",
        "check the stamps in cam0/data.csv",
    )


def _correctable(piece: ClockPiece, clock: PictureClock) -> bool:
    return piece.known and abs(piece.delay_s) < clock.longest_s - _EDGE_S


def _corrected(taken_out: PictureClock) -> Message:
    where = "corrected in the map, whose poses are stamped by the imu's clock"
    if len(taken_out.pieces) > 1:
        return warning(f"{_steps(taken_out)}: {where}", "check cam0/data.csv before you use its stamps")
    (piece,) = taken_out.pieces
    return note(
        f"{_offset(piece)}: {where}",
        f"for other programs shift the stamps in cam0/data.csv by {-1e3 * piece.delay_s:+.0f} ms",
    )


def _offset(piece: ClockPiece) -> str:
    return (
        f"pictures are stamped {with_error(1e3 * abs(piece.delay_s), 1e3 * piece.std_s)} ms "
        f"{'after' if piece.delay_s > 0 else 'before'} the imu's readings of the same moment"
    )


def _steps(clock: PictureClock) -> str:
    return f"the clock of cam0 steps against imu0 by {step_sizes(clock)}"
