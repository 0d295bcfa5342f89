"""The smoothed path of the camera at the pictures of a flight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from slam.core.arrays import Array, Ints, Mask
from slam.criticism.kalman.filter_parameters import OFFSET, READOUT, FilterParameters
from slam.criticism.kalman.perturbations import parameter_perturbation
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.smoothing import LEAST_HALF_S, SmoothedPath, smoothed
from slam.data_quality.pictures.feature_matches import SHORTEST_S, FeatureMatches

_SENSOR_NUDGE = 1e-3
_KEPT_PATHS = 2
_PATHS: WeakKeyDictionary[FeatureMatches, dict[bytes, tuple[Array, SmoothedPath]]] = WeakKeyDictionary()
"""Cache of the latest smoothed paths for each set of matches."""
_SAME_SHARE, _SAME_S = 3e-3, 1e-3
"""Relative differences, and differences in seconds, of parameters below which the path counts as the same."""
MOST_PICTURES = 450
"""Largest number of pictures of a flight that are evaluated together."""
BURST_S = 10.0
"""Length in seconds of the segments that are chosen where there are more."""
MARGIN_S = 0.3
"""Pictures this near to the ends of the readings are left out, so that a clock offset loses none."""


@dataclass(frozen=True)
class CameraPath:
    """The smoothed path at some of the n pictures of a flight."""

    path: SmoothedPath
    """Path at these pictures."""
    inside: Mask
    """(n,) pictures that the path passes through."""

    def holds(self, i: Ints, j: Ints) -> Mask:
        """Return (m,) whether both pictures of each pair are on the path."""
        return np.asarray(self.inside[i] & self.inside[j])

    def index(self, pictures: Ints) -> Ints:
        """Return the indices into the path of pictures that are on it."""
        return np.asarray((np.cumsum(self.inside) - 1)[pictures])

    def part(self, begin: int, end: int) -> CameraPath:
        """Return the poses ``begin`` to ``end`` of the path, ``end`` excluded."""
        inside = np.zeros(len(self.inside), dtype=bool)
        inside[np.flatnonzero(self.inside)[begin:end]] = True
        return CameraPath(self.path.part(begin, end), inside)


def camera_path(record: Record, matches: FeatureMatches, parameters: FilterParameters) -> CameraPath:
    """Return the path at the pictures that lie within the record's time and above the floor.

    Paths are cached for nearly equal parameters."""
    camera = parameters.camera
    inside = matches.stamps_s > record.times_s[0] + MARGIN_S
    inside &= matches.stamps_s < record.times_s[-1] - MARGIN_S
    # On the floor the camera is a few centimetres above it, at the height of a landing gear, which differs.
    inside &= ~record.landing[
        np.searchsorted(record.times_s, matches.stamps_s).clip(max=len(record.times_s) - 1)
    ]
    inside = spread(matches.stamps_s, inside)
    paths = _PATHS.setdefault(matches, {})
    key = _key(parameters, record.duration_s)
    half_s = max(min(0.5 * float(camera[READOUT]), 0.4 * SHORTEST_S), LEAST_HALF_S)
    if key not in paths:
        shown = matches.stamps_s[inside] * (1.0 + parameters.drift) - camera[OFFSET]
        shown = np.clip(shown, record.times_s[0] + half_s, record.times_s[-1] - half_s)
        while len(paths) >= _KEPT_PATHS:
            paths.pop(next(iter(paths)))
        directions = [parameter_perturbation(name, _SENSOR_NUDGE) for name in SENSOR]
        paths[key] = parameters.sensor, smoothed(record, parameters, shown, directions, half_s)
    sensor, path = paths[key]
    moved = (path.sensitivity @ (parameters.sensor - sensor)).reshape(path.poses.shape)
    return CameraPath(replace(path, poses=path.poses + moved), inside)


def spread(stamps_s: Array, inside: Mask) -> Mask:
    """Choose segments of consecutive pictures, evenly over the flight (n,), if there are more than
    ``MOST_PICTURES``.

    The joint covariance grows with the square of the number of poses. The errors of a long chain of pairs
    also add up: over a minute or more, to a focal length that is wrong by hundredths.
    """
    share = MOST_PICTURES / max(int(inside.sum()), 1)
    if share >= 1.0:
        return inside
    burst = np.floor(stamps_s / BURST_S)
    return inside & (np.floor((burst + 1.0) * share) > np.floor(burst * share))


def _key(parameters: FilterParameters, duration_s: float) -> bytes:
    """Return a key that is equal for parameters with nearly the same path."""
    parts = [parameters.dynamics, parameters.hold, parameters.noise_factor, parameters.noise_correlation]
    numbers = np.concatenate(parts)
    coarse = np.round(np.sign(numbers) * np.log1p(np.abs(numbers) / 0.01) / _SAME_SHARE)
    clocks = [parameters.latency_s, parameters.drift * 100, parameters.jitter_s, duration_s]
    timing = np.array([*clocks, *parameters.camera[[OFFSET, READOUT]]])
    return coarse.tobytes() + np.round(timing / _SAME_S).tobytes()
