"""Innovations that no term describes: spectral lines, and many outliers.

Whitened innovations have a flat spectrum. A bin far above its neighbours is an oscillation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.core.arrays import Array
from slam.criticism.kalman.filter import OUTLIER, USED
from slam.criticism.kalman.innovations import FilterPass
from slam.criticism.kalman.readings import CHANNELS, RANGE
from slam.data_quality.finding import Remark
from slam.data_quality.oscillation import FEWEST, Vibration, common_line

LARGEST_SHARE, FEWEST_OUTLIERS = 0.05, 5
"""Share and number of a channel's outliers above which they are reported. Noise with the tails of Student's t
of four degrees of freedom has 0.4 %."""


def vibration_of(passes: Sequence[FilterPass]) -> list[Vibration]:
    """Return the least probable line of all channels; none where noise may make each."""
    each = (common_line(name, [_white(c, run) for run in passes]) for c, name in enumerate(CHANNELS))
    return sorted((line for line in each if line is not None), key=lambda line: line.log10_chance)[:1]


def _white(channel: int, run: FilterPass) -> tuple[Array, float]:
    """Return a channel's whitened innovations at even times (0 where unused), and the time step."""
    rows, innovations, status = run.of_channel(channel)
    used = status == USED
    if used.sum() < FEWEST:
        return np.zeros(0), 0.0
    times_s, white = run.record.times_s[rows], np.where(used, innovations, 0.0)
    step_s = float(np.median(np.diff(times_s)))
    at = np.rint((times_s - times_s[0]) / step_s).astype(np.int64)
    return np.asarray(np.bincount(at, weights=white - white.mean()), dtype=float), step_s


def outliers_of(passes: Sequence[FilterPass]) -> list[Remark]:
    """Return the channels with more rejected readings than noise explains, spikes aside."""
    found = []
    for channel, name in enumerate(CHANNELS):
        if channel == RANGE:
            continue
        status = np.concatenate([run.of_channel(channel)[2] for run in passes])
        out = int(np.count_nonzero(status == OUTLIER))
        both = out + int(np.count_nonzero(status == USED))
        if out >= FEWEST_OUTLIERS and out > LARGEST_SHARE * both:
            far = f"{out} of {both} readings of {name} are far from anything that the model allows"
            found.append(Remark(far, channel=name))
    return found
