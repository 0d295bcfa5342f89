"""Smoothed path of the vehicle at the pictures of a flight, with its covariance.

A Kalman filter over the simulator's equations runs forward, then Rauch's smoother backward. The error of the
smoothed path is independent of the filter's innovations. The likelihood of another instrument (a camera)
therefore multiplies that of the readings. Backward in time the error is a Markov chain,
e_i = A_i e_(i+1) + white, which gives the covariance between any two moments.
Source: Rauch, Tung and Striebel 1965.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np

from backend.compilation import allocating_kernel
from slam.core.arrays import Array, Ints, Mask
from slam.criticism.kalman.arrays import PathHistory
from slam.criticism.kalman.filter_parameters import OFFSET, READOUT, FilterParameters, slot
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.kalman.readings import INSTRUMENTS, MOMENT, SENSOR, by_channel
from slam.criticism.kalman.record import Record, in_order
from slam.data_quality.pictures.feature_matches import SHORTEST_S, FeatureMatches
from slam.simulation.dynamics import PITCH, ROLL, YAW, X, Y, Z

POSE = (X, Y, Z, ROLL, PITCH, YAW)
LEAST_HALF_S = 0.004
_TINY = 1e-13
"""Variance added before an inverse, since the start is known exactly in some axes."""
_KEPT_PATHS = 2
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
    """The smoothed path at n moments of a flight, those of some of its pictures."""

    times_s: Array
    """(n,)."""
    poses: Array
    """(n, 6) x, y, z, roll, pitch, yaw."""
    rates: Array
    """(n, 6) rates of the poses."""
    accelerations: Array
    """(n, 6) second derivatives of the poses."""
    sensitivity: Array
    """(6 n, perturbations) derivatives of the smoothed poses."""
    chain: Array
    """(whole path - 1, states, states) A from the error at each moment of it to the one before."""
    spreads: Array
    """(whole path, states, states) covariances."""
    span_s: tuple[float, float]
    """First and last moment of the whole path."""
    inside: Mask
    """(pictures,) pictures of the flight that the path passes through."""
    first: int = 0
    """Index of the first pose in the whole path."""
    known: dict[tuple[int, int], Array] = field(default_factory=dict)
    """Begin and end of each part of the path -> its covariance, where that was computed already."""

    @property
    def covariance(self) -> Array:
        """(6 n, 6 n) joint covariance of all poses; for long flights its size asks for parts of the path."""
        begin, end = self.first, self.first + len(self.times_s)
        if (begin, end) not in self.known:
            self.known[begin, end] = _joint(self.chain[begin : end - 1], self.spreads[begin:end])
        return self.known[begin, end]

    @property
    def elapsed(self) -> Array:
        """(n,) elapsed share of the whole path, minus one half."""
        begin_s, end_s = self.span_s
        return np.asarray((self.times_s - begin_s) / max(end_s - begin_s, 1e-9) - 0.5)

    def holds(self, i: Ints, j: Ints) -> Mask:
        """Return (m,) whether both pictures of each pair are on the path."""
        return np.asarray(self.inside[i] & self.inside[j])

    def index(self, pictures: Ints) -> Ints:
        """Return the indices into the path of pictures that are on it."""
        return np.asarray((np.cumsum(self.inside) - 1)[pictures])

    def part(self, begin: int, end: int) -> CameraPath:
        """Return the poses ``begin`` to ``end`` of the path, ``end`` excluded."""
        inside, own = np.zeros(len(self.inside), dtype=bool), slice(begin, end)
        inside[np.flatnonzero(self.inside)[own]] = True
        return replace(
            self, times_s=self.times_s[own], poses=self.poses[own], rates=self.rates[own],
            accelerations=self.accelerations[own], inside=inside, first=self.first + begin,
            sensitivity=self.sensitivity[len(POSE) * begin : len(POSE) * end],
        )  # fmt: skip


_PATHS: WeakKeyDictionary[FeatureMatches, dict[bytes, tuple[Array, CameraPath]]] = WeakKeyDictionary()
"""Cache of the latest smoothed paths for each set of matches."""


def camera_path(record: Record, matches: FeatureMatches, parameters: FilterParameters) -> CameraPath:
    """Return the path at the pictures that lie within the record's time and above the floor.

    Paths are cached for nearly equal parameters."""
    camera = parameters.camera
    inside = matches.stamps_s > record.times_s[0] + MARGIN_S
    inside &= matches.stamps_s < record.times_s[-1] - MARGIN_S
    # On the floor the camera is a few centimetres above it, at the height of a landing gear, which differs.
    at = np.searchsorted(record.times_s, matches.stamps_s).clip(max=len(record.times_s) - 1)
    inside &= ~record.landing[at]
    inside = spread(matches.stamps_s, inside)
    paths = _PATHS.setdefault(matches, {})
    key = _key(parameters, record.duration_s)
    half_s = max(min(0.5 * float(camera[READOUT]), 0.4 * SHORTEST_S), LEAST_HALF_S)
    if key not in paths:
        shown = matches.stamps_s[inside] * (1.0 + parameters.drift) - camera[OFFSET]
        shown = np.clip(shown, record.times_s[0] + half_s, record.times_s[-1] - half_s)
        while len(paths) >= _KEPT_PATHS:
            paths.pop(next(iter(paths)))
        directions = [Perturbation(name, *slot(name)) for name in SENSOR]
        paths[key] = parameters.sensor, smoothed(record, parameters, shown, directions, half_s)
    sensor, path = paths[key]
    moved = (path.sensitivity @ (parameters.sensor - sensor)).reshape(path.poses.shape)
    return replace(path, poses=path.poses + moved, inside=inside)


def spread(stamps_s: Array, inside: Mask) -> Mask:
    """Choose segments of consecutive pictures (n,), evenly, if there are more than ``MOST_PICTURES``.

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


