"""What the filter's kernels start from: a record and a belief as flat arrays, and room to work in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.kalman.arrays import (
    Array,
    EventArrays,
    FilterInputs,
    FilterState,
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
from slam.criticism.kalman.transition import FULL, NOISES, decay, kicks

SHORT_S, ENDLESS_S = 1e-5, 1e6
"""Steps over which a noise but grows by its kicks, and over which nothing of its past is left."""


def filter_inputs(
    record: Record,
    setting: FilterParameters,
    perturbations: Sequence[Perturbation],
    signals: dict[str, Signal],
    variance: Array,
    states: int,
) -> FilterInputs:
    """Record, belief and directions as the kernels take them: ``variance`` (channels,) of one reading."""
    events = EventArrays(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, record.first_step,
        record.step_s,
    )  # fmt: skip
    table, command = perturbation_arrays(record, setting, perturbations, signals)
    rough = np.diag(_kicks(setting.hold, SHORT_S, states)) / SHORT_S
    noise = NoiseArrays(variance, record.range_limits, setting.jitter_s, rough)
    return FilterInputs(
        events, command, ModelArrays(setting.parameters, setting.sensor, setting.hold), noise, table
    )


def initial_state(record: Record, setting: FilterParameters, states: int, perturbations: int) -> FilterState:
    """The estimate before the first reading: the record's first guess, and noises that are stationary."""
    state, p = np.zeros(states), np.zeros((states, states))
    state[:MOVING] = record.start
    p[np.arange(MOVING), np.arange(MOVING)] = record.start_std**2
    p[TARGET:, TARGET:] = _kicks(setting.hold, ENDLESS_S, states)[TARGET:, TARGET:]
    return FilterState(state, p, np.zeros(len(CHANNELS)), np.zeros((states, perturbations)))


def _kicks(hold: Array, h: float, n: int) -> Array:
    """(n, n) process noise of the noises over h."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, h, matrix)
    kicks(hold, matrix, q)
    return q


def workspace_for(n: int, m: int) -> Workspace:
    """Room to work for n states and m directions."""
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
