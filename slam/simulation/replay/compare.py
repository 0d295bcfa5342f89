"""Roll-outs of a model along a measured flight, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.ranges_at_body import ranges_at_body
from slam.simulation.model import Model
from slam.simulation.motion import simulate_motion
from slam.simulation.replay.channels import ReplayStream, replay_streams, truth_angles
from slam.simulation.replay.start import StartEstimator
from slam.simulation.stick import Stick, stick_of

Array = NDArray[np.float64]

HORIZONS_S = (0.5, 2.0, 10.0)
MAX_SPACING_S = 2.0
"""Largest spacing of the starts of roll-outs; otherwise they begin half a horizon apart."""
SAME_TILT_RAD = 1e-3
MIN_DURATION_S = 0.5
"""Shortest flight that can be replayed."""


@dataclass(frozen=True)
class Comparison:
    """One channel, measured and simulated."""

    name: str
    """``STREAM.COLUMN``: attitude.pitch, velocity.v_x, sonar.range, imu.gyro_z, truth.x, ..."""
    unit: str
    noise_std: float
    """Standard deviation of one sample according to the flight's sensor.yaml; 0 for the truth."""
    stamps_s: Array
    measured: Array
    simulated: Array
    """Prediction of the roll-out over the whole flight; NaN where there is none."""
    restarted: Array
    """Prediction of consecutive roll-outs over ``Replay.shown_s``."""
    rms: dict[float, float]
    """Horizon in s -> root mean square of measured minus simulated, over all samples of all roll-outs."""
    flight_rms: float
    """Root mean square over the whole flight in one roll-out."""


@dataclass(frozen=True)
class Replay:
    """Comparison of a flight with the simulation of its commands."""

    flight: str
    model: str
    begin_s: float
    end_s: float
    max_tilt_rad: float
    """Tilt at full stick in the model."""
    started_from: str
    """Source of the initial states: ``instruments`` or ``truth``."""
    channels: tuple[Comparison, ...]
    rollouts: dict[float, int]
    """Horizon -> number of roll-outs."""
    skipped: dict[float, int]
    """Horizon -> number of roll-outs that could not begin for lack of readings."""
    shown_s: float
    restarts_s: Array
    """Start times of the roll-outs, one after the other, that a channel's ``restarted`` joins."""
    pushes_s: tuple[tuple[float, float], ...]
    """Begin and end of each time in which the stick asks for a tilt."""
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _RollOut:
    begin_s: float
    rows: list[NDArray[np.int64]]
    """Indices of the readings of each stream within the roll-out."""
    simulated: list[Array]
    residuals: list[Array]
    """Measured minus simulated values of each stream."""


def replay(flight: Flight, model: Model, horizons_s: Sequence[float] = HORIZONS_S) -> Replay:
    """Simulate the commands of ``flight`` with ``model``, in one whole roll-out and in many over each
    horizon.

    The starts of roll-outs do not depend on the model. Raises ``InputError`` for a flight without commands,
    without anything to compare, or without a state to begin from.
    """
    stick, (begin_s, end_s), reported_tilt = _commanded(flight)
    flight, notes = _with_aligned_yaw(ranges_at_body(flight))
    tilt = model.vehicle.max_tilt_rad
    if abs(reported_tilt - tilt) > SAME_TILT_RAD:
        # The model's value is used, so that criticism can judge it.
        notes = (
            *notes,
            f"full stick asks for {tilt:.4g} rad as the model has it; the flight says {reported_tilt:.4g}",
        )
    streams = replay_streams(flight, model, begin_s, end_s)
    starts = StartEstimator(flight, model, (begin_s, end_s))
    whole = _first(streams, starts, stick, model, end_s)
    if whole is None:
        raise InputError(f"{flight.name}: too few readings of speed, attitude or height to begin from")
    rolled = {
        horizon: _many(streams, starts, stick, model, _begins(begin_s, end_s, horizon), horizon, end_s)
        for horizon in horizons_s
    }
    shown_s = min(horizons_s, key=lambda horizon: abs(horizon - 2.0))
    consecutive = _consecutive(rolled[shown_s], shown_s)
    channels = []
    for n, stream in enumerate(streams):
        for k, channel in enumerate(stream.channels):
            channels.append(
                Comparison(
                    name=channel.name,
                    unit=channel.unit,
                    noise_std=channel.noise_std,
                    stamps_s=stream.times_s,
                    measured=stream.values[:, k],
                    simulated=_predictions([whole], n, k, len(stream.times_s)),
                    restarted=_predictions(consecutive, n, k, len(stream.times_s)),
                    rms={horizon: _rms(rolls, n, k) for horizon, rolls in rolled.items()},
                    flight_rms=_rms([whole], n, k),
                )
            )
    counts = {horizon: len(rolls) for horizon, rolls in rolled.items()}
    skipped = {h: len(_begins(begin_s, end_s, h)) - count for h, count in counts.items()}
    return Replay(
        flight=flight.name,
        model=model.name,
        begin_s=whole.begin_s,
        end_s=end_s,
        max_tilt_rad=tilt,
        started_from=starts.source,
        channels=tuple(channels),
        rollouts=counts,
        skipped=skipped,
        shown_s=shown_s,
        restarts_s=np.array([roll.begin_s for roll in consecutive]),
        pushes_s=stick.pushes_s(whole.begin_s, end_s),
        warnings=(*notes, *starts.warnings),
    )


