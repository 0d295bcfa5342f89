"""Steps in the floor: boxes of any height under the way, or pits in it.

The height is predicted without the sonar. What the sonar reads beside it drifts slowly over a level floor,
and is less as long as a box is below. Spikes come back at once; what a lag, a scale, a tilt or a slope makes
goes with height, climb, tilt or place, and is taken out before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.criticism.cause import Interval
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.blind_height import Beside, beside
from slam.criticism.residuals.box_filter import Heights, Noise, likeliest
from slam.criticism.residuals.reading_anomalies import ReadingAnomaly, predicted_by_others
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAST_NOISE_M = 1e-4
DRIFTS_M = (1e-3, 2e-3, 4e-3, 8e-3)
"""From reading to reading, as the likelihood has it."""
FEWEST_EDGES, FEWEST_BOXES = 4, 2
LEAST_NATS = 25.0
SHARP = 0.6
"""Share of an edge that lies between two readings in a row, in the mean over all."""
SHORTEST_S = 0.22
"""Over a box, in the median: spikes are shorter."""
LEAST_SPREAD_M = 0.02
"""Of the heights of boxes, so few tell it."""
ROUNDS = 2
"""What goes with the motion is fitted anew once the boxes are known."""


@dataclass(frozen=True)
class _Boxes:
    """The likeliest boxes of one flight."""

    seen: Beside
    height_m: Array
    """(readings,) what the sonar reads beside its prediction, without what goes with the motion."""
    over_m: Array
    """(readings,) height of the box below; 0 over the floor."""
    edges: Ints
    """(edges,) index of the first reading after each."""
    nats: float
    """Log likelihood, ..."""
    level_nats: float
    """... and that of a level floor."""
    noise: Noise

    @property
    def gain_nats(self) -> float:
        """What the boxes explain."""
        return self.nats - self.level_nats

    @property
    def rise_m(self) -> Array:
        """(edges,) change of ``over_m``."""
        return np.asarray(self.over_m[self.edges] - self.over_m[self.edges - 1])

    @property
    def heights_m(self) -> Array:
        """(boxes,) of those that are come to."""
        over = self.over_m[self.edges]
        return np.asarray(over[over > 0.0])

    @property
    def stays_s(self) -> Array:
        """(boxes,) time over each."""
        if not len(self.edges):
            return np.zeros(0)
        ends = np.append(self.edges, len(self.over_m) - 1)
        return np.asarray(np.diff(self.seen.times_s[ends])[self.over_m[self.edges] > 0.0])


def without_boxes(
    records: Sequence[Record], setting: FilterParameters
) -> tuple[list[Record], list[ReadingAnomaly]]:
    """The records with ranges as over a level floor, and the steps where there are some."""
    seen = in_threads(lambda record: beside(record, setting), records)
    sign, boxes = 1.0, _found(seen, 1.0)
    if _share(boxes) > 0.5:
        # What most readings of all flights are over is the floor, and there are pits in it.
        sign, boxes = -1.0, _found(seen, -1.0)
    if not _are_boxes(boxes, sign):
        return list(records), []

    def by_others(own: _Boxes, others: Sequence[_Boxes]) -> float:
        """Nats of the flight's boxes, with such heights as the others' have."""
        known = np.concatenate([found.heights_m for found in others])
        if len(known) == 0 or len(own.edges) == 0:
            return 0.0
        usual = Heights(float(known.mean()), math.hypot(float(known.std()), LEAST_SPREAD_M))
        return _boxes(own.seen, own.height_m, own.noise, sign, usual).nats - own.level_nats

    parameters = _parameters(boxes)
    nats = tuple(found.gain_nats for found in boxes)
    levelled = [_levelled(r, found, sign) for r, found in zip(records, boxes, strict=True)]
    return levelled, [ReadingAnomaly("floor_steps", parameters, nats, predicted_by_others(boxes, by_others))]


def _parameters(boxes: Sequence[_Boxes]) -> dict[str, Interval]:
    heights = np.concatenate([found.heights_m for found in boxes])
    height, share = float(heights.mean()), _share(boxes)
    std = math.hypot(float(heights.std()), boxes[0].noise.std_m) / math.sqrt(len(heights))
    spread = math.sqrt(share * (1.0 - share) / len(heights))
    return {
        "height": Interval(height, "m", height - 1.96 * std, height + 1.96 * std),
        "share": Interval(share, "1", max(share - 1.96 * spread, 0.0), min(share + 1.96 * spread, 1.0)),
    }


def _are_boxes(boxes: Sequence[_Boxes], sign: float) -> bool:
    """Whether what was found is enough, sharp, and no spikes."""
    rises = np.concatenate([found.rise_m for found in boxes])
    stays = np.concatenate([found.stays_s for found in boxes])
    heights = np.concatenate([found.heights_m for found in boxes])
    if len(rises) < FEWEST_EDGES or np.sum(heights > boxes[0].noise.std_m) < FEWEST_BOXES:
        return False
    jumps = np.concatenate([-sign * (f.height_m[f.edges] - f.height_m[f.edges - 1]) for f in boxes])
    return bool(
        sum(found.gain_nats for found in boxes) > LEAST_NATS
        and jumps @ rises > SHARP * (rises @ rises)
        and np.median(stays) >= SHORTEST_S
    )


def _share(boxes: Sequence[_Boxes]) -> float:
    over = np.concatenate([found.over_m for found in boxes])
    return float(np.mean(over > 0.0)) if len(over) else 0.0


def _found(seen: Sequence[Beside], sign: float) -> list[_Boxes]:
    """The likeliest boxes (``sign`` 1) or pits (-1), whatever the drift; a level floor may have another."""
    over, levels = [np.zeros(len(flight.rows)) for flight in seen], []
    for _ in range(ROUNDS):
        heights = [flight.without_motion(-sign * o) for flight, o in zip(seen, over, strict=True)]
        flown = list(zip(seen, heights, strict=True))
        jumps = np.concatenate([flight.jumps_m(height) for flight, height in flown])
        std_m = max(robust_std(jumps) / math.sqrt(2.0), LEAST_NOISE_M) if len(jumps) else LEAST_NOISE_M
        tried = [[_boxes(*of, Noise(std_m, drift_m), sign) for of in flown] for drift_m in DRIFTS_M]
        found = max(tried, key=lambda boxes: sum(f.nats for f in boxes))
        levels.append(max(tried, key=_level_nats))
        over = [boxes.over_m for boxes in found]
        if not any(len(boxes.edges) for boxes in found):
            break
    level = max(levels, key=_level_nats)
    return [replace(f, level_nats=flat.level_nats) for f, flat in zip(found, level, strict=True)]


def _level_nats(boxes: Sequence[_Boxes]) -> float:
    return sum(found.level_nats for found in boxes)


def _boxes(seen: Beside, height_m: Array, noise: Noise, sign: float, heights: Heights = Heights()) -> _Boxes:
    over, nats, level_nats = np.zeros(len(height_m)), 0.0, 0.0
    edges: list[int] = []
    for stretch in seen.stretches:
        ways = likeliest(sign * height_m[stretch], noise, heights)
        over[stretch] = ways.over_m
        edges += [stretch.start + k for k in ways.edges]
        nats, level_nats = nats + ways.nats, level_nats + ways.level_nats
    return _Boxes(seen, height_m, over, np.array(edges, dtype=np.int64), nats, level_nats, noise)


def _levelled(record: Record, found: _Boxes, sign: float) -> Record:
    values = record.values.copy()
    values[found.seen.rows, 0] += sign * found.over_m / found.seen.upright
    return replace(record, values=values)
