"""Open-loop roll-outs: predictions of the equations alone from a filtered state, against later measurements.

This is the simulator's error after half a second, two and ten. Roll-outs without and with a cause start from
the same filtered states. Their difference is the error that the cause predicts: its covariate, in the units
of the channel. If the cause is right, the error without it rises one for one with it, and that with it not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from backend.compilation import allocating_kernel
from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.criticism.cause import JUDGED_HORIZON_S, Cause, ChannelError
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import (
    BEYOND_IMU,
    CHANNEL_UNITS,
    CHANNELS,
    GUST,
    IMU,
    MOVING,
    place_of,
    reading,
)
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.sensitivity import STICKS
from slam.criticism.kalman.transition import FULL, NOISES, POLE
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitting import first_parts, refit
from slam.criticism.search.search import LINEAR_Z, SHORT_S, SearchResult
from slam.criticism.verdict.held_out import fitted_parameters
from slam.simulation.dynamics import derivative, integrate
from slam.simulation.replay.compare import HORIZONS_S

_PLACES = {channel: place_of(channel) for channel in BEYOND_IMU}
"""Channel -> kind of its events, and column there."""
STEP_S = 0.01
START_EVERY_S = 2.0
SETTLE_S = 1.0
"""Time after which roll-outs start: in its first second the filter does not know the vehicle yet."""


def rollout_errors(
    records: Sequence[Record], before: Sequence[FilterParameters], after: Sequence[FilterParameters]
) -> tuple[ChannelError, ...]:
    """Return the errors of all channels but the imu's, pooled over the flights."""
    tried = [*zip(records, before, strict=True), *zip(records, after, strict=True)]
    states, found = in_threads(lambda pair: whole(*pair).states, tried), []
    halves = (states[: len(records)], before), (states[len(records) :], after)
    for horizon in HORIZONS_S:
        pooled = [pooled_residuals(records, *half, horizon) for half in halves]
        for channel in BEYOND_IMU:
            errors = [of[channel] for of in pooled]
            if len(errors[0]) and len(errors[1]):
                rms = [float(np.sqrt(np.mean(e**2))) for e in errors]
                found.append(ChannelError(CHANNELS[channel], CHANNEL_UNITS[channel], horizon, rms[0], rms[1]))
    return tuple(found)


def pooled_residuals(
    records: Sequence[Record],
    filtered: Sequence[Array],
    parameters: Sequence[FilterParameters],
    horizon_s: float,
    share: float = 0.25,
) -> dict[int, Array]:
    """Return channel -> ``rollout_residuals`` of all flights, of all channels but the imu's."""
    flights = zip(records, filtered, parameters, strict=True)
    each = [rollout_residuals(*flight, horizon_s, share) for flight in flights]
    return {c: np.concatenate([errors[c] for errors in each]) for c in BEYOND_IMU}


def rollout_residuals(
    record: Record, filtered: Array, parameters: FilterParameters, horizon_s: float, share: float = 0.25
) -> dict[int, Array]:
    """Return channel -> errors over the last share of the horizon, of roll-outs started every other second.

    ``filtered`` (events, >= 10) are their initial states.
    """
    begins = np.arange(record.times_s[0] + SETTLE_S, record.times_s[-1] - horizon_s, START_EVERY_S)
    errors: dict[int, list[Array]] = {c: [np.zeros(0)] for c in BEYOND_IMU}
    if len(begins) == 0:
        return {c: np.zeros(0) for c in errors}
    start_at = np.searchsorted(record.times_s, begins)
    begins = record.times_s[start_at]
    steps = round(horizon_s / STEP_S)
    start = np.column_stack([filtered[start_at, :MOVING], filtered[start_at, :2]])
    nodes = begins[:, None] + STEP_S * np.arange(steps + 1)
    fast = 1.0 + parameters.drift
    command = record.stick.mean(
        nodes[:, :-1].ravel() / fast, nodes[:, 1:].ravel() / fast, parameters.latency_s
    )
    path = integrate(
        start, command.reshape(len(begins), steps, STICKS), np.zeros((1, steps + 1, NOISES)),
        np.tile(parameters.dynamics, (len(begins), 1)), STEP_S,
    )  # fmt: skip
    for k, begin in enumerate(begins):
        judged = (record.times_s > begin + (1.0 - share) * horizon_s) & (record.times_s <= begin + horizon_s)
        rows = np.flatnonzero(judged & (record.kinds != IMU))
        at = np.column_stack([np.interp(record.times_s[rows], nodes[k], path[k, :, i]) for i in range(FULL)])
        commands = record.stick.at(record.times_s[rows] / fast, parameters.latency_s)
        own = parameters.dynamics, parameters.sensor, parameters.hold[POLE]
        predicted = _noise_free_readings(record.kinds[rows], at, commands, *own, record.elapsed[rows])
        for channel, (kind, c) in _PLACES.items():
            of_kind = record.kinds[rows] == kind
            error = record.values[rows[of_kind], c] - predicted[of_kind, c]
            if CHANNELS[channel] == "yaw":
                error = np.angle(np.exp(1j * error))
            errors[channel].append(error[np.isfinite(error)])
    return {c: np.concatenate(m) for c, m in errors.items()}


