"""Arguments of the filter's kernels: record, parameters and perturbations as flat arrays, and buffers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slam.core.arrays import Array, Ints
from slam.criticism.kalman import arrays
from slam.criticism.kalman.arrays import CommandArrays, PerturbationArrays
from slam.criticism.kalman.filter_parameters import LATE_SPREAD, FilterParameters
from slam.criticism.kalman.noise import WHITE
from slam.criticism.kalman.readings import AR1, CHANNELS, GUST, MOVING, READ_BY, TARGET, by_channel
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import ENTRIES, ON_CHANNEL, STICKS
from slam.criticism.kalman.transition import (
    FULL,
    GUST_STD,
    GUST_TIME,
    HOLD,
    NOISES,
    POLE,
    TILT_TIME,
    TURN_STD,
    TURN_TIME,
    W_TIME,
    decay,
    process_noise,
)
from slam.simulation.dynamics import NOISE, YAW, YAW_RATE

Kind = Literal["dynamics", "sensor", "latency", "drift", "force", "channel", "camera", "picture"]
"""The last two act on pictures alone, not on readings."""
Signal = tuple[Array, Array]
"""Values in the middle of each step and at each event."""

FORCES = (*NOISE, "up", "ahead", "left")
"""Entries of a force: the equations' noises, the climb stick, and wind in the vehicle's own axes."""
JUMP_S = 0.002
"""Time resolution of a stick's jump in the log; the gyro jumps with the stick."""
GYRO_CHANNELS, IMU_CHANNELS = 3, 6
LATE_SHARE = 3.0 * LATE_SPREAD
JITTER_REACH, LARGE_JUMP = 3.0, 0.03
"""Standard deviations of a stamp, and the least jump of a stick that matters at that distance."""


@dataclass(frozen=True)
class Perturbation:
    """One change of the filter parameters; sensitivities to it are per unit of its own parameter."""

    name: str
    kind: Kind
    entry: int = 0
    """Index into the parameters, the sensor's vector, ``FORCES`` or ``CHANNELS``."""
    step: float = 1e-3
    """Step of the finite difference."""
    signal: str = ""
    """Name of the signal that is injected."""
    unit: float | None = None
    """Divisor of the finite difference; by default the step."""
    squared: bool = False
    """Whether the step is one of the entry's square."""


@dataclass(frozen=True)
class LikelihoodScore:
    """Log likelihood of some data, with its score and Fisher information for p columns."""

    information: Array
    """(p, p)."""
    score: Array
    """(p,)."""
    log_likelihood: float = 0.0
    chi_square: float = 0.0
    """Squared whitened residuals, where the data have residuals."""
    rows: int = 0
    """Number of residuals."""

    @staticmethod
    def nothing(columns: int) -> LikelihoodScore:
        """Return that of no data."""
        return LikelihoodScore(np.zeros((columns, columns)), np.zeros(columns))

    def __add__(self, other: LikelihoodScore) -> LikelihoodScore:
        """Return that of both, which are independent."""
        return LikelihoodScore(
            self.information + other.information, self.score + other.score,
            self.log_likelihood + other.log_likelihood, self.chi_square + other.chi_square,
            self.rows + other.rows,
        )  # fmt: skip

    def by(self, columns: Array) -> LikelihoodScore:
        """Return the same for q other columns, of which the p are linear combinations ``columns`` (p, q)."""
        information = columns.T @ self.information @ columns
        return replace(self, information=information, score=self.score @ columns)


def _perturbed(
    record: Record, parameters: FilterParameters, perturbations: Sequence[Perturbation],
    signals: dict[str, Signal],
) -> tuple[PerturbationArrays, CommandArrays]:  # fmt: skip
    """Return the perturbations, and the commands of all variants that they have."""
    steps, m = len(record.steps[2]), len(perturbations)
    variants: list[tuple[float, float]] = [(parameters.latency_s, parameters.drift)]
    names = sorted({d.signal for d in perturbations if d.signal})
    table = PerturbationArrays(
        np.zeros(m, dtype=np.int64), np.zeros(m, dtype=np.int64), np.zeros(m, dtype=np.int64),
        np.tile(parameters.dynamics, (m, 1)), np.tile(parameters.sensor, (m, 1)),
        np.full(m, -1, dtype=np.int64), np.zeros(m, dtype=np.int64),
        np.array([signals[name][0] for name in names]).reshape(len(names), steps),
        np.array([signals[name][1] for name in names]).reshape(len(names), len(record.times_s)),
        np.array([1.0 / (d.step if d.unit is None else d.unit) for d in perturbations]),
    )  # fmt: skip
    for k, d in enumerate(perturbations):
        if d.kind == "dynamics":
            table.changes_motion[k] = 1
            x = parameters.dynamics[d.entry]
            table.parameters_of[k, d.entry] = np.sqrt(x**2 + d.step) if d.squared else x + d.step
        elif d.kind == "sensor":
            table.instrument_mask[k] = 1 << READ_BY[d.entry]
            table.sensor_of[k, d.entry] += d.step
        elif d.kind in ("latency", "drift"):
            table.changes_motion[k] = 1
            table.stick_of[k] = len(variants)
            late, fast = d.step * (d.kind == "latency"), d.step * (d.kind == "drift")
            variants.append((parameters.latency_s + late, parameters.drift + fast))
        elif d.kind in ("force", "channel"):
            table.signal_of[k] = names.index(d.signal)
            table.inject_at[k] = d.entry if d.kind == "force" else ON_CHANNEL + d.entry
            table.changes_motion[k] = int(d.kind == "force")
    return table, _command(record, parameters, variants)