def smoothed(
    record: Record,
    parameters: FilterParameters,
    times_s: Array,
    perturbations: Sequence[Perturbation] = (),
    half_s: float = 0.0,
) -> CameraPath:
    """Return the path at ``times_s`` within the record's time, with sensitivities to instrument parameters.

    Rates and accelerations are those of a parabola through the poses ``half_s`` around each moment.
    """
    half_s = max(half_s, LEAST_HALF_S)
    moments_s = (times_s[:, None] + half_s * np.array([-1.0, 0.0, 1.0])).ravel()
    record = in_order(
        record,
        np.concatenate([record.times_s, moments_s]),
        np.concatenate([record.kinds, np.full(len(moments_s), MOMENT)]),
        np.concatenate([record.values, np.full((len(moments_s), 6), np.nan)]),
        np.concatenate([record.landing, np.zeros(len(moments_s), dtype=bool)]),
    )
    # AR(1) noise counts as the white noise that averages out as slowly.
    colour = by_channel(*parameters.noise_correlation)
    std = record.noise_std * np.sqrt((1.0 + colour) / (1.0 - colour))
    # The path needs no likelihood: neither AR(1) noise nor uneven stamps.
    white = replace(parameters, noise_correlation=np.zeros(len(INSTRUMENTS)), jitter_s=0.0)
    run = Run(replace(record, noise_std=std), white, perturbations, keeps_history=True)
    for _ in run.segments(np.inf):
        pass
    at = np.flatnonzero(record.kinds == MOMENT)
    states, chain, spreads, sensitivity = _backward(run.history, at)
    before, poses, after = (states[k::3, POSE] for k in range(3))
    return CameraPath(
        times_s=times_s,
        poses=poses,
        rates=(after - before) / (2 * half_s),
        accelerations=(after + before - 2 * poses) / half_s**2,
        sensitivity=sensitivity[1::3, POSE].reshape(len(times_s) * 6, len(perturbations)),
        chain=chain[1:-2:3] @ chain[2:-1:3] @ chain[3::3],
        spreads=spreads[1::3],
        span_s=(float(times_s[0]), float(times_s[-1])) if len(times_s) else (0.0, 0.0),
        inside=np.ones(len(times_s), dtype=bool),
    )


@allocating_kernel
def _backward(passed: PathHistory, at: Ints) -> tuple[Array, Array, Array, Array]:
    """Return states (k, n), A to the next (k, n, n), covariances and sensitivities at the events ``at``."""
    _, events, n, m = passed.t.shape
    count = len(at)
    states, sensitivity = np.empty((count, n)), np.empty((count, n, m))
    chain, spreads = np.zeros((count, n, n)), np.empty((count, n, n))
    x, p, t = passed.x[1, -1].copy(), passed.p[1, -1].copy(), passed.t[1, -1].copy()
    a = np.eye(n)
    k = count - 1
    for e in range(events - 1, -1, -1):
        if e < events - 1:
            before = passed.p[0, e + 1] + _TINY * np.eye(n)
            gain = np.linalg.solve(before, np.dot(passed.moves[e + 1], passed.p[1, e])).T.copy()
            x = passed.x[1, e] + np.dot(gain, x - passed.x[0, e + 1])
            p = passed.p[1, e] + np.dot(np.dot(gain, p - passed.p[0, e + 1]), gain.T)
            t = passed.t[1, e] + np.dot(gain, t - passed.t[0, e + 1])
            a = np.dot(gain, a)
        if k >= 0 and at[k] == e:
            states[k], spreads[k], sensitivity[k], chain[k] = x, 0.5 * (p + p.T), t, a
            a = np.eye(n)
            k -= 1
    return states, chain, spreads, sensitivity


def _joint(chain: Array, spreads: Array) -> Array:
    """Return the (6 n, 6 n) covariance of the poses from the backward chain of the whole state."""
    n = len(spreads)
    joint = np.empty((n, 6, n, 6))
    for j in range(n):
        cross = spreads[j]
        joint[j, :, j] = cross[np.ix_(POSE, POSE)]
        for i in range(j - 1, -1, -1):
            cross = chain[i] @ cross
            joint[i, :, j] = cross[np.ix_(POSE, POSE)]
            joint[j, :, i] = joint[i, :, j].T
    return joint.reshape(6 * n, 6 * n)
