"""What the pictures miss: by how many pixels a point of the floor is off where the flight's path carries it.

The path is what all other instruments make known; within what they leave open of it the pictures may turn and
shift, so that what is left over is the camera's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.cause import NOT_AHEAD_S, ChannelError
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record
from slam.criticism.threads import in_threads


def reprojection_errors(
    records: Sequence[Record], before: Sequence[FilterParameters], after: Sequence[FilterParameters]
) -> tuple[ChannelError, ...]:
    """Root mean square over all matches of the flights that have pictures, under beliefs about each flight;
    empty where none has."""
    seen = [k for k, record in enumerate(records) if record.matches is not None]
    if not seen:
        return ()
    tried = [(k, side[k]) for side in (before, after) for k in seen]
    squares = in_threads(lambda it: _square_px(records[it[0]], it[1]), tried)
    rms = [
        float(np.sqrt(np.average([s for s, _ in side], weights=[m for _, m in side])))
        for side in (squares[: len(seen)], squares[len(seen) :])
        if sum(m for _, m in side) > 0
    ]
    if len(rms) < 2:
        return ()
    return (ChannelError("reprojection", "px", NOT_AHEAD_S, rms[0], rms[1]),)


def _square_px(record: Record, setting: FilterParameters) -> tuple[float, int]:
    """Mean square of what one coordinate of a match is off by, and how many there are."""
    assert record.matches is not None
    found = reprojection_score(record, record.matches, setting, ())
    # Residuals are weighed by their own noise, which differs little from match to match.
    noise = float(np.mean(record.matches.std_px**2))
    return found.chi_square / max(found.rows, 1) * noise, found.rows
