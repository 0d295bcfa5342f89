"""Initial arguments of the filter's kernels: record and parameters as flat arrays, and buffers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.kalman.arrays import (
    Array,
    EventArrays,
    KalmanInputs,
    KalmanState,
    ModelArrays,
    NoiseArrays,
    PerturbationBuffers,
    PredictedReading,
    Scratch,
    StepBuffers,
    Workspace,
)
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.perturbations import Perturbation, Signal, perturbation_arrays
from slam.criticism.kalman.readings import CHANNELS, MOVING, TARGET
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import ENTRIES, STICKS
from slam.criticism.kalman.transition import FULL, NOISES, decay, process_noise

SHORT_S, ENDLESS_S = 1e-5, 1e6
"""Durations over which a noise only grows by its process noise, and over which it forgets its past."""


def filter_inputs(
    record: Record,
    parameters: FilterParameters,
    perturbations: Sequence[Perturbation],
    signals: dict[str, Signal],
    variance: Array,
    states: int,
) -> KalmanInputs:
    """Return the kernels' inputs; ``variance`` (channels,) is that of one reading."""
    events = EventArrays(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, record.first_step,
        record.step_s,
    )  # fmt: skip
    table, command = perturbation_arrays(record, parameters, perturbations, signals)
    diffusion = np.diag(_process_noise(parameters.hold, SHORT_S, states)) / SHORT_S
    noise = NoiseArrays(variance, record.range_limits, parameters.jitter_s, diffusion)
    return KalmanInputs(
        events, command, ModelArrays(parameters.dynamics, parameters.sensor, parameters.hold), noise, table
    )


def initial_state(
    record: Record, parameters: FilterParameters, states: int, perturbations: int
) -> KalmanState:
    """Return the estimate before the first reading: the record's initial guess and stationary noises."""
    state, p = np.zeros(states), np.zeros((states, states))
    state[:MOVING] = record.start
    p[np.arange(MOVING), np.arange(MOVING)] = record.start_std**2
    p[TARGET:, TARGET:] = _process_noise(parameters.hold, ENDLESS_S, states)[TARGET:, TARGET:]
    return KalmanState(state, p, np.zeros(len(CHANNELS)), np.zeros((states, perturbations)))


def _process_noise(hold: Array, h: float, n: int) -> Array:
    """Return the process noise (n, n) of the noise states over h seconds."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, h, matrix)
    process_noise(hold, matrix, q)
    return q


def workspace_for(n: int, m: int) -> Workspace:
    """Return buffers for n states and m perturbations."""
    return Workspace(
        StepBuffers(
            np.empty(FULL), np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n)), np.empty(FULL),
            np.empty(NOISES), np.empty((n, n)),
        ),
        PredictedReading(
            np.empty(FULL), np.empty(6), np.zeros((6, n)), np.zeros((6, MOVING)), np.empty(n), np.empty(n)
        ),
        PerturbationBuffers(
            np.zeros((ENTRIES, MOVING)), np.zeros(ENTRIES, dtype=np.bool_), np.zeros((ENTRIES, MOVING)),
            np.zeros((ENTRIES, 6)), np.empty(MOVING), np.zeros((6, m)), np.empty(m), np.empty((MOVING, m)),
        ),
        Scratch(
            np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL),
            np.empty(NOISES), np.empty(NOISES), np.empty(NOISES), np.empty(STICKS), np.empty(n), np.empty(6),
            np.empty(MOVING),
        ),
    )  # fmt: skip
