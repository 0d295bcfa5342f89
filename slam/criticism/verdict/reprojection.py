"""Reprojection errors: pixels between a point of the floor in a picture and where the flight's path predicts
it.

The path comes from all other instruments. Within its uncertainty the pictures may turn and shift, so that the
remaining error is the camera's.
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
    """Return root mean square errors over all matches of the flights with pictures, before and after; empty
    where none has any."""
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


def _square_px(record: Record, parameters: FilterParameters) -> tuple[float, int]:
    """Return the mean square error of one coordinate of a match, and the number of coordinates."""
    assert record.matches is not None
    found = reprojection_score(record, record.matches, parameters, ())
    # Residuals are weighed by their own noise, which differs little from match to match.
    noise = float(np.mean(record.matches.std_px**2))
    return found.chi_square / max(found.rows, 1) * noise, found.rows
