"""From homographies in pixels to relative poses in metres.

A homography fixes the pose of camera j relative to the floor once the floor is known in camera i: its
distance (height) and its normal (roll and pitch). It has two degrees of freedom more than a pose. These
correct roll and pitch as far as the sensor's uncertainty allows. The height is 1 here: ``scale`` converts the
result to metres once the heights of all keyframes are estimated. Until then the origin of the body axes is
placed at the camera, because the lever arm is known in metres only. All functions work on m pairs at once.

Source: Hartley and Zisserman 2004, sections 8.1 (plane to picture) and 5.2 (propagation of covariance);
Steder et al. 2008 for the down-looking case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera

Array = NDArray[np.float64]

_ITERATIONS = 10
"""Number of Gauss-Newton steps, the same for all pairs."""
_AT_ONCE = 1_000
"""Pairs in a block: the working memory of a pair is a hundred times as large as its result."""


@dataclass(frozen=True)
class LiftedPoses:
    """Relative poses of m pairs, body axes at the camera, in units of the height of camera i above the
    floor."""

    i_T_j: Array
    """(m, 4, 4) poses; translation in units of the height of camera i."""
    covariance: Array
    """(m, 6, 6), rotation first, right perturbation; from homography and attitude, without the height."""
    height_ratio: Array
    """(m,) height of camera j over height of camera i."""
    log_ratio_std: Array
    """(m,) standard deviation of log(height_ratio)."""
    misfit: Array
    """(m,) squared whitened distance of homography and attitude from the best pose, 2 degrees of freedom;
    infinite where camera j would face upwards."""
    b_p_c_m: Array
    """(3,) position of the camera on the body."""
    camera_above_body_m: Array
    """(m,) height of camera i above the body's origin."""

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Return (m,) whether camera j is above the floor and the covariance is positive definite."""
        finite = np.isfinite(self.covariance).all(axis=(1, 2)) & np.isfinite(self.i_T_j).all(axis=(1, 2))
        safe = np.where(np.asarray(finite)[:, None, None], self.covariance, np.eye(6))
        variances = np.linalg.eigvalsh(safe)
        definite = variances[:, 0] > 1e-12 * variances[:, -1]
        known = np.isfinite(self.log_ratio_std) & np.isfinite(self.misfit)
        return finite & definite & known & (self.height_ratio > 0)

    def scale(self, height_m: Array, height_std_m: Array) -> tuple[Array, Array]:
        """Return relative poses (m, 4, 4) and covariances (m, 6, 6) of the bodies in metres.

        ``height_m`` and ``height_std_m`` (m,) are the height of body i above the floor and its std.
        """
        camera_m = height_m + self.camera_above_body_m
        R, t = self.i_T_j[:, :3, :3], self.i_T_j[:, :3, 3]
        i_T_j = self.i_T_j.copy()
        i_T_j[:, :3, 3] = t * camera_m[:, None] + self.b_p_c_m - R @ self.b_p_c_m
        J = np.tile(np.eye(6), (len(t), 1, 1))
        J[:, 3:, :3] = _cross_matrix(self.b_p_c_m)  # rotation about the camera moves the body's origin
        J[:, 3:, 3:] *= camera_m[:, None, None]
        covariance = J @ self.covariance @ J.transpose(0, 2, 1)
        t_in_j = np.einsum("mba,mb->ma", R, t)
        covariance[:, 3:, 3:] += np.einsum("ma,mb,m->mab", t_in_j, t_in_j, height_std_m**2)
        return i_T_j, covariance


def lift(
    i_H_j: Array,
    corner_covariance: Array,
    camera: Camera,
    roll_pitch_rad: Array,
    roll_pitch_std_rad: Array,
) -> LiftedPoses:
    """Compute relative poses of m pairs from their homographies and the attitude of keyframe i.

    ``i_H_j`` (m, 3, 3); ``corner_covariance`` (m, 8, 8) px² as in `frontend.homography`;
    ``roll_pitch_rad`` and ``roll_pitch_std_rad`` (m, 2): attitude of body i relative to the floor.
    """
    m = len(i_H_j)
    lever = camera.b_T_c[:3, 3]
    if m == 0:
        empty = np.empty(0)
        return LiftedPoses(
            i_T_j=np.empty((0, 4, 4)),
            covariance=np.empty((0, 6, 6)),
            height_ratio=empty,
            log_ratio_std=empty,
            misfit=empty,
            b_p_c_m=lever,
            camera_above_body_m=empty,
        )
    blocks = [
        _lift_some(
            i_H_j[some], corner_covariance[some], camera, roll_pitch_rad[some], roll_pitch_std_rad[some]
        )
        for some in (slice(k, k + _AT_ONCE) for k in range(0, m, _AT_ONCE))
    ]
    i_T_j, covariance, ratio, log_std, misfit, above = (np.concatenate(b) for b in zip(*blocks, strict=True))
    return LiftedPoses(
        i_T_j=i_T_j,
        covariance=covariance,
        height_ratio=ratio,
        log_ratio_std=log_std,
        misfit=misfit,
        b_p_c_m=lever,
        camera_above_body_m=above,
    )


def _lift_some(
    i_H_j: Array, corner_covariance: Array, camera: Camera, roll_pitch_rad: Array, roll_pitch_std_rad: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return the per-pair fields of `LiftedPoses` for a block of pairs, in the order of its fields."""
    lever = camera.b_T_c[:3, 3]
    mount = camera.b_T_c.copy()
    mount[:3, 3] = 0.0
    camera = replace(camera, b_T_c=mount)
    corners = camera.undistort(camera.corners_px)
    u = np.einsum("mab,kb->mka", i_H_j, np.column_stack([corners, np.ones(4)]))
    pixel_i = u[..., :2] / u[..., 2:]
    # The covariance is expressed in picture i; it is transformed to picture j corner by corner.
    local = (i_H_j[:, None, :2, :2] - pixel_i[..., :, None] * i_H_j[:, None, 2:, :2]) / u[..., 2, None, None]
    back = np.zeros((len(i_H_j), 8, 8))
    for k in range(4):
        back[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.linalg.inv(local[:, k])
    covariance_j = back @ corner_covariance @ back.transpose(0, 2, 1) + 1e-8 * np.eye(8)
    weight: Array = np.asarray(np.linalg.inv(covariance_j), dtype=float)

    fit = _solve(pixel_i, corners, weight, camera, roll_pitch_rad, roll_pitch_std_rad, i_H_j)
    i_T_j = np.linalg.inv(level_T_body(fit.roll_pitch_rad)) @ fit.level_T_j
    carry = _relative_pose_jacobian(fit.roll_pitch_rad, i_T_j)
    covariance = carry @ fit.covariance @ carry.transpose(0, 2, 1)
    ratio = fit.level_T_j[:, 2, 3]
    along = fit.level_T_j[:, 2, :3]  # d ratio / d translation of j
    with np.errstate(divide="ignore", invalid="ignore"):
        log_std = np.sqrt(np.einsum("ma,mab,mb->m", along, fit.covariance[:, 3:6, 3:6], along)) / ratio
    above = level_T_body(fit.roll_pitch_rad)[:, 2, :3] @ lever
    return i_T_j, covariance, ratio, log_std, fit.misfit, above


def level_T_body(roll_pitch_rad: Array) -> Array:
    """Return poses (m, 4, 4) of bodies at height 1 above the origin with yaw 0."""
    pose = np.tile(np.eye(4), (len(roll_pitch_rad), 1, 1))
    pose[:, :3, :3] = Rotation.from_euler(
        "ZYX", np.column_stack([0 * roll_pitch_rad[:, 0], roll_pitch_rad[:, ::-1]])
    ).as_matrix()
    pose[:, 2, 3] = 1.0
    return pose


@dataclass(frozen=True)
class _Fit:
    level_T_j: Array
    roll_pitch_rad: Array
    """(m, 2) attitude of i estimated from the homography and the sensor."""
    covariance: Array
    """(m, 8, 8) joint covariance of pose j (right perturbation) and roll and pitch of i."""
    misfit: Array


def _relative_pose_jacobian(roll_pitch_rad: Array, i_T_j: Array) -> Array:
    """Return the Jacobian (m, 6, 8) of i_T_j by pose j in the level frame and by roll and pitch of i."""
    R, t = i_T_j[:, :3, :3], i_T_j[:, :3, 3]
    turn = _attitude_axes_in_body(roll_pitch_rad)
    carry = np.zeros((len(i_T_j), 6, 8))
    carry[:, :, :6] = np.eye(6)
    carry[:, :3, 6:] = -R.transpose(0, 2, 1) @ turn
    carry[:, 3:, 6:] = R.transpose(0, 2, 1) @ _cross_matrix(t) @ turn
    return carry


def _attitude_axes_in_body(roll_pitch_rad: Array) -> Array:
    """Return the rotation axes (m, 3, 2) of roll and pitch in body axes."""
    roll = roll_pitch_rad[:, 0]
    zero = np.zeros_like(roll)
    return np.stack(
        [np.stack([zero + 1, zero, zero], -1), np.stack([zero, np.cos(roll), -np.sin(roll)], -1)], axis=-1
    )


def _start(i_H_j: Array, camera: Camera, roll_pitch_rad: Array) -> Array:
    """Compute the pose of j in closed form: the homography from floor to picture j holds two axes and the
    origin.

    Source: Hartley and Zisserman 2004, example 8.1: P = K [r1 r2 t] for a plane.
    """
    level_T_c = level_T_body(roll_pitch_rad) @ camera.b_T_c
    c_from_level = level_T_c[:, :3, :3].transpose(0, 2, 1)
    i_plane = np.concatenate([c_from_level[..., :2], -c_from_level @ level_T_c[:, :3, 3:]], axis=-1)
    K = camera.matrix
    plane = (
        np.linalg.inv(i_H_j @ K) @ K @ i_plane
    )  # columns: x axis, y axis and origin of the floor in camera j
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.linalg.norm(plane[..., :2], axis=1)
        # The sign that puts camera j above the floor.
        plane *= (-np.sign(np.linalg.det(plane)) / np.sqrt(length.prod(axis=1)))[:, None, None]
        x, y = np.moveaxis(plane[..., :2] / np.linalg.norm(plane[..., :2], axis=1, keepdims=True), -1, 0)
        # Nearest orthogonal pair of axes.
        middle, across = _unit(x + y), _unit(x - y)
    x, y = (middle + across) / np.sqrt(2), (middle - across) / np.sqrt(2)
    pose = np.tile(np.eye(4), (len(i_H_j), 1, 1))
    pose[:, :3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    pose[:, :3, 3] = -np.einsum("mab,mb->ma", pose[:, :3, :3], plane[..., 2])
    return pose @ np.linalg.inv(camera.b_T_c)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _floor(pixel: Array, camera: Camera, roll_pitch_rad: Array) -> tuple[Array, Array]:
    """Return floor points (m, k, 3) of pixels (m, k, 2) of i and their derivatives (m, k, 3, 2) by roll and
    pitch."""
    level_T_b = level_T_body(roll_pitch_rad)
    level_R_c = level_T_b[:, :3, :3] @ camera.b_T_c[:3, :3]
    xy = (pixel - np.array(camera.center_px)) / np.array(camera.focal_px)
    ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
    ray = ray @ level_R_c.transpose(0, 2, 1)
    down = ray / -ray[..., 2:]
    axes = level_T_b[:, None, :3, :3] @ _attitude_axes_in_body(roll_pitch_rad)[:, None]
    swing = -_cross_matrix(down) @ axes
    return down + [0, 0, 1.0], swing + down[..., None] * swing[..., 2:, :]


def _solve(
    pixel_i: Array,
    corners: Array,
    weight: Array,
    camera: Camera,
    roll_pitch_rad: Array,
    roll_pitch_std_rad: Array,
    i_H_j: Array,
) -> _Fit:
    """Estimate the poses of j and the attitudes of i by Gauss-Newton.

    The two extra degrees of freedom of a homography inform the attitude of i beyond its sensor.
    """
    c_T_b: Array = np.asarray(np.linalg.inv(camera.b_T_c), dtype=float)
    pose, tilt = _start(i_H_j, camera, roll_pitch_rad), roll_pitch_rad.copy()
    focal, centre = np.array(camera.focal_px, float), np.array(camera.center_px, float)
    trust = 1.0 / np.maximum(roll_pitch_std_rad, 1e-6) ** 2
    prior = np.zeros((len(pose), 8, 8))
    prior[:, [6, 7], [6, 7]] = trust
    for k in range(_ITERATIONS + 1):
        floor, swing = _floor(pixel_i, camera, tilt)
        b_p = (floor - pose[:, None, :3, 3]) @ pose[:, :3, :3]
        c_p = b_p @ c_T_b[:3, :3].T + c_T_b[:3, 3]
        residual = (corners - (c_p[..., :2] / c_p[..., 2:] * focal + centre)).reshape(-1, 8)
        swing = pose[:, None, :3, :3].transpose(0, 1, 3, 2) @ swing
        J = _projection_jacobian(b_p, c_p, c_T_b[:3, :3], focal, swing)
        weighted = J.transpose(0, 2, 1) @ weight
        information = weighted @ J + prior
        if k == _ITERATIONS:
            break
        gradient = (weighted @ residual[..., None])[..., 0]
        gradient[:, 6:] += trust * (roll_pitch_rad - tilt)
        damping = 1e-9 * np.einsum("maa->m", information[:, :6, :6])[:, None, None] * np.eye(8)
        step = np.linalg.solve(information + damping, gradient[..., None])[..., 0]
        # Bounded steps keep the arithmetic of a wild homography finite.
        step *= np.minimum(1.0, 0.5 / (np.abs(step).max(axis=1, keepdims=True) + 1e-12))
        pose, tilt = pose @ _exp_small(step[:, :6]), tilt + step[:, 6:]
    misfit = np.einsum("ma,mab,mb->m", residual, weight, residual)
    misfit += (trust * (roll_pitch_rad - tilt) ** 2).sum(axis=1)
    looks_down = pose[:, 2, :3] @ camera.b_T_c[:3, 2] < 0
    misfit = np.where(looks_down, misfit, np.inf)  # a mirrored picture gives a pose with the floor behind
    covariance = np.linalg.inv(information)
    return _Fit(pose, tilt, 0.5 * (covariance + covariance.transpose(0, 2, 1)), misfit)


def _projection_jacobian(b_p: Array, c_p: Array, R_cb: Array, focal: Array, b_swing: Array) -> Array:
    """Return the Jacobian (m, 8, 8) of projected pixels by the body pose (right perturbation), roll and
    pitch."""
    m, k = b_p.shape[:2]
    d_pixel = np.zeros((m, k, 2, 3))
    z = c_p[..., 2]
    d_pixel[..., 0, 0] = focal[0] / z
    d_pixel[..., 1, 1] = focal[1] / z
    d_pixel[..., 0, 2] = -focal[0] * c_p[..., 0] / z**2
    d_pixel[..., 1, 2] = -focal[1] * c_p[..., 1] / z**2
    d_body = np.concatenate([_cross_matrix(b_p), np.broadcast_to(-np.eye(3), (m, k, 3, 3)), b_swing], axis=-1)
    return np.asarray((d_pixel @ R_cb @ d_body).reshape(m, 2 * k, 8))


def _cross_matrix(v: Array) -> Array:
    """``_cross_matrix(v) @ u == cross(v, u)``. (..., 3) -> (..., 3, 3).

    It is written out because that is six times as fast as numpy's ``cross``. The front end may not import the
    back end's function.
    """
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def _exp_small(xi: Array) -> Array:
    """Return rigid transforms of small Gauss-Newton steps: rotation exact, translation to first order on
    purpose."""
    T = np.tile(np.eye(4), (len(xi), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(xi[:, :3]).as_matrix()
    T[:, :3, 3] = xi[:, 3:]
    return T
