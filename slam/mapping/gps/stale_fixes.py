"""Fixes that repeat the place of the one before to the last digit while the pictures move on.

A receiver that has lost its satellites, or is slower than the camera, repeats its last place. Noise never
repeats, so that such a fix is no measurement; of a vehicle at rest with coarse digits it may be one. Whether
it moved is measured by the map, in the lengths of the fixes that do not repeat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.wording import either
from slam.core.flight_info import MOST_LISTED_FIXES
from slam.core.messages import Message, about
from slam.core.names import listed
from slam.core.units import length
from slam.mapping.gps.consensus import STATED_SIGMAS, nominal_limit_m, rough_turn
from slam.mapping.gps.messages import too_many

Array = NDArray[np.float64]


def moved_since_m(
    here_m: Array,
    there_m: Array,
    repeats: NDArray[np.bool_],
    *,
    metric: bool,
    nominal_std_m: tuple[float, float, float],
) -> Array:
    """Return how far the map moved since the fix that each (n,) repeats, in metres; NaN for fixes that count.

    ``here_m`` (n, 3) is the level, unplaced map at the fixes ``there_m`` (n, 3) in order of time; NaN marks
    what it does not cover. ``repeats`` (n,) says which have the place of the one before. Where the map moves
    less during a run than a fix is uncertain, its fixes count.
    """
    moved_m, std_m = np.full(len(there_m), np.nan), nominal_limit_m(nominal_std_m) / STATED_SIGMAS
    updated = ~repeats
    turn = rough_turn(here_m[updated], there_m[updated], metric)
    if turn is None:
        return moved_m
    first = np.maximum.accumulate(np.where(updated, np.arange(len(updated)), 0))
    away_m = abs(turn) * np.linalg.norm(here_m[:, :2] - here_m[first, :2], axis=1)
    farthest_m = np.zeros(len(updated))
    np.fmax.at(farthest_m, first, away_m)
    return np.where(~updated & (farthest_m[first] > std_m), away_m, np.nan)


def stale_line(names: tuple[str, ...], moved_m: Array) -> Message | None:
    """Return the message about repeats among fixes (n,): a note, or a warning if they are many; else None.

    ``moved_m`` is what `moved_since_m` returns.
    """
    stale = np.flatnonzero(np.isfinite(moved_m))
    if not len(stale):
        return None
    n = len(stale)
    line = about(
        "gps0",
        f"{n} of {len(names)} fixes {either(n, 'repeats', 'repeat')} the place of the one before to "
        f"the last digit while the pictures move by up to {length(float(moved_m[stale].max()))}, and "
        f"{either(n, 'is', 'are')} not used: {listed([names[k] for k in stale], MOST_LISTED_FIXES)}",
    )
    if not too_many(n, len(names)):
        return line.as_note()
    return line.extended(
        "the receiver stopped, or is slower than the camera: only the others place the map",
        "check them, or add control points",
    )
