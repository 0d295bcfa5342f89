"""Perturbations of the filter parameters, for which the filter computes the sensitivity of the innovations.

A perturbation changes a parameter of the equations or of an instrument, or the delay of the command, or
injects a signal into a channel, a target or a force. Sensitivities are per unit of the own parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slam.core.arrays import Array, Ints
from slam.criticism.kalman.arrays import CommandArrays, PerturbationArrays
from slam.criticism.kalman.filter_parameters import LATE_SPREAD, FilterParameters, slot
from slam.criticism.kalman.readings import IMU, READ_BY, WIDTH
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import ON_CHANNEL
from slam.simulation.dynamics import NOISE

Kind = Literal["dynamics", "sensor", "latency", "drift", "force", "channel", "camera", "picture"]
"""The last two act on pictures alone, not on readings."""
Signal = tuple[Array, Array]
"""Values in the middle of each step and at each event."""

FORCES = (*NOISE, "up", "ahead", "left")
"""Entries of a force: the equations' noises, the climb stick, and wind in the vehicle's own axes."""
JUMP_S = 0.002
"""Time resolution of a stick's jump in the log; the gyro jumps with the stick."""
GYRO_CHANNELS = 3
LATE_SHARE = 3.0 * LATE_SPREAD
JITTER_REACH, LARGE_JUMP = 3.0, 0.03
"""Standard deviations of a stamp, and the least jump of a stick that matters at that distance."""


@dataclass(frozen=True)
class Perturbation:
    """One change of the filter parameters."""

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


def parameter_perturbation(name: str, step: float) -> Perturbation:
    """Return the perturbation of a parameter of the equations, of an instrument or of the camera."""
    return Perturbation(name, *slot(name), step)


def perturbation_arrays(
    record: Record,
    parameters: FilterParameters,
    perturbations: Sequence[Perturbation],
    signals: dict[str, Signal],
) -> tuple[PerturbationArrays, CommandArrays]:
    """Return the perturbations of one flight as arrays, with the commands of all their variants."""
    m = len(perturbations)
    variants: list[tuple[float, float]] = [(parameters.latency_s, parameters.drift)]
    names = sorted({d.signal for d in perturbations if d.signal})
    table = PerturbationArrays(
        np.zeros(m, dtype=np.int64), np.zeros(m, dtype=np.int64), np.zeros(m, dtype=np.int64),
        np.tile(parameters.dynamics, (m, 1)), np.tile(parameters.sensor, (m, 1)),
        np.full(m, -1, dtype=np.int64), np.zeros(m, dtype=np.int64),
        np.array([signals[name][0] for name in names]).reshape(len(names), len(record.step_s)),
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
    begin_s, end_s, stick = record.step_begin_s, record.step_begin_s + record.step_s, record.stick
    over_steps = [stick.mean(begin_s / (1 + fast), end_s / (1 + fast), late_s) for late_s, fast in variants]
    at_events = [stick.at(record.times_s / (1 + fast), late_s) for late_s, fast in variants]
    ends = [stick.at(at_s / (1 + parameters.drift), parameters.latency_s) for at_s in (begin_s, end_s)]
    return CommandArrays(
        np.array(over_steps), np.array(at_events), ends[1] - ends[0], parameters.late_std_s**2,
        spoilt_channels(record, parameters),
    )  # fmt: skip


def spoilt_channels(record: Record, parameters: FilterParameters) -> Ints:
    """Return (events,) the number of each event's channels that a jump of the stick spoils."""
    size = np.abs(np.diff(record.stick.values, axis=0)).max(axis=1, initial=0.0)
    at = (record.stick.stamps_s[1:] + parameters.latency_s) * (1 + parameters.drift)
    near_jump = _apart(record.times_s, at[size > 0]) < JUMP_S + LATE_SHARE * parameters.latency_s
    spoilt = np.where(near_jump, GYRO_CHANNELS, 0)
    # With jittering stamps the smaller jump of the climb is uncertain as well.
    spoilt[_apart(record.times_s, at[size > LARGE_JUMP]) < JITTER_REACH * parameters.jitter_s] = WIDTH[IMU]
    return np.asarray(spoilt, dtype=np.int64)


def _apart(times_s: Array, moments_s: Array) -> Array:
    """Return the time from each entry to the nearest moment; infinite without moments."""
    if len(moments_s) == 0:
        return np.full(len(times_s), np.inf)
    after = np.searchsorted(moments_s, times_s)
    before_s = np.abs(times_s - moments_s[np.maximum(after - 1, 0)])
    after_s = np.abs(moments_s[np.minimum(after, len(moments_s) - 1)] - times_s)
    return np.asarray(np.minimum(before_s, after_s))
