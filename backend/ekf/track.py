"""Extended Kalman filter over all readings of a flight's instruments, and its smoother.

The paper's filter (section 3.1.2, equation 3: position, velocity, acceleration, attitude) in error-state
form, extended by instrument errors (`backend.ekf.motion`). Every stream is optional and may have gaps: all of
them, gyro and accelerometer included, are readings of the state (`backend.ekf.readings`). Visual steps are
readings relative to a cloned pose; the joint covariance of clone and current pose gives that of their
relative pose.

The state is that of the IMU, the result that of the body's origin.

World: z up, the floor z = 0. The first pose is above the origin and its heading is exact. The estimate is
relative to it, unless position readings make it absolute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.arguments import check_type
from backend.ekf import backward as ekf_backward
from backend.ekf import forward as ekf_forward
from backend.ekf import motion as at
from backend.ekf import readings as kinds
from backend.ekf.events import sort_events
from backend.ekf.inputs import CloneMode, FilterModel, InitialState, Readings
from backend.ekf.records import (
    FilterBuffers,
    FilterEvents,
    FilterInputs,
    FilterOutputs,
    FilterState,
    Gates,
    InnovationLog,
    StateRecords,
    Tape,
)
from backend.ekf.results import Track, build_channels, build_states
from backend.errors import BackendError
from backend.measurements import GRAVITY_M_S2
from backend.quantiles import chi_square_limit

Array = NDArray[np.float64]

_BLOCK = 256
"""Number of events between two checkpoints of the smoother, which limit its memory."""


def track(
    readings: Readings,
    at_s: Array,
    start: InitialState,
    model: FilterModel = FilterModel(),
    *,
    rounds: int = 2,
    clone: CloneMode = "none",
) -> Track:
    """Filter all readings in order of time; return states at ``at_s`` (n,), increasing.

    ``rounds`` is the number of smoothing rounds, 0 for the filter alone; each round after the first is
    linearised at the smoothed states of the previous one. ``clone`` selects the cloned pose: that of the
    first requested time, or of each one until the next; visual steps imply the latter. Raises
    ``BackendError``, with the time, if a value is not finite, and ``TypeError`` for other objects.
    """
    check_type(readings, Readings, "readings")
    check_type(start, InitialState, "start")
    check_type(model, FilterModel, "model")
    clone = "each" if readings.steps else clone
    events = sort_events(readings, at_s, clone)
    size = at.SIZE_WITHOUT_CLONE if clone == "none" else at.SIZE
    filtered = smoothed = _empty_records(len(at_s), size)
    log = _empty_log(events)
    linearization = np.zeros((0, at.STATE))
    for number in range(max(rounds, 1)):
        smoother = _SmootherRound(
            events, linearization, model, start, log if number == 0 else _empty_log(events), size
        )
        ahead = _empty_records(len(at_s), size)
        blocks = smoother.ahead(ahead)
        if number == 0:
            filtered = ahead
        if rounds > 0:
            last = number == rounds - 1
            smoothed = _empty_records(len(at_s), size, 0 if last else len(events.kind))
            smoother.back(blocks, smoothed)
            linearization = smoothed.all_x
    return Track(
        at_s,
        build_states(filtered, model, clone != "none"),
        build_states(smoothed, model, clone != "none") if rounds > 0 else None,
        build_channels(events, log, model),
    )


@dataclass(frozen=True)
class _Block:
    """Checkpoint: the filter's state before a block of events."""

    first: int
    last: int
    now_s: float
    state: FilterState