@allocating_kernel
def _noise_free_readings(
    kinds: Ints, at: Array, commands: Array, parameters: Array, sensor: Array, pole_s: float, elapsed: Array
) -> Array:
    """Return (events, 6) noise-free readings in the states ``at`` (events, 12)."""
    predicted, rate = np.zeros((len(kinds), 6)), np.zeros(FULL)
    state, noise = np.zeros(GUST), np.zeros(NOISES)
    for e in range(len(kinds)):
        derivative(at[e], commands[e], noise, parameters, rate)
        for i in range(MOVING):  # an assignment of a slice takes seconds to compile
            state[i] = at[e, i]
        reading(kinds[e], state, rate, sensor, parameters, pole_s, elapsed[e], predicted[e])
    return predicted


@dataclass(frozen=True)
class ChannelResiduals:
    """Errors of one channel, of roll-outs or of instruments, against the covariate of one cause."""

    cause: str
    channel: str
    unit: str
    explained: Array
    """(n,) error that the cause predicts for a model without it."""
    residuals: dict[str, Array]
    """Cause that is in the model, or "" for none -> (n,) measured less predicted."""


@dataclass(frozen=True)
class Covariate:
    """Covariates of the leading cause, and of its rival in the verdict."""

    cause: str
    rival: str
    """Name of the rival; empty where there is none, or where roll-outs cannot include it."""
    against: tuple[ChannelResiduals, ...]
    """Errors against the leading cause's covariate, and against the rival's."""


def covariate(parameters: FilterParameters, found: SearchResult, lead: Cause) -> Covariate | None:
    """Return the covariates of the leading cause and its rival; None where roll-outs do not show the cause.

    Sizes and nuisances are fitted without it, and with its rival; for a large cause the filter is run anew.
    """
    cause, rival = lead.name, lead.rival
    effect = next((e for e in found.chosen if e.name == cause), None)
    if effect is None or not (effect.perturbations or effect.relaxes):
        return None
    rest, short = [e for e in found.chosen if e is not effect], first_parts(found.records, SHORT_S)
    # Roll-outs cannot include a term that only adds noise.
    ways = (s.effect for s in found.in_place(effect, rival) if s.effect.perturbations or s.effect.relaxes)
    other = next(ways, None)

    def refitted(effects: list[Effect]) -> FilterParameters:
        if lead.z < LINEAR_Z and not effect.is_saturation:
            return fitted_parameters(found, effects)
        return refit(short, found.model, effect.without(parameters), effects)[1]

    models = {"": refitted(rest), cause: parameters}
    if other is not None:
        models[rival] = refitted([*rest, other])
    states = in_threads(lambda record: whole(record, parameters).states, short)
    pooled = {}
    for name, with_cause in models.items():
        errors = pooled_residuals(short, states, [with_cause] * len(short), JUDGED_HORIZON_S, 1.0)
        pooled[name] = {(CHANNELS[c], CHANNEL_UNITS[c]): off for c, off in errors.items()}
    return covariate_of(pooled, cause, rival if other is not None else "")


def covariate_of(
    pooled: Mapping[str, dict[tuple[str, str], Array]], cause: str, rival: str
) -> Covariate | None:
    """Return the covariates of a cause and its rival; None where no error shows the cause.

    ``pooled``: cause in the model, or "" for none -> channel and unit -> (n,) measured less predicted.
    """
    against = tuple(m for name in pooled if name and (m := _against(pooled, name)) is not None)
    if not against or against[0].cause != cause:
        return None
    return Covariate(cause, rival, against)


def _against(pooled: Mapping[str, dict[tuple[str, str], Array]], cause: str) -> ChannelResiduals | None:
    """Return the errors of the channel in which the cause removes the greatest share; None without one."""
    changed = [(c, plain) for c, plain in pooled[""].items() if np.any(plain != pooled[cause][c])]
    if not changed:
        return None
    best, _ = min(changed, key=lambda of: np.sum(pooled[cause][of[0]] ** 2) / max(np.sum(of[1] ** 2), 1e-300))
    residuals = {name: of[best] for name, of in pooled.items()}
    return ChannelResiduals(cause, *best, pooled[""][best] - pooled[cause][best], residuals)