def _command(
    record: Record, parameters: FilterParameters, variants: Sequence[tuple[float, float]]
) -> CommandArrays:
    """Return the commands of each variant, which is a latency and a clock's drift, on the vehicle's clock."""
    _, begin_s, length_s = record.steps
    end_s, stick = begin_s + length_s, record.stick
    over_steps = [stick.mean(begin_s / (1 + fast), end_s / (1 + fast), late_s) for late_s, fast in variants]
    at_events = [stick.at(record.times_s / (1 + fast), late_s) for late_s, fast in variants]
    ends = [stick.at(at_s / (1 + parameters.drift), parameters.latency_s) for at_s in (begin_s, end_s)]
    late_var_s2 = (LATE_SPREAD * parameters.latency_s) ** 2
    return CommandArrays(np.array(over_steps), np.array(at_events), ends[1] - ends[0], late_var_s2)


def spoilt_channels(record: Record, parameters: FilterParameters) -> Ints:
    """Return (events,) the number of each event's channels that a jump of the stick spoils."""
    size = np.abs(np.diff(record.stick.values, axis=0)).max(axis=1, initial=0.0)
    at = (record.stick.stamps_s[1:] + parameters.latency_s) * (1 + parameters.drift)
    near_jump = _apart(record.times_s, at[size > 0]) < JUMP_S + LATE_SHARE * parameters.latency_s
    spoilt = np.where(near_jump, GYRO_CHANNELS, 0)
    # With jittering stamps the smaller jump of the climb is uncertain as well.
    spoilt[_apart(record.times_s, at[size > LARGE_JUMP]) < JITTER_REACH * parameters.jitter_s] = IMU_CHANNELS
    return np.asarray(spoilt, dtype=np.int64)


def _apart(times_s: Array, moments_s: Array) -> Array:
    """Return the time from each entry to the nearest moment; infinite without moments."""
    known_s = np.concatenate([[-np.inf], moments_s, [np.inf]])
    after = np.searchsorted(moments_s, times_s) + 1
    return np.asarray(np.minimum(times_s - known_s[after - 1], known_s[after] - times_s))


SHORT_S, ENDLESS_S = 1e-5, 1e6
"""Durations over which a noise only grows by its process noise, and over which it forgets its past."""


def ar1_states(noises: Sequence[FilterParameters]) -> Ints:
    """Return (channels,) the state of each channel's AR(1) noise; ``WHITE`` where no parameters have one."""
    correlated = by_channel(*np.max([p.noise_correlation for p in noises], axis=0)) > 0.0
    return np.where(correlated, AR1 - 1 + np.cumsum(correlated), WHITE)


def samples_between(record: Record) -> Ints:
    """Return (events,) the number of samples since the previous event of the same kind, by the times."""
    samples = np.ones(len(record.kinds), dtype=np.int64)
    for kind in np.unique(record.kinds):
        rows = np.flatnonzero(record.kinds == kind)
        gaps = np.diff(record.times_s[rows])
        if len(gaps):
            samples[rows[1:]] = np.maximum(np.rint(gaps / np.median(gaps)), 1).astype(np.int64)
    return samples


def initial_state(
    record: Record, noises: Sequence[FilterParameters], states: int, ar1_state: Ints, perturbations: int
) -> arrays.KalmanState:
    """Return the estimate before the first reading: the record's initial guess and stationary noises."""
    state, p = np.zeros(states), np.zeros((len(noises), states, states))
    state[:MOVING] = record.start
    p[:, np.arange(MOVING), np.arange(MOVING)] = record.start_std**2
    if not record.shows_heading:
        p[:, [YAW, YAW_RATE], [YAW, YAW_RATE]] = 0.0
    own = ar1_state != WHITE
    for c, parameters in enumerate(noises):
        p[c, TARGET:, TARGET:] = _process_noise(parameters.hold, ENDLESS_S, states)[TARGET:, TARGET:]
        p[c, ar1_state[own], ar1_state[own]] = _variance(record, parameters)[own]
    shift, sensitivity = np.zeros((states, len(noises))), np.zeros((states, perturbations))
    return arrays.KalmanState(state, p, shift, np.zeros(len(CHANNELS)), sensitivity)


