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
from typing import NamedTuple

import numpy as np

from backend.compilation import allocating_kernel, inner_kernel, kernel
from slam.criticism.kalman.ar1_noise import Ar1Noise, ar1_noise_for
from slam.criticism.kalman.arrays import (
    Array,
    Ints,
    KalmanInputs,
    KalmanOutputs,
    KalmanState,
    NoiseChangeArrays,
    Workspace,
)
from slam.criticism.kalman.filter import update
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.perturbations import Perturbation
from slam.criticism.kalman.prepare import (
    filter_inputs,
    initial_state,
    noise_changes_for,
    outputs_for,
    workspace_for,
)
from slam.criticism.kalman.readings import ATTITUDE, INSTRUMENT_OF, INSTRUMENTS, STATES, WIDTH
from slam.criticism.kalman.record import Record, in_order
from slam.criticism.kalman.sensitivity import carry, direct_change
from slam.criticism.kalman.steps import measurement, predict
from slam.criticism.kalman.transition import jacobian
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
    record = _with_moments(record, (times_s[:, None] + half_s * np.array([-1.0, 0.0, 1.0])).ravel())
    # AR(1) noise counts as the white noise that averages out as slowly.
    colour = parameters.noise_correlation[list(INSTRUMENT_OF)]
    noise_var = (record.noise_std * parameters.noise_factor) ** 2 * (1.0 + colour) / (1.0 - colour)
    m = len(perturbations)
    passed = _nothing_passed(len(record.times_s), STATES, m)
    # The path needs no likelihood: neither AR(1) noise nor uneven stamps.
    white = replace(parameters, noise_correlation=np.zeros(len(INSTRUMENTS)), jitter_s=0.0)
    coloured = ar1_noise_for(record, white, STATES, m)
    given = filter_inputs(record, parameters, perturbations, {}, noise_var, STATES)
    _forward(
        given._replace(noise=given.noise._replace(jitter_s=0.0)),
        initial_state(record, parameters, STATES, m),
        workspace_for(STATES, m),
        outputs_for(len(record.times_s), max(WIDTH), m, 0),
        coloured,
        noise_changes_for(record, white, (), coloured),
        passed,
    )
    at = np.flatnonzero(record.kinds == _MOMENT)
    states, chain, spreads, sensitivity = _backward(passed, at)
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


_MOMENT = ATTITUDE + 100
"""Kind of an event without a reading."""


def _with_moments(record: Record, times_s: Array) -> Record:
    """Return the record with additional events without readings."""
    return in_order(
        record,
        np.concatenate([record.times_s, times_s]),
        np.concatenate([record.kinds, np.full(len(times_s), _MOMENT)]),
        np.concatenate([record.values, np.full((len(times_s), 6), np.nan)]),
        np.concatenate([record.landing, np.zeros(len(times_s), dtype=bool)]),
    )


class _Passed(NamedTuple):
    """Results of the forward pass for the backward pass."""

    x_before: Array
    """(events, n) state before each event, ..."""
    x_after: Array
    """... and after it."""
    p_before: Array
    """(events, n, n) covariance."""
    p_after: Array
    t_before: Array
    """(events, n, m) tangents."""
    t_after: Array
    moves: Array
    """(events, n, n) transition to each event from the one before."""


def _nothing_passed(events: int, n: int, m: int) -> _Passed:
    x, p, t = (events, n), (events, n, n), (events, n, m)
    return _Passed(*(np.empty(shape) for shape in (x, x, p, p, t, t, p)))


@kernel
def _forward(
    given: KalmanInputs,
    estimate: KalmanState,
    room: Workspace,
    written: KalmanOutputs,
    coloured: Ar1Noise,
    others: NoiseChangeArrays,
    passed: _Passed,
) -> None:
    """Filter all events in place and write the estimates around each event to ``passed``."""
    events, command, model = given.events, given.command, given.model
    step, expected, changes, scratch = room
    state, n = estimate.state, estimate.state.shape[0]
    for e in range(len(events.times_s)):
        moves = passed.moves[e]
        for i in range(n):
            for j in range(n):
                moves[i, j] = 1.0 if i == j else 0.0
        for s in range(events.first_step[e], events.first_step[e + 1]):
            predict(s, given, estimate, step, scratch)
            carry(step.matrix, moves, step.work)
            carry(step.matrix, estimate.sensitivity, changes.work)
        _write(estimate, passed.x_before[e], passed.p_before[e], passed.t_before[e])
        kind = events.kinds[e]
        if kind != _MOMENT:
            jacobian(state, command.at_events[0, e], model.parameters, expected.rate, step.slopes, scratch)
            measurement(kind, events.elapsed[e], state, model, step.slopes, expected, scratch)
            direct_change(e, given, state, expected, changes, scratch)
            written.rows[0] = 0
            update(e, given, estimate, expected, changes, written, coloured, others)
        _write(estimate, passed.x_after[e], passed.p_after[e], passed.t_after[e])


@inner_kernel
def _write(estimate: KalmanState, x: Array, p: Array, t: Array) -> None:
    """Write mean, covariance and sensitivities of an estimate into arrays."""
    for i in range(len(x)):
        x[i] = estimate.state[i]
        for j in range(len(x)):
            p[i, j] = estimate.p[i, j]
        for d in range(t.shape[1]):
            t[i, d] = estimate.sensitivity[i, d]


@allocating_kernel
def _backward(passed: _Passed, at: Ints) -> tuple[Array, Array, Array, Array]:
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