class _SmootherRound:
    """One round over a flight's events: a forward and a backward pass."""

    def __init__(
        self,
        events: FilterEvents,
        linearization: Array,
        model: FilterModel,
        start: InitialState,
        log: InnovationLog,
        size: int,
    ) -> None:
        component, step = (chi_square_limit(model.gate_probability, dof) for dof in (1, 6))
        gates = Gates(component, step, float(model.patience_s))
        self.inputs = FilterInputs(events, linearization, _model_vector(model), gates)
        self.start = _initial_state(start, model, size, linearization)
        self.log, self.size, self.work = log, size, _buffers(size)

    def ahead(self, found: StateRecords) -> list[_Block]:
        """Run the filter; return the checkpoint of each block. Raises ``BackendError``."""
        events, state = self.inputs.events, self.start
        now_s = float(events.stamps_s[0]) if len(events.kind) else 0.0
        outputs = FilterOutputs(self.log, found, _empty_tape(0, self.size))
        blocks = []
        for first in range(0, len(events.kind), _BLOCK):
            blocks.append(_Block(first, min(first + _BLOCK, len(events.kind)), now_s, state))
            now_s, state = self._run(blocks[-1], outputs)
        return blocks

    def back(self, blocks: list[_Block], found: StateRecords) -> None:
        """Run the filter again per block, then the backward pass. Raises ``BackendError``."""
        y, L = np.zeros(self.size), np.zeros((self.size, self.size))
        outputs = FilterOutputs(
            self.log, _empty_records(len(found.x), self.size), _empty_tape(_BLOCK, self.size)
        )
        for block in reversed(blocks):
            self._run(block, outputs)
            ekf_backward.backward(
                y, L, block.first, block.last, self.inputs.events, found, outputs.tape, self.work
            )
            if not (np.isfinite(y).all() and np.isfinite(L).all()):
                raise BackendError(
                    f"smoothed values are not finite at {block.now_s:.3f} s; smooth a part of the flight"
                )

    def _run(self, block: _Block, outputs: FilterOutputs) -> tuple[float, FilterState]:
        """Return time and state after a block."""
        state = FilterState(*(figures.copy() for figures in block.state))
        now_s, bad = ekf_forward.forward(
            block.first, block.last, block.now_s, state, self.inputs, outputs, self.work
        )
        if bad >= 0:
            self._raise_not_finite(bad)
        return now_s, state

    def _raise_not_finite(self, event: int) -> None:
        events = self.inputs.events
        kind = int(events.kind[event])
        name = next((name for name, number in kinds.CHANNELS.items() if number == kind), "nothing")
        raise BackendError(
            f"the filter's values are not finite at {events.stamps_s[event]:.3f} s, after a reading of "
            f"{name}: {events.value[event]}; check that stream there"
        )


def _rows(size: int) -> NDArray[np.int64]:
    """Return the recorded rows of the covariance: the motion with its rate, and the cloned pose."""
    return np.array(
        [*range(at.POS, at.ATTITUDE_ERROR), *(range(at.CLONE_POS, at.SIZE) if size == at.SIZE else ())]
    )


def _empty_records(asked: int, size: int, all_events: int = 0) -> StateRecords:
    rows = _rows(size)
    r = len(rows)
    return StateRecords(
        np.full((asked, at.STATE), np.nan),
        np.full((asked, r, r), np.nan),
        np.full((asked, size), np.nan),
        np.full((all_events, at.STATE), np.nan),
        rows,
    )


def _empty_log(events: FilterEvents) -> InnovationLog:
    count = len(events.kind)
    return InnovationLog(
        np.zeros((count, 6), np.int64), np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    )


def _empty_tape(length: int, size: int) -> Tape:
    return Tape(
        np.zeros((length, at.MOVING, at.MOVING)),
        np.zeros((length, 6, size)),
        np.zeros((length, 6, size)),
        np.zeros((length, 6)),
        np.zeros((length, 6)),
        np.zeros(length, np.int64),
        np.zeros((length, at.STATE)),
        np.zeros((length, size, size)),
    )


def _buffers(size: int) -> FilterBuffers:
    return FilterBuffers(
        np.zeros(6),
        np.zeros((6, size)),
        np.zeros(6),
        np.zeros(size),
        np.zeros((6, 7)),
        np.zeros((at.MOVING, at.MOVING)),
        np.zeros((at.MOVING, size)),
        np.zeros((size, size)),
    )


