"""Smoothed path of the vehicle at given moments, with its covariance.

A Kalman filter over the simulator's equations runs forward, then Rauch's smoother backward. The error of the
smoothed path is independent of the filter's innovations. The likelihood of another instrument (a camera)
therefore multiplies that of the readings. Backward in time the error is a Markov chain,
e_i = A_i e_(i+1) + white, which gives the covariance between any two moments.
Source: Rauch, Tung and Striebel 1965.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backend.compilation import allocating_kernel
from slam.core.arrays import Array, Ints
from slam.criticism.kalman.arrays import PathHistory
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import Run
from slam.criticism.kalman.perturbations import Perturbation
from slam.criticism.kalman.readings import INSTRUMENT_OF, INSTRUMENTS, MOMENT
from slam.criticism.kalman.record import Record, in_order
from slam.simulation.dynamics import PITCH, ROLL, YAW, X, Y, Z

POSE = (X, Y, Z, ROLL, PITCH, YAW)
"""Entries of the state that make the pose."""
LEAST_HALF_S = 0.004
_TINY = 1e-13
"""Variance added before an inverse, since the start is known exactly in some axes."""


class PathErrors:
    """Joint covariance of the poses of any segment of a smoothed path.

    It is never computed for the whole of a long flight, since its size is the square of the length.
    """

    def __init__(self, chain: Array, spreads: Array) -> None:
        """``chain`` (n - 1, states, states) is A from each moment's error to the one before, ``spreads``
        (n, states, states) the covariances."""
        self._chain, self._spreads = chain, spreads
        self._known: dict[tuple[int, int], Array] = {}

    def among(self, begin: int, end: int) -> Array:
        """Return the (6 m, 6 m) covariance of the poses ``begin`` to ``end``, ``end`` excluded."""
        if (begin, end) not in self._known:
            self._known[begin, end] = _joint(self._chain[begin : end - 1], self._spreads[begin:end])
        return self._known[begin, end]


@dataclass(frozen=True)
class SmoothedPath:
    """The smoothed path at some moments of a flight."""

    times_s: Array
    """(n,)."""
    poses: Array
    """(n, 6) x, y, z, roll, pitch, yaw."""
    rates: Array
    """(n, 6) rates of the poses."""
    accelerations: Array
    """(n, 6) second derivatives of the poses."""
    errors: PathErrors
    """Errors of the whole path."""
    sensitivity: Array
    """(6 n, perturbations) derivatives of the smoothed poses."""
    span_s: tuple[float, float]
    """First and last moment of the whole path."""
    first: int = 0
    """Index of the first pose in the whole path."""

    @property
    def covariance(self) -> Array:
        """(6 n, 6 n) joint covariance of all poses."""
        return self.errors.among(self.first, self.first + len(self.times_s))

    @property
    def elapsed(self) -> Array:
        """(n,) elapsed share of the whole path, minus one half."""
        begin_s, end_s = self.span_s
        return np.asarray((self.times_s - begin_s) / max(end_s - begin_s, 1e-9) - 0.5)

    def part(self, begin: int, end: int) -> SmoothedPath:
        """Return the poses ``begin`` to ``end``, ``end`` excluded."""
        of_pose = slice(len(POSE) * begin, len(POSE) * end)
        own = slice(begin, end)
        return replace(
            self, times_s=self.times_s[own], poses=self.poses[own], rates=self.rates[own],
            accelerations=self.accelerations[own], sensitivity=self.sensitivity[of_pose],
            first=self.first + begin,
        )  # fmt: skip


def smoothed(
    record: Record,
    parameters: FilterParameters,
    times_s: Array,
    perturbations: Sequence[Perturbation] = (),
    half_s: float = 0.0,
) -> SmoothedPath:
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
    colour = parameters.noise_correlation[list(INSTRUMENT_OF)]
    std = record.noise_std * np.sqrt((1.0 + colour) / (1.0 - colour))
    # The path needs no likelihood: neither AR(1) noise nor uneven stamps.
    white = replace(parameters, noise_correlation=np.zeros(len(INSTRUMENTS)), jitter_s=0.0)
    run = Run(replace(record, noise_std=std), white, perturbations, keeps_history=True)
    for _ in run.segments(np.inf):
        pass
    at = np.flatnonzero(record.kinds == MOMENT)
    states, chain, spreads, sensitivity = _backward(run.history, at)
    before, poses, after = (states[k::3, POSE] for k in range(3))
    between = chain[1:-2:3] @ chain[2:-1:3] @ chain[3::3]
    return SmoothedPath(
        times_s=times_s,
        poses=poses,
        rates=(after - before) / (2 * half_s),
        accelerations=(after + before - 2 * poses) / half_s**2,
        errors=PathErrors(between, spreads[1::3]),
        sensitivity=sensitivity[1::3, POSE].reshape(len(times_s) * 6, len(perturbations)),
        span_s=(float(times_s[0]), float(times_s[-1])) if len(times_s) else (0.0, 0.0),
    )


@allocating_kernel
def _backward(passed: PathHistory, at: Ints) -> tuple[Array, Array, Array, Array]:
    """Return states (k, n), A to the next (k, n, n), covariances and sensitivities at the events ``at``."""
    events, n, m = passed.t_before.shape
    count = len(at)
    states, sensitivity = np.empty((count, n)), np.empty((count, n, m))
    chain, spreads = np.zeros((count, n, n)), np.empty((count, n, n))
    x, p, t = passed.x_after[-1].copy(), passed.p_after[-1].copy(), passed.t_after[-1].copy()
    a = np.eye(n)
    k = count - 1
    for e in range(events - 1, -1, -1):
        if e < events - 1:
            before = passed.p_before[e + 1] + _TINY * np.eye(n)
            gain = np.linalg.solve(before, np.dot(passed.moves[e + 1], passed.p_after[e])).T.copy()
            x = passed.x_after[e] + np.dot(gain, x - passed.x_before[e + 1])
            p = passed.p_after[e] + np.dot(np.dot(gain, p - passed.p_before[e + 1]), gain.T)
            t = passed.t_after[e] + np.dot(gain, t - passed.t_before[e + 1])
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
