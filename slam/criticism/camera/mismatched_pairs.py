"""Pairs of pictures that are matched to a place of the floor where the flight cannot have been.

On a repetitive floor, matches with the wrong copy are consistent, also between pairs. The other instruments
show the motion between two pictures, and no camera error of the catalogue displaces a picture by a quarter.
The residual of such a pair is a thousand standard deviations, so one pair outweighs a flight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.criticism.camera.camera_path import camera_path
from slam.criticism.camera.reprojection import residuals
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record

FAR = 0.25
"""Least error in picture widths, beyond the uncertainty of the path."""
SURE = 5.0
MOST = 0.1
"""Greatest share of the pairs; with more of them the path or the camera model is wrong."""


def without_mismatched_pairs(record: Record, parameters: FilterParameters) -> tuple[Record, str]:
    """Return the record without such pairs, and a message about them; empty if there are none."""
    matches = record.matches
    if matches is None:
        return record, ""
    along = camera_path(record, matches, parameters)
    known = np.flatnonzero(along.holds(matches.earlier, matches.later))
    if len(known) == 0:
        return record, ""
    off_px, std_px = residuals(matches, parameters, along)
    pair = matches.earlier[known] * len(matches.stamps_s) + matches.later[known]
    pairs, pair_of = np.unique(pair, return_inverse=True)
    stray = np.array(
        [
            np.median(off_px[pair_of == k] - SURE * std_px[pair_of == k]) > FAR * matches.camera.size_px[0]
            for k in range(len(pairs))
        ]
    )
    if not 0 < stray.sum() <= MOST * len(pairs):
        return record, ""
    kept = np.ones(len(matches.earlier), dtype=bool)
    kept[known[stray[pair_of]]] = False
    description = (
        f"{record.name}: {stray.sum()} of {len(pairs)} pairs of pictures match another place of the floor "
        "than the vehicle can have been at; they were left out"
    )
    return replace(record, matches=matches.some(kept)), description
