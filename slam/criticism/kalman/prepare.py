"""Initial arguments of the filter's kernels: record and parameters as flat arrays, and buffers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.core.arrays import Array
from slam.criticism.kalman import arrays
from slam.criticism.kalman.ar1_noise import WHITE, Ar1Noise
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.perturbations import Perturbation, Signal, perturbation_arrays, spoilt_channels
from slam.criticism.kalman.readings import CHANNELS, INSTRUMENT_OF, MOVING, TARGET
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import ENTRIES, STICKS
from slam.criticism.kalman.transition import (
    FULL,
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
from slam.simulation.dynamics import YAW, YAW_RATE

SHORT_S, ENDLESS_S = 1e-5, 1e6
"""Durations over which a noise only grows by its process noise, and over which it forgets its past."""


def observable_noise(record: Record, parameters: FilterParameters) -> FilterParameters:
    """Return the parameters without process noise of the heading, if no instrument shows it."""
    if record.shows_heading:
        return parameters
    hold = parameters.hold.copy()
    hold[TURN_STD] = 0.0
    return replace(parameters, hold=hold)


def filter_inputs(
    record: Record,
    parameters: FilterParameters,
    perturbations: Sequence[Perturbation],
    signals: dict[str, Signal],
    variance: Array,
    states: int,
) -> arrays.KalmanInputs:
    """Return the kernels' inputs; ``variance`` (channels,) is that of one reading."""
    events = arrays.EventArrays(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, record.first_step,
        record.step_s,
    )  # fmt: skip
    table, command = perturbation_arrays(record, parameters, perturbations, signals)
    noise = arrays.NoiseArrays(
        variance, record.range_limits, parameters.jitter_s, diffusion(parameters.hold, states)
    )
    model = arrays.ModelArrays(parameters.dynamics, parameters.sensor, parameters.hold)
    return arrays.KalmanInputs(events, command, model, noise, table)


def initial_state(
    record: Record, parameters: FilterParameters, states: int, perturbations: int
) -> arrays.KalmanState:
    """Return the estimate before the first reading: the record's initial guess and stationary noises."""
    state, p = np.zeros(states), np.zeros((states, states))
    state[:MOVING] = record.start
    p[np.arange(MOVING), np.arange(MOVING)] = record.start_std**2
    if not record.shows_heading:
        p[[YAW, YAW_RATE], [YAW, YAW_RATE]] = 0.0
    p[TARGET:, TARGET:] = _process_noise(parameters.hold, ENDLESS_S, states)[TARGET:, TARGET:]
    return arrays.KalmanState(state, p, np.zeros(len(CHANNELS)), np.zeros((states, perturbations)))


def _process_noise(hold: Array, h: float, n: int) -> Array:
    """Return the process noise (n, n) of the noise states over h seconds."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, h, matrix)
    process_noise(hold, matrix, q)
    return q


def noise_changes_for(
    record: Record, parameters: FilterParameters, changed: Sequence[FilterParameters], coloured: Ar1Noise
) -> arrays.NoiseChangeArrays:
    """Return filters under ``changed`` noise before the first reading, beside AR(1) noises ``coloured``."""
    (n, k), c = coloured.cross.shape, len(changed)
    slots = np.flatnonzero(coloured.slot != WHITE)
    variance, colour = np.zeros((c, len(CHANNELS))), np.zeros((c, len(CHANNELS)))
    p, ar1_cov, growth = np.zeros((c, n, n)), np.zeros((c, k, k)), np.zeros((c, n))
    hold, spoilt = np.zeros((c, len(HOLD))), np.zeros((c, len(record.times_s)), dtype=np.int64)
    for i, own in enumerate(changed):
        variance[i] = (record.noise_std * own.noise_factor) ** 2
        colour[i] = own.noise_correlation[list(INSTRUMENT_OF)]
        p[i], ar1_cov[i] = initial_state(record, own, n, 0).p, np.diag(variance[i, slots])
        hold[i], growth[i], spoilt[i] = own.hold, diffusion(own.hold, n), spoilt_channels(record, own)
    times = [TILT_TIME, TURN_TIME, W_TIME, POLE, GUST_TIME]
    return arrays.NoiseChangeArrays(
        hold, (hold[:, times] == parameters.hold[times]).all(axis=1), variance,
        np.array([own.jitter_s for own in changed], dtype=np.float64), growth, p, np.zeros((n, c)),
        colour[:, slots].copy(), variance[:, slots].copy(), np.zeros((c, k)), np.zeros((c, n, k)), ar1_cov,
        spoilt, np.zeros(n), np.zeros((c, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((MOVING, c)),
        np.zeros(n), np.zeros(k), np.zeros((k, 0)), np.zeros(0),
    )  # fmt: skip


def diffusion(hold: Array, n: int) -> Array:
    """Return (n,) the growth of the variance of each state by process noise, per second."""
    return np.diag(_process_noise(hold, SHORT_S, n)) / SHORT_S


def workspace_for(n: int, m: int) -> arrays.Workspace:
    """Return buffers for n states and m perturbations."""
    return arrays.Workspace(
        arrays.StepBuffers(
            np.empty(FULL), np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n)), np.empty(FULL),
            np.empty(NOISES), np.empty((n, n)), np.zeros(MOVING), np.zeros(MOVING),
        ),
        arrays.PredictedReading(
            np.empty(FULL), np.empty(6), np.zeros((6, n)), np.zeros((6, MOVING)), np.empty(n), np.empty(n)
        ),
        arrays.PerturbationBuffers(
            np.zeros((ENTRIES, MOVING)), np.zeros(ENTRIES, dtype=np.bool_), np.zeros((ENTRIES, MOVING)),
            np.zeros((ENTRIES, 6)), np.empty(MOVING), np.zeros((6, m)), np.empty(m), np.empty((MOVING, m)),
        ),
        arrays.Scratch(
            np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL),
            np.empty(NOISES), np.empty(NOISES), np.empty(NOISES), np.empty(STICKS), np.empty(n), np.empty(6),
            np.empty(MOVING),
        ),
    )  # fmt: skip


def outputs_for(events: int, readings: int, perturbations: int, changes: int) -> arrays.KalmanOutputs:
    """Return arrays for the results of events and of readings with sensitivities."""
    return arrays.KalmanOutputs(
        np.full((events, 6), np.nan), np.full((events, 6), np.nan), np.zeros((events, 6), dtype=np.int64),
        np.zeros((events, MOVING + 1)), np.empty((readings, perturbations)), np.empty((readings, changes)),
        np.empty((readings, changes)), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


def history_for(events: int, n: int, m: int) -> arrays.PathHistory:
    """Return arrays for the estimates around events, with n states and m perturbations."""
    x, p, t = (events, n), (events, n, n), (events, n, m)
    return arrays.PathHistory(*(np.empty(shape) for shape in (x, x, p, p, t, t, p)))
