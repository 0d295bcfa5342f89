"""Height of the first picture, where no instrument measures it.

Steps between pictures are in heights of the camera, and the accelerometer tells their accelerations in
metres. The two agree at one height. The filter finds it from a start nearby; the start is the most likely of
many.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.ekf.inputs import FilterModel, VisualStep, renumber_steps
from backend.ekf.records import UNPREDICTABLE
from backend.errors import BackendError
from backend.quantiles import chi_square_limit
from slam.inertial.filter_input import Adjustments, FilterInput, PictureStart, filter_input
from slam.inertial.instruments import InertialTrust

if TYPE_CHECKING:
    from backend.ekf.results import Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

START_ROUNDS = 4
"""Rounds of the smoother after which a height that was a quarter off at the start, or a heading of 30°, has
settled."""
_HEIGHTS_M = np.geomspace(0.2, 200.0, 18)
"""Heights that are tried: those of small vehicles, so close that the best one is at most a quarter off."""


def find_picture_start(
    flight: Flight, trust: InertialTrust, stamps_s: Array, steps: tuple[VisualStep, ...], lasts_s: float
) -> PictureStart | None:
    """Return the first picture of the ``steps`` between pictures at ``stamps_s`` (n,), and its height.

    The first ``lasts_s`` seconds count. The result is None where a range or a position tells heights, and
    where there are no steps or no height agrees with the readings. Raises ``InputError`` where too little
    was recorded.
    """
    if not steps:
        return None
    readings = filter_input(flight, trust).readings
    if readings.range_m is not None or readings.w_p_antenna_m is not None:
        return None
    first_s = float(stamps_s[steps[0].i])
    scores = []
    for height_m in _HEIGHTS_M.tolist():
        start = PictureStart(first_s, height_m)
        try:
            scores.append(
                likelihood_of(_tracked(flight, trust, stamps_s, steps, start, lasts_s, rounds=0)[1])
            )
        except BackendError:
            scores.append(-np.inf)
    if not np.isfinite(scores).any():
        return None
    start = PictureStart(first_s, float(_HEIGHTS_M[np.argmax(scores)]))
    try:
        inputs, found = _tracked(flight, trust, stamps_s, steps, start, lasts_s, START_ROUNDS)
    except BackendError:
        return None
    assert found.smoothed is not None
    height_m = float(found.smoothed.w_T_b[0, 2, 3])
    return PictureStart(inputs.start_s, height_m) if height_m > 0 else None


def _tracked(
    flight: Flight,
    trust: InertialTrust,
    stamps_s: Array,
    steps: tuple[VisualStep, ...],
    start: PictureStart,
    lasts_s: float,
    rounds: int,
) -> tuple[FilterInput, Track]:
    from backend.ekf.track import track

    inputs = filter_input(flight, trust, Adjustments(start=start))
    until_s = min(inputs.end_s, inputs.start_s + lasts_s)
    inside = (stamps_s >= inputs.start_s) & (stamps_s <= until_s)
    readings = replace(inputs.readings.between(inputs.start_s, until_s), steps=renumber_steps(steps, inside))
    return inputs, track(readings, stamps_s[inside], inputs.start, inputs.model, rounds=rounds, clone="each")


def likelihood_of(found: Track) -> float:
    """Return the log likelihood; a step that no camera above the floor sees counts as one at its gate."""
    pictures = found.channels.get("pictures")
    unseen = pictures.count(UNPREDICTABLE) if pictures is not None else 0
    likelihood = sum(channel.log_likelihood for channel in found.channels.values())
    return likelihood - 0.5 * unseen * chi_square_limit(FilterModel.gate_probability, 1)