def _commanded(flight: Flight) -> tuple[Stick, tuple[float, float], float]:
    """Return the stick, the interval with commands and readings, and the reported tilt at full stick."""
    command = flight.command
    if command is None or len(command.stamps_s) == 0:
        reason = flight.reason_not_read("command0") or "holds no commands (command0)"
        raise InputError(
            f"{flight.name}: {reason}, so there is nothing to replay; give a flight with command0"
        )
    if len(command.stamps_s) == 1:
        raise InputError(f"{flight.name}: command0 has 1 row, so nothing to replay; a flight has several")
    readings = (flight.imu, flight.attitude, flight.velocity, flight.sonar, flight.truth)
    stamps = [series.stamps_s for series in readings if series is not None and len(series.stamps_s)]
    if not stamps:
        raise InputError(f"{flight.name}: holds nothing but commands, so there is nothing to compare")
    begin_s = max(float(command.stamps_s[0]), min(float(s[0]) for s in stamps))
    end_s = min(float(command.stamps_s[-1]), max(float(s[-1]) for s in stamps))
    if end_s < begin_s:
        raise InputError(
            f"{flight.name}: the command log is on another clock, {begin_s - end_s:.0f} s away from the "
            "readings; write the stamps of command0 on the clock of the other streams"
        )
    if end_s - begin_s < MIN_DURATION_S:
        raise InputError(
            f"{flight.name}: commands and readings share {end_s - begin_s:.2f} s, {MIN_DURATION_S:g} s are "
            "the least; give a longer recording"
        )
    first_s = float(command.stamps_s[0])
    stick = stick_of(command, float(command.stamps_s[-1]) - first_s, first_s)
    return stick, (begin_s, end_s), command.max_tilt_rad


def _with_aligned_yaw(flight: Flight) -> tuple[Flight, tuple[str, ...]]:
    """Align the on-board yaw with the truth, if the replay takes its initial states from the truth."""
    attitude, truth = flight.attitude, flight.truth
    if attitude is None or truth is None or flight.velocity is not None:
        return flight, ()
    yaw = np.interp(attitude.stamps_s, truth.stamps_s, truth_angles(truth)[:, 2])
    difference = attitude.roll_pitch_yaw_rad[:, 2] - yaw
    if not np.isfinite(difference).any():
        return flight, ()
    zero = float(np.angle(np.nanmean(np.exp(1j * difference))))
    turned = attitude.roll_pitch_yaw_rad.copy()
    turned[:, 2] = yaw + np.angle(np.exp(1j * (difference - zero)))
    note = f"the on-board yaw was turned by {-np.degrees(zero):.1f} deg to that of the truth"
    return replace(flight, attitude=replace(attitude, roll_pitch_yaw_rad=turned)), (note,)


def _begins(begin_s: float, end_s: float, horizon_s: float) -> Array:
    spacing = min(horizon_s / 2, MAX_SPACING_S)
    return np.arange(begin_s, max(end_s - horizon_s, begin_s) + 1e-9, spacing)


def _first(
    streams: Sequence[ReplayStream], starts: StartEstimator, stick: Stick, model: Model, end_s: float
) -> _RollOut | None:
    """Return the roll-out to the flight's end, from the first moment with all necessary readings."""
    begin_s = max(stream.times_s[0] for stream in streams if len(stream.times_s))
    for later in np.arange(0.0, MAX_SPACING_S, 0.1):
        rolls = _many(streams, starts, stick, model, np.array([begin_s + later]), end_s - begin_s, end_s)
        if rolls:
            return rolls[0]
    return None


def _many(
    streams: Sequence[ReplayStream],
    starts: StartEstimator,
    stick: Stick,
    model: Model,
    begins_s: Array,
    horizon_s: float,
    last_s: float,
) -> list[_RollOut]:
    """Return roll-outs of one length, without those that cannot begin."""
    rolls = []
    for begin_s in begins_s.tolist():
        end_s = min(begin_s + horizon_s, last_s)
        start = starts.at(begin_s)
        if start is None or end_s <= begin_s:
            continue
        motion = simulate_motion(stick, model, start, begin_s=begin_s, end_s=end_s)
        rows = [stream.within(begin_s, end_s) for stream in streams]
        simulated = [s.predict(motion, s.times_s[row]) for s, row in zip(streams, rows, strict=True)]
        residuals = [s.residual(row, found) for s, row, found in zip(streams, rows, simulated, strict=True)]
        # Simulated angles are moved by whole turns to the measured ones.
        simulated = [
            np.where(np.isfinite(o), s.values[row] - o, found)
            for s, row, found, o in zip(streams, rows, simulated, residuals, strict=True)
        ]
        rolls.append(_RollOut(begin_s, rows, simulated, residuals))
    return rolls


def _consecutive(rolls: Sequence[_RollOut], horizon_s: float) -> list[_RollOut]:
    """Select roll-outs that do not overlap, each the first to begin after the previous one ends."""
    chosen: list[_RollOut] = []
    for roll in rolls:
        if not chosen or roll.begin_s >= chosen[-1].begin_s + horizon_s - 1e-9:
            chosen.append(roll)
    return chosen


def _predictions(rolls: Sequence[_RollOut], stream: int, column: int, count: int) -> Array:
    """Return the prediction (count,) of each reading; NaN where no roll-out has one."""
    out = np.full(count, np.nan)
    for roll in rolls:
        out[roll.rows[stream]] = roll.simulated[stream][:, column]
    return out


def _rms(rolls: Sequence[_RollOut], stream: int, column: int) -> float:
    """Return the root mean square over all readings with a prediction; NaN without any."""
    residuals = (
        np.concatenate([roll.residuals[stream][:, column] for roll in rolls]) if rolls else np.empty(0)
    )
    residuals = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float("nan")