def _variance(record: Record, parameters: FilterParameters) -> Array:
    return np.asarray((record.noise_std * parameters.noise_factor) ** 2)


def _process_noise(hold: Array, h: float, n: int) -> Array:
    """Return the process noise (n, n) of the noise states over h seconds."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, h, matrix)
    process_noise(hold, matrix, q)
    return q


def noise_arrays(record: Record, noises: Sequence[FilterParameters], n: int) -> arrays.NoiseArrays:
    """Return the noise of a record under each of some parameters, for n states."""
    hold, times = np.array([p.hold for p in noises]), [TILT_TIME, TURN_TIME, W_TIME, POLE, GUST_TIME]
    return arrays.NoiseArrays(
        hold, (hold[:, times] == hold[0, times]).all(axis=1),
        np.array([_variance(record, p) for p in noises]),
        np.array([by_channel(*p.noise_correlation) for p in noises]),
        np.array([p.jitter_s for p in noises], dtype=np.float64),
        np.array([diffusion(p.hold, n) for p in noises]),
        np.array([spoilt_channels(record, p) for p in noises]),
    )  # fmt: skip


def diffusion(hold: Array, n: int) -> Array:
    """Return (n,) the growth of the variance of each state by process noise, per second."""
    return np.diag(_process_noise(hold, SHORT_S, n)) / SHORT_S


def _zeros(*shapes: int | tuple[int, ...]) -> list[Array]:
    return [np.zeros(shape) for shape in shapes]


def workspace_for(
    n: int, m: int, noises: int
) -> tuple[arrays.StepBuffers, arrays.PredictedReading, arrays.PerturbationBuffers, arrays.Scratch]:
    """Return the buffers of a run for n states, m perturbations and some noises."""
    columns = max(n, m, noises)
    return (
        arrays.StepBuffers(
            *_zeros(FULL, (MOVING, n), (n, n), (n, n), n, (noises, n), (n, n), FULL, NOISES, (n, columns)),
            *_zeros(MOVING, MOVING),
        ),
        arrays.PredictedReading(*_zeros(FULL, 6, (6, n), (6, MOVING), n, n, n)),
        arrays.PerturbationBuffers(
            np.zeros((ENTRIES, MOVING)), np.zeros(ENTRIES, dtype=np.bool_),
            *_zeros((ENTRIES, MOVING), (ENTRIES, 6), (6, m), m),
        ),
        arrays.Scratch(*_zeros(*[FULL] * 5, *[NOISES] * 3, STICKS, n, 6, MOVING)),
    )  # fmt: skip


def filter_run(
    record: Record, noises: Sequence[FilterParameters], perturbations: Sequence[Perturbation],
    signals: dict[str, Signal], keeps_history: bool,
) -> arrays.FilterRun:  # fmt: skip
    """Return a run before the first reading, under the first of some parameters that differ in their noise.

    Its outputs for readings with sensitivities are still empty.
    """
    if not record.shows_heading:  # no process noise of a heading that no instrument shows
        noises = [replace(p, hold=np.where(np.arange(len(HOLD)) == TURN_STD, 0.0, p.hold)) for p in noises]
    parameters, (first_step, _, step_s) = noises[0], record.steps
    read = arrays.EventArrays(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, samples_between(record),
        first_step, step_s,
    )  # fmt: skip
    table, command = _perturbed(record, parameters, perturbations, signals)
    ar1_state, has_gusts = ar1_states(noises), any(p.hold[GUST_STD] > 0 for p in noises)
    n = max(AR1 if has_gusts else GUST, int(ar1_state.max()) + 1)
    model = arrays.ModelArrays(parameters.dynamics, parameters.sensor, record.range_limits, ar1_state)
    m, events = len(perturbations), len(record.times_s)
    none, missing = np.empty((0, 0)), np.full((2, events, 6), np.nan)
    outputs = arrays.KalmanOutputs(
        missing[0], missing[1], np.zeros((events, 6), dtype=np.int64), np.zeros((events, MOVING + 1)),
        none, none, none, np.zeros(1, dtype=np.int64),
    )  # fmt: skip
    kept = events if keeps_history else 0
    moves = np.tile(np.eye(n), (kept, 1, 1))
    x, p, t = _zeros((2, kept, n), (2, kept, n, n), (2, kept, n, m))
    return arrays.FilterRun(
        read, command, model, noise_arrays(record, noises, n), table,
        initial_state(record, noises, n, ar1_state, m), *workspace_for(n, m, len(noises)), outputs,
        arrays.PathHistory(x, p, t, moves),
    )  # fmt: skip
