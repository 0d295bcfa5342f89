"""From homographies in pixels to relative poses in metres.

A homography fixes the pose of camera j relative to the floor once the floor is known in camera i: its
distance (height) and its normal (roll and pitch). Heights are left at 1 here: ``scale`` makes metres of
them when the heights of all keyframes have been agreed upon. All functions work on m pairs at once.

Source: Hartley and Zisserman 2004, sections 8.1 (plane to picture) and 5.2 (propagation of covariance);
Steder et al. 2008 for the down-looking case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LiftedPoses:
    """m relative poses in units of the height of keyframe i above the floor."""

    i_T_j: Array
    """(m, 4, 4), translation in heights of i."""
    covariance: Array
    """(m, 6, 6), rotation first, right perturbation; of homography and attitude, not of the height."""
    height_ratio: Array
    """(m,) height of j over height of i."""
    log_ratio_std: Array
    """(m,) standard deviation of log(height_ratio)."""
    misfit: Array
    """(m,) squared whitened distance between homography and best rigid pose, 2 degrees of freedom."""

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(m,) whether the pose is above the floor and its covariance positive definite."""
        finite = np.isfinite(self.covariance).all(axis=(1, 2)) & np.isfinite(self.i_T_j).all(axis=(1, 2))
        safe = np.where(np.asarray(finite)[:, None, None], self.covariance, np.eye(6))
        variances = np.linalg.eigvalsh(safe)
        definite = variances[:, 0] > 1e-12 * variances[:, -1]
        return finite & definite & (self.height_ratio > 0) & np.isfinite(self.log_ratio_std)

    def scale(self, height_m: Array, height_std_m: Array) -> tuple[Array, Array]:
        """Poses (m, 4, 4) and covariances (m, 6, 6) in metres, with the heights' own uncertainty."""
        i_T_j, covariance = self.i_T_j.copy(), self.covariance.copy()
        t = self.i_T_j[:, :3, 3]
        t_in_j = np.einsum("mba,mb->ma", self.i_T_j[:, :3, :3], t)
        i_T_j[:, :3, 3] = t * height_m[:, None]
        covariance[:, :3, 3:] *= height_m[:, None, None]
        covariance[:, 3:, :3] *= height_m[:, None, None]
        covariance[:, 3:, 3:] *= (height_m**2)[:, None, None]
        covariance[:, 3:, 3:] += np.einsum("ma,mb,m->mab", t_in_j, t_in_j, height_std_m**2)
        return i_T_j, covariance


def lift(
    i_H_j: Array,
    corner_covariance: Array,
    camera: Camera,
    roll_pitch_rad: Array,
    roll_pitch_std_rad: Array,
    normal_std_rad: float = 0.0,
) -> LiftedPoses:
    """Relative poses of m pairs from their homographies and the attitude of keyframe i.

    ``i_H_j`` (m, 3, 3); ``corner_covariance`` (m, 8, 8) px² as in `frontend.homography`;
    ``roll_pitch_rad`` and its std (m, 2). ``normal_std_rad`` adds a floor that is not level.
    """
    m = len(i_H_j)
    attitude_std = np.hypot(roll_pitch_std_rad, normal_std_rad)
    if m == 0:
        empty = np.empty(0)
        return LiftedPoses(np.empty((0, 4, 4)), np.empty((0, 6, 6)), empty, empty, empty)
    corners = camera.undistort(camera.corners_px)
    u = np.einsum("mab,kb->mka", i_H_j, np.column_stack([corners, np.ones(4)]))
    pixel_i = u[..., :2] / u[..., 2:]
    # The covariance stands in picture i; corner by corner it is carried back into j.
    local = (i_H_j[:, None, :2, :2] - pixel_i[..., :, None] * i_H_j[:, None, 2:, :2]) / u[..., 2, None, None]
    back = np.zeros((m, 8, 8))
    for k in range(4):
        back[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.linalg.inv(local[:, k])
    covariance_j = back @ corner_covariance @ back.transpose(0, 2, 1) + 1e-8 * np.eye(8)
    weight: Array = np.asarray(np.linalg.inv(covariance_j), dtype=float)

    start = _start(i_H_j, camera, roll_pitch_rad)
    pose, information, residual = _solve(pixel_i, corners, weight, camera, roll_pitch_rad, start)
    i_T_j = _relative(roll_pitch_rad, pose)
    covariance = np.linalg.inv(information)
    ratio_gradient = np.zeros((m, 6))
    ratio_gradient[:, 3:] = pose[:, 2, :3]  # d height_j / d xi
    ratio_variance = np.einsum("ma,mab,mb->m", ratio_gradient, covariance, ratio_gradient)
    step = 1e-4
    for axis in range(2):
        moved = roll_pitch_rad.copy()
        moved[:, axis] += step
        other, _, _ = _solve(pixel_i, corners, weight, camera, moved, pose, iterations=3)
        difference = _log(np.linalg.inv(i_T_j) @ _relative(moved, other)) / step
        covariance = covariance + np.einsum(
            "ma,mb,m->mab", difference, difference, attitude_std[:, axis] ** 2
        )
        ratio_variance += ((other[:, 2, 3] - pose[:, 2, 3]) / step * attitude_std[:, axis]) ** 2
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    ratio = pose[:, 2, 3]
    misfit = np.einsum("ma,mab,mb->m", residual, weight, residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_std = np.sqrt(ratio_variance) / ratio
    return LiftedPoses(i_T_j, covariance, ratio, log_std, misfit)


def level_T_body(roll_pitch_rad: Array) -> Array:
    """(m, 4, 4) bodies at height 1 above the origin with yaw 0."""
    pose = np.tile(np.eye(4), (len(roll_pitch_rad), 1, 1))
    pose[:, :3, :3] = Rotation.from_euler(
        "ZYX", np.column_stack([0 * roll_pitch_rad[:, 0], roll_pitch_rad[:, ::-1]])
    ).as_matrix()
    pose[:, 2, 3] = 1.0
    return pose


def _relative(roll_pitch_rad: Array, level_T_j: Array) -> Array:
    return np.linalg.inv(level_T_body(roll_pitch_rad)) @ level_T_j


def _start(i_H_j: Array, camera: Camera, roll_pitch_rad: Array) -> Array:
    """Pose of j from the similarity that the homography looks like at the centre of picture j."""
    w, h = camera.size_px
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    probe = np.array([centre, centre + [10.0, 0], centre + [0, 10.0]])
    u = np.einsum("mab,kb->mka", i_H_j, np.column_stack([probe, np.ones(3)]))
    pixel = u[..., :2] / u[..., 2:]
    right, down = (pixel[:, 1] - pixel[:, 0]) / 10, (pixel[:, 2] - pixel[:, 0]) / 10
    turn = np.arctan2(right[:, 1] - down[:, 0], right[:, 0] + down[:, 1])
    scale = np.sqrt(np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]))
    pose = level_T_body(roll_pitch_rad)
    # A turn seen in the picture (y down, looking down) is the opposite turn of the body about z up.
    c_z_up = camera.b_T_c[2, 2]
    yaw = np.sign(c_z_up) * turn
    pose[:, :3, :3] = Rotation.from_euler("z", yaw[:, None]).as_matrix() @ pose[:, :3, :3]
    pose[:, 2, 3] = scale
    target = _floor(pixel[:, :1], camera, level_T_body(roll_pitch_rad))[:, 0]
    seen = _floor(np.broadcast_to(centre, (len(pose), 1, 2)), camera, pose)[:, 0]
    pose[:, :2, 3] += target[:, :2] - seen[:, :2]
    return pose


