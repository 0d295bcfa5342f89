"""Results of the filter: states at the requested times, and innovations of each reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.ekf import motion as at
from backend.ekf import readings as kinds
from backend.ekf.inputs import FilterModel
from backend.ekf.records import USED, FilterEvents, InnovationLog, StateRecords
from backend.measurements import GRAVITY_M_S2
from backend.quantiles import chi_square_limit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class InstrumentInnovations:
    """Innovations and status of the readings of one instrument, per component."""

    stamps_s: Array
    """(m,) times of all readings."""
    innovation: Array
    """(m, d) reading minus prediction, each component conditioned on the previous ones; NaN if missing.
    d is 3; 6 for visual steps, which are whitened."""
    std: Array
    """(m, d) predicted standard deviation of the innovations."""
    status: NDArray[np.int64]
    """(m, d) see `backend.ekf.records`; 0 for a missing component."""
    log_likelihoods: Array
    """(m,) log likelihood of each reading, given the previous ones; innovations are clipped at the gate."""

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of all readings."""
        return float(self.log_likelihoods.sum())

    def count(self, status: int) -> int:
        """Return the number of components with a status."""
        return int((self.status == status).sum())

    @property
    def nis(self) -> Array:
        """(m, d) squared whitened innovations: 1 on average if the filter's model is correct."""
        return (self.innovation / self.std) ** 2

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """(m, d) True for components that were used with their full weight."""
        return np.asarray(self.status == USED)

    @property
    def mean_nis(self) -> float | None:
        """Mean NIS of the components with full weight; the others say nothing about the noise model."""
        return float(self.nis[self.accepted].mean()) if self.accepted.any() else None


@dataclass(frozen=True)
class States:
    """Filtered or smoothed states at the requested times."""

    w_T_b: Array
    """(n, 4, 4)."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation."""
    w_v_m_s: Array
    """(n, 3)."""
    w_a_m_s2: Array
    """(n, 3) acceleration of the IMU."""
    errors: dict[str, Array]
    """Instrument errors by name: (n, 3) gyro_offset, accel_offset, own_attitude; (n, 1) range_scale,
    range_offset, barometer_zero, position_zero; (n, 2) velocity_scale, velocity_error."""
    errors_std: dict[str, Array]
    motion_covariances: Array
    """(n, 12, 12) covariance of world position, velocity, acceleration, and attitude (right perturbation)."""
    clone_T_b: Array
    """(n, 4, 4) pose relative to the cloned pose; NaN if there is none."""
    clone_T_b_covariances: Array
    """(n, 6, 6) its covariance, from the joint one of both poses; rotation first, right perturbation."""
    fixed_clone_covariances: Array
    """(n, 6, 6) covariance of the pose if the cloned position were exact; NaN if there is no clone."""


@dataclass(frozen=True)
class Track:
    """Result of the filter and smoother."""

    stamps_s: Array
    """(n,) requested times."""
    filtered: States
    """Each state uses the readings until its time."""
    smoothed: States | None
    """Each state uses all readings."""
    channels: dict[str, InstrumentInnovations]


_MOTION = at.ATTITUDE_ERROR
"""Number of recorded rows before the cloned pose."""
_ERRORS = {
    "gyro_offset": (at.X_GYRO_BIAS, at.GYRO_BIAS, 3),
    "accel_offset": (at.X_ACCEL_BIAS, at.ACCEL_BIAS, 3),
    "own_attitude": (at.X_ATTITUDE_ERROR, at.ATTITUDE_ERROR, 3),
    "range_scale": (at.X_RANGE_SCALE, at.RANGE_SCALE, 1),
    "range_offset": (at.X_RANGE_BIAS, at.RANGE_BIAS, 1),
    "velocity_scale": (at.X_VEL_SCALE, at.VEL_SCALE, 2),
    "velocity_error": (at.X_VEL_ERROR, at.VEL_ERROR, 2),
    "barometer_zero": (at.X_BARO_ZERO, at.BARO_ZERO, 1),
    "position_zero": (at.X_GPS_ZERO, at.GPS_ZERO, 1),
}
"""Name -> index in the nominal state, index in the error state, and dimension."""


def build_states(found: StateRecords, model: FilterModel, clone: bool) -> States:
    """Convert nominal states and error covariances to poses of the body's origin and their covariances."""
    x, C = _of_origin(found, -np.array(model.b_p_imu_m))
    R = _rotations(x[:, at.X_ROT : at.X_RATE])
    w_T_b = _poses(R, x[:, :3])
    to_body = np.zeros((len(x), 6, at.RATE))
    to_body[:, :3, at.ROT : at.RATE] = np.eye(3)
    to_body[:, 3:, :3] = R.transpose(0, 2, 1)
    motion = C[:, : at.RATE, : at.RATE]
    clone_T_b, clone_T_b_covariances, since = np.full_like(w_T_b, np.nan), *np.full((2, len(x), 6, 6), np.nan)
    if clone:
        clone_T_b[1:], clone_T_b_covariances[1:], since[1:] = _from_clone(x[1:], C[1:], R[1:])
    return States(
        w_T_b=w_T_b,
        covariances=to_body @ motion @ to_body.transpose(0, 2, 1),
        w_v_m_s=x[:, at.VEL : at.ACC],
        w_a_m_s2=x[:, at.ACC : at.ROT],
        errors={name: x[:, k : k + d] for name, (k, _, d) in _ERRORS.items()},
        errors_std={name: found.std[:, k : k + d] for name, (_, k, d) in _ERRORS.items()},
        motion_covariances=motion,
        clone_T_b=clone_T_b,
        clone_T_b_covariances=clone_T_b_covariances,
        fixed_clone_covariances=since,
    )


