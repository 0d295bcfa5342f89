"""What the filter's kernels start from: a record and a belief as flat arrays, and room to work in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.criticism.kalman.arrays import (
    Array,
    Belief,
    Changes,
    Estimate,
    Events,
    Expected,
    Given,
    Noise,
    Room,
    Scratch,
    Step,
)
from slam.criticism.kalman.readings import CHANNELS, MOVING, TARGET
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import ENTRIES, STICKS
from slam.criticism.kalman.setting import Setting
from slam.criticism.kalman.tangents import Direction, Signal, directions_for
from slam.criticism.kalman.transition import FULL, NOISES, decay, kicks

SHORT_S, ENDLESS_S = 1e-5, 1e6
"""Steps over which a noise but grows by its kicks, and over which nothing of its past is left."""


def given_for(
    record: Record,
    setting: Setting,
    directions: Sequence[Direction],
    signals: dict[str, Signal],
    variance: Array,
    states: int,
) -> Given:
    """Record, belief and directions as the kernels take them: ``variance`` (channels,) of one reading."""
    events = Events(
        record.times_s, record.kinds, record.values, record.elapsed, record.landing, record.first_step,
        record.step_s,
    )  # fmt: skip
    table, command = directions_for(record, setting, directions, signals)
    rough = np.diag(_kicks(setting.hold, SHORT_S, states)) / SHORT_S
    noise = Noise(variance, record.range_limits, setting.jitter_s, rough)
    return Given(events, command, Belief(setting.parameters, setting.sensor, setting.hold), noise, table)


def start_of(record: Record, setting: Setting, states: int, directions: int) -> Estimate:
    """The estimate before the first reading: the record's first guess, and noises that are stationary."""
    state, p = np.zeros(states), np.zeros((states, states))
    state[:MOVING] = record.start
    p[np.arange(MOVING), np.arange(MOVING)] = record.start_std**2
    p[TARGET:, TARGET:] = _kicks(setting.hold, ENDLESS_S, states)[TARGET:, TARGET:]
    return Estimate(state, p, np.zeros(len(CHANNELS)), np.zeros((states, directions)))


def _kicks(hold: Array, h: float, n: int) -> Array:
    """(n, n) process noise of the noises over h."""
    matrix, q = np.zeros((n, n)), np.zeros((n, n))
    decay(hold, h, matrix)
    kicks(hold, matrix, q)
    return q


def room_for(n: int, m: int) -> Room:
    """Room to work for n states and m directions."""
    return Room(
        Step(
            np.empty(FULL), np.empty((MOVING, n)), np.zeros((n, n)), np.zeros((n, n)), np.empty(FULL),
            np.empty(NOISES), np.empty((n, n)),
        ),
        Expected(
            np.empty(FULL), np.empty(6), np.zeros((6, n)), np.zeros((6, MOVING)), np.empty(n), np.empty(n)
        ),
        Changes(
            np.zeros((ENTRIES, MOVING)), np.zeros(ENTRIES, dtype=np.bool_), np.zeros((ENTRIES, MOVING)),
            np.zeros((ENTRIES, 6)), np.empty(MOVING), np.zeros((6, m)), np.empty(m), np.empty((MOVING, m)),
        ),
        Scratch(
            np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL),
            np.empty(NOISES), np.empty(NOISES), np.empty(NOISES), np.empty(STICKS), np.empty(n), np.empty(6),
            np.empty(MOVING),
        ),
    )  # fmt: skip