def _floor(pixel: Array, camera: Camera, level_T_b: Array) -> Array:
    """(m, k, 3) points of the plane z = 0 under (m, k, 2) pixels."""
    level_T_c = level_T_b @ camera.b_T_c
    xy = (pixel - np.array(camera.center_px)) / np.array(camera.focal_px)
    ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
    ray = np.einsum("mab,mkb->mka", level_T_c[:, :3, :3], ray)
    return level_T_c[:, None, :3, 3] - ray * (level_T_c[:, 2, 3, None] / ray[..., 2])[..., None]


def _solve(
    pixel_i: Array,
    corners: Array,
    weight: Array,
    camera: Camera,
    roll_pitch_rad: Array,
    start: Array,
    iterations: int = 10,
) -> tuple[Array, Array, Array]:
    """Gauss-Newton for the poses of j: (m, 4, 4), information (m, 6, 6), residuals (m, 8)."""
    floor = _floor(pixel_i, camera, level_T_body(roll_pitch_rad))
    c_T_b: Array = np.asarray(np.linalg.inv(camera.b_T_c), dtype=float)
    pose = start.copy()
    focal, centre = np.array(camera.focal_px, float), np.array(camera.center_px, float)
    for k in range(iterations + 1):
        b_p = np.einsum("mba,mkb->mka", pose[:, :3, :3], floor - pose[:, None, :3, 3])
        c_p = b_p @ c_T_b[:3, :3].T + c_T_b[:3, 3]
        residual = (corners - (c_p[..., :2] / c_p[..., 2:] * focal + centre)).reshape(-1, 8)
        J = _projection_jacobian(b_p, c_p, c_T_b[:3, :3], focal)
        information = np.einsum("mka,mkl,mlb->mab", J, weight, J)
        if k == iterations:
            break
        gradient = np.einsum("mka,mkl,ml->ma", J, weight, residual)
        damping = 1e-9 * np.einsum("maa->m", information)[:, None, None] * np.eye(6)
        step = np.linalg.solve(information + damping, gradient[..., None])[..., 0]
        # A wild homography must not throw the others' arithmetic off: steps are bounded.
        step *= np.minimum(1.0, 0.5 / (np.abs(step).max(axis=1, keepdims=True) + 1e-12))
        pose = pose @ _exp(step)
    return pose, information, residual


def _projection_jacobian(b_p: Array, c_p: Array, R_cb: Array, focal: Array) -> Array:
    """(m, 8, 6) of projected pixels with respect to a right perturbation of the body."""
    m, k = b_p.shape[:2]
    d_pixel = np.zeros((m, k, 2, 3))
    z = c_p[..., 2]
    d_pixel[..., 0, 0] = focal[0] / z
    d_pixel[..., 1, 1] = focal[1] / z
    d_pixel[..., 0, 2] = -focal[0] * c_p[..., 0] / z**2
    d_pixel[..., 1, 2] = -focal[1] * c_p[..., 1] / z**2
    d_body = np.concatenate([_hat(b_p), np.broadcast_to(-np.eye(3), (m, k, 3, 3))], axis=-1)
    return (d_pixel @ R_cb @ d_body).reshape(m, 2 * k, 6)


def _hat(v: Array) -> Array:
    """Cross-product matrices of (..., 3) vectors."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def _exp(xi: Array) -> Array:
    """Rigid transforms for small steps: rotation exact, translation to first order."""
    T = np.tile(np.eye(4), (len(xi), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(xi[:, :3]).as_matrix()
    T[:, :3, 3] = xi[:, 3:]
    return T


def _log(T: Array) -> Array:
    """Small differences (m, 6), rotation first."""
    return np.concatenate([Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), T[:, :3, 3]], axis=1)