def _of_origin(found: StateRecords, lever_m: Array) -> tuple[Array, Array]:
    """Return nominal states (n, STATE) and covariances (n, r, r) of the body's origin, ``lever_m`` (3,) from
    the IMU in body axes. The specific force becomes the acceleration of the IMU, in axes of the world."""
    x = found.x.copy()
    J = np.tile(np.eye(len(found.rows)), (len(x), 1, 1))
    R, across = _rotations(x[:, at.X_ROT : at.X_RATE]), se3.cross_matrix(lever_m)
    around = np.cross(x[:, at.X_RATE : at.X_ATTITUDE_ERROR], lever_m)
    J[:, at.ACC : at.ROT, at.ACC : at.ROT] = R
    J[:, at.ACC : at.ROT, at.ROT : at.RATE] = -R @ se3.cross_matrix(x[:, at.ACC : at.ROT])
    x[:, at.ACC : at.ROT] = np.einsum("nab,nb->na", R, x[:, at.ACC : at.ROT]) - [0.0, 0.0, GRAVITY_M_S2]
    x[:, :3] += R @ lever_m
    x[:, at.VEL : at.ACC] += np.einsum("nab,nb->na", R, around)
    J[:, : at.VEL, at.ROT : at.RATE] = J[:, at.VEL : at.ACC, at.RATE : at.ATTITUDE_ERROR] = -R @ across
    J[:, at.VEL : at.ACC, at.ROT : at.RATE] = -R @ se3.cross_matrix(around)
    if len(found.rows) > _MOTION:
        clone = _rotations(x[:, at.X_CLONE_ROT : at.STATE])
        x[:, at.X_CLONE_POS : at.X_CLONE_ROT] += clone @ lever_m
        J[:, _MOTION : _MOTION + 3, _MOTION + 3 :] = -clone @ across
    C = J @ found.C @ J.transpose(0, 2, 1)
    return x, 0.5 * (C + C.transpose(0, 2, 1))  # exactly symmetric


def _from_clone(x: Array, C: Array, w_R_b: Array) -> tuple[Array, Array, Array]:
    """Return the pose relative to the clone, its covariance, and that with an exact clone position."""
    clone = _rotations(x[:, at.X_CLONE_ROT : at.STATE]).transpose(0, 2, 1)
    R, moved = clone @ w_R_b, np.einsum("nab,nb->na", clone, x[:, :3] - x[:, at.X_CLONE_POS : at.X_CLONE_ROT])
    back, to_body = R.transpose(0, 2, 1), w_R_b.transpose(0, 2, 1)
    J, turned = np.zeros((len(x), 6, _MOTION + 6)), slice(_MOTION + 3, None)
    J[:, :3, at.ROT : at.RATE], J[:, :3, turned] = np.eye(3), -back
    J[:, 3:, :3], J[:, 3:, _MOTION : _MOTION + 3] = to_body, -to_body
    J[:, 3:, turned] = back @ se3.cross_matrix(moved)
    since = J.copy()
    since[:, :, turned] = 0.0  # the cloned attitude rotates the relative position, not the absolute one
    return _poses(R, moved), J @ C @ J.transpose(0, 2, 1), since @ C @ since.transpose(0, 2, 1)


def _rotations(q: Array) -> Array:
    return Rotation.from_quat(q, scalar_first=True).as_matrix() if len(q) else np.zeros((0, 3, 3))


def _poses(R: Array, t: Array) -> Array:
    T = np.tile(np.eye(4), (len(R), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, t
    return T


def build_channels(
    events: FilterEvents, log: InnovationLog, model: FilterModel
) -> dict[str, InstrumentInnovations]:
    """Split the log by instrument, without instruments that have no reading."""
    channels, gate = {}, chi_square_limit(model.gate_probability, 1)
    for name, number in kinds.CHANNELS.items():
        mine = np.flatnonzero(events.kind == number)
        if len(mine):
            width = 6 if number == kinds.STEP else 3
            innovation, variance = log.innovation[mine, :width], log.variance[mine, :width]
            nats = np.minimum(innovation**2 / variance, gate) + np.log(2 * np.pi * variance)
            channels[name] = InstrumentInnovations(
                events.stamps_s[mine],
                innovation,
                np.sqrt(variance),
                log.status[mine, :width],
                -0.5 * np.nansum(nats, axis=1),
            )
    return channels
