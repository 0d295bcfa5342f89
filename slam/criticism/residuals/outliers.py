"""Readings that the filter rejected: few are a fault of an instrument, many are the effect itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.kalman.filter import OUTLIER, USED
from slam.criticism.kalman.innovations import FilterPass
from slam.criticism.kalman.readings import CHANNELS, SONAR, place_of
from slam.criticism.kalman.record import Record

LARGEST_SHARE, FEWEST = 0.05, 5
"""Share and number of a channel's outliers above which they are reported. Noise with the tails of Student's t
of four degrees of freedom has 0.4 %."""


def outliers_of(records: Sequence[Record], passes: Sequence[FilterPass]) -> list[str]:
    """Return one phrase for each channel with more outliers than noise explains; a sonar's are spikes."""
    found = []
    for channel, name in enumerate(CHANNELS):
        kind, column = place_of(channel)
        if kind == SONAR:
            continue
        judged = [
            run.status[record.kinds == kind, column] for record, run in zip(records, passes, strict=True)
        ]
        status = np.concatenate(judged)
        out = int(np.count_nonzero(status == OUTLIER))
        both = out + int(np.count_nonzero(status == USED))
        if out >= FEWEST and out > LARGEST_SHARE * both:
            found.append(f"{out} of {both} readings of {name} are far from anything that the model allows")
    return found