def _model_vector(model: FilterModel) -> Array:
    figures = [
        model.accel_m_s2, model.accel_time_s, model.rate_rad_s, model.rate_time_s, model.gyro_walk_rad_s2,
        model.accel_walk_m_s3, model.tilt_error_rad, model.tilt_error_time_s, model.yaw_walk_rad,
        model.velocity_error_m_s, model.velocity_error_time_s, model.barometer_walk_m,
        *model.b_beam,
    ]  # fmt: skip
    places_m = [model.b_p_range_m, model.b_p_camera_m, model.b_p_position_m, (0.0, 0.0, 0.0)]
    return np.concatenate([figures, (np.array(places_m) - model.b_p_imu_m).ravel()])


def _initial_state(start: InitialState, model: FilterModel, size: int, linearization: Array) -> FilterState:
    """Return the filter's state at the first event.

    ``linearization`` (n, STATE) are the points of the round, none in the first. The heading is uncertain
    about the vertical in body axes there: in those of a start that leans otherwise, it would be tied to the
    lean, which the readings tell far better.
    """
    x, std = np.zeros(at.STATE), np.zeros(size)
    x[:3] = [*start.place_m, start.height_m]
    x[at.VEL : at.ACC] = start.w_v_m_s
    turn = Rotation.from_matrix(start.w_R_b)
    x[at.X_ROT : at.X_RATE] = turn.as_quat(scalar_first=True)
    x[at.X_CLONE_ROT] = 1.0
    std[:3] = [start.place_std_m, start.place_std_m, start.height_std_m]
    std[at.VEL : at.ACC] = start.velocity_std_m_s
    std[at.ACC : at.ROT], std[at.RATE : at.ATTITUDE_ERROR] = start.accel_std_m_s2, start.rate_std_rad_s
    std[at.GYRO_BIAS : at.ACCEL_BIAS] = model.gyro_offset_rad_s
    std[at.ACCEL_BIAS : at.RANGE_SCALE] = model.accel_offset_m_s2
    tilt_error = model.tilt_error_rad if start.tilt_error_rad is None else start.tilt_error_rad
    std[at.ATTITUDE_ERROR : at.VEL_ERROR] = [tilt_error, tilt_error, start.yaw_zero_std_rad]
    x[at.X_ATTITUDE_ERROR + 2] = start.yaw_zero_rad
    x[at.X_RANGE_SCALE], x[at.X_VEL_SCALE : at.X_BARO_ZERO] = start.range_scale, start.velocity_scale
    std[at.RANGE_SCALE], std[at.RANGE_BIAS] = model.range_scale, model.range_offset_m
    std[at.VEL_SCALE : at.BARO_ZERO] = model.velocity_scale
    std[at.VEL_ERROR : at.GYRO_BIAS] = model.velocity_error_m_s
    std[at.BARO_ZERO], std[at.GPS_ZERO] = start.barometer_zero_std_m, start.position_zero_std_m
    C = np.diag(std**2)
    R = turn.as_matrix()
    about_world = np.array([start.tilt_std_rad, start.tilt_std_rad, start.yaw_std_rad]) ** 2
    first = x if len(linearization) == 0 else linearization[0]
    to_world = Rotation.from_quat(first[at.X_ROT : at.X_RATE], scalar_first=True).as_matrix()
    C[at.ROT : at.RATE, at.ROT : at.RATE] = to_world.T @ np.diag(about_world) @ to_world
    # The state of the IMU follows from that of the body's origin.
    x[:3] += R @ model.b_p_imu_m
    x[at.ACC : at.ROT] = GRAVITY_M_S2 * R[2]
    J, by_turn = np.eye(size), -R @ se3.cross_matrix(np.array(model.b_p_imu_m))
    J[at.POS : at.VEL, at.ROT : at.RATE] = J[at.VEL : at.ACC, at.RATE : at.ATTITUDE_ERROR] = by_turn
    J[at.ACC : at.ROT, at.ROT : at.RATE] = GRAVITY_M_S2 * se3.cross_matrix(to_world[2])
    return FilterState(x, np.zeros(size), J @ C @ J.T, np.full((kinds.CLONE + 1, 6), math.inf))
