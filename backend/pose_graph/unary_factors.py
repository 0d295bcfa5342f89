"""Unary factors: measurements of a single pose in the world, as gtsam factors, and alignment to them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.gauge import GAUGE_STD
from backend.measurements import Attitude, Position, SlantRange
from backend.robust import robust

Array = NDArray[np.float64]


@dataclass(frozen=True)
class UnaryFactor:
    """One measurement of a single pose in the world."""

    k: int
    factor: gtsam.NonlinearFactor
    """Factor with its robust loss, if it has one."""
    gaussian: gtsam.NonlinearFactor
    """The same factor with Gaussian noise."""
    kind: Literal["attitude", "range", "position", "fixed"]
    w_R_b: Array | None = None
    """(3, 3) attitude, if roll and pitch are measured."""
    heading_known: bool = False
    rows: int = 0
    """Number of coordinates that a position or range measures."""
    w_p_m: Array = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) place of a point of the body in the world, NaN for an axis that was not measured."""
    b_p_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) that point in body axes."""
    b_p_floor_m: Array = field(default_factory=lambda: np.full(3, np.nan))
    """(3,) floor point that a range measured, in body axes."""

    def with_key(self, k: int) -> UnaryFactor:
        """Return the same measurement on another key."""
        return replace(self, k=k, factor=self.factor.rekey([k]), gaussian=self.gaussian.rekey([k]))


def gtsam_poses(T: Array, dimension: int) -> list[Any]:
    """Convert transforms (n, 4, 4) to gtsam poses."""
    if dimension == 2:
        return [gtsam.Pose2(*row) for row in se3.to_planar(T).tolist()]
    rotations = T[:, :3, :3].reshape(-1, 9).tolist()
    return [gtsam.Pose3(gtsam.Rot3(*R), t) for R, t in zip(rotations, T[:, :3, 3], strict=True)]


def fixed(k: int, w_T: Array, dimension: int) -> UnaryFactor:
    """Return a tight prior that fixes a pose (4, 4)."""
    make = gtsam.PriorFactorPose2 if dimension == 2 else gtsam.PriorFactorPose3
    noise = gtsam.noiseModel.Isotropic.Sigma(3 if dimension == 2 else 6, GAUGE_STD)
    factor = make(k, gtsam_poses(w_T[None], dimension)[0], noise)
    return UnaryFactor(
        k=k,
        factor=factor,
        gaussian=factor,
        kind="fixed",
        w_R_b=w_T[:3, :3],
        heading_known=True,
        w_p_m=w_T[:3, 3],
    )


def attitude(measured: Attitude) -> UnaryFactor | None:
    """Return the factor of roll, pitch and heading; None if no angle was measured.

    With an unknown heading gtsam's tilt factor is used: a rotation's logarithm mixes the axes when the
    heading is far off. It has one noise for both axes, so the larger tilt deviation is taken.
    """
    angle = measured.roll_pitch_yaw_rad
    with np.errstate(divide="ignore"):
        weight = np.where(np.isfinite(angle), 1 / measured.std_rad, 0)
    if not weight.any():
        return None
    R = Rotation.from_euler("xyz", np.where(np.isfinite(angle), angle, 0)).as_matrix()
    if weight[2] == 0 and weight[:2].all():
        up = gtsam.Unit3(np.array([0, 0, 1.0]))
        tilt = gtsam.noiseModel.Isotropic.Sigma(2, float(1 / weight[:2].min()))
        factor: gtsam.NonlinearFactor = gtsam.AttitudeFactorPose3(measured.k, up, tilt, gtsam.Unit3(R[2]))
    else:
        # Columns: body-axis rotation rates of roll, pitch and yaw for R = Rz Ry Rx.
        roll = Rotation.from_euler("x", np.nan_to_num(angle[0])).as_matrix()
        rates = np.column_stack([[1.0, 0, 0], roll[1], R[2]])
        root = weight[:, None] * np.linalg.inv(rates)
        noise = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
        factor = gtsam.PoseRotationPrior3D(measured.k, gtsam.Rot3(R), noise)
    level = bool(weight[:2].all())
    return UnaryFactor(
        k=measured.k,
        factor=factor,
        gaussian=factor,
        kind="attitude",
        w_R_b=R if level else None,
        heading_known=bool(weight[2]),
    )


def slant_range(measured: SlantRange, cos_tilt: float = 1.0) -> UnaryFactor:
    """Return the factor of a range along the sensor's -z to the plane z = 0: the measured point has height 0.

    This is gtsam's position factor with that point as lever arm and zero weight on x and y. ``cos_tilt`` of
    the beam converts the standard deviation along it to that of the height.
    """
    root = np.diag([0, 0, 1 / (measured.std_m * cos_tilt)])
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
    arm = measured.b_T_s[:3] @ [0, 0, -measured.range_m, 1]
    gaussian = gtsam.GPSFactorArm(measured.k, np.zeros(3), arm, noise)
    factor = gtsam.GPSFactorArm(measured.k, np.zeros(3), arm, robust(noise, 1))
    return UnaryFactor(k=measured.k, factor=factor, gaussian=gaussian, kind="range", b_p_floor_m=arm, rows=1)


def position(measured: Position, antenna_m: Array = np.zeros(3)) -> UnaryFactor | None:
    """Return the factor of a position of the antenna at ``antenna_m`` (3,) of the body; None if no axis was
    measured.

    NaN or an infinite standard deviation marks an axis that was not measured.
    """
    with np.errstate(divide="ignore"):
        weight = np.where(np.isfinite(measured.w_p_antenna_m), 1 / measured.std_m, 0)
    if not weight.any():
        return None
    place = np.where(weight > 0, measured.w_p_antenna_m, 0)
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(np.diag(weight), False)
    gaussian = gtsam.GPSFactorArm(measured.k, place, antenna_m, noise)
    rows = int((weight > 0).sum())
    factor = gtsam.GPSFactorArm(measured.k, place, antenna_m, robust(noise, rows))
    return UnaryFactor(
        k=measured.k,
        factor=factor,
        gaussian=gaussian,
        kind="position",
        w_p_m=np.where(weight > 0, place, np.nan),
        b_p_m=antenna_m,
        rows=rows,
    )


def jacobian(unary: UnaryFactor, w_T: Array, origin_m: Array) -> Array:
    """Return the whitened Jacobian (r, 6) of a spatial unary factor at the pose ``w_T`` (4, 4).

    The derivative is by a motion in world axes, rotation first, about the point ``origin_m`` (3,).
    """
    if unary.w_R_b is not None and not unary.heading_known:
        # A residual tilt would turn with the heading and imply information on it: linearise without residual.
        up = w_T[:3, :3] @ unary.w_R_b[2]
        w_T = w_T.copy()
        w_T[:3, :3] = Rotation.align_vectors([[0, 0, 1.0]], up[None])[0].as_matrix() @ w_T[:3, :3]
    values = gtsam.Values()
    values.insert(unary.k, gtsam.Pose3(w_T))
    origin = np.eye(4)
    origin[:3, 3] = origin_m
    J = np.asarray(unary.gaussian.linearize(values).jacobian()[0])
    return J @ se3.adjoint(se3.inverse(w_T) @ origin)


def aligned(w_T: Array, unary_factors: tuple[UnaryFactor, ...]) -> Array:
    """Align a rigid trajectory (n, 4, 4) to unary factors: an initial guess, not an estimate."""
    w_T = w_T.copy()
    rotations = [a for a in unary_factors if a.w_R_b is not None]
    places = [a for a in unary_factors if np.isfinite(a.w_p_m).any()]
    known = [a for a in places if np.isfinite(a.w_p_m).all()]
    if rotations:
        w_T = _rotated(w_T, _mean_rotation(w_T, rotations))
    elif len(known) >= 3:
        w_T = _rotated(w_T, _procrustes(w_T, known, planar=False))
    flat = [a for a in places if np.isfinite(a.w_p_m[:2]).all()]
    if not any(a.heading_known for a in rotations) and len(flat) >= 2:
        w_T = _rotated(w_T, _procrustes(w_T, flat, planar=True))
    for axis in range(3):
        shift = [a.w_p_m[axis] - _place(w_T, a)[axis] for a in places if np.isfinite(a.w_p_m[axis])]
        if axis == 2 and not shift:
            shift = [-w_T[a.k, 2] @ [*a.b_p_floor_m, 1] for a in unary_factors if a.kind == "range"]
        if shift:
            w_T[:, axis, 3] += np.median(shift)
    return w_T


def _place(w_T: Array, unary: UnaryFactor) -> Array:
    """Return the place (3,) on the trajectory (n, 4, 4) of the point that a factor measures."""
    return np.asarray(w_T[unary.k, :3, :3] @ unary.b_p_m + w_T[unary.k, :3, 3])


def _rotated(w_T: Array, R: Array) -> Array:
    turn = np.eye(4)
    turn[:3, :3] = R
    return turn @ w_T


def _mean_rotation(w_T: Array, rotations: list[UnaryFactor]) -> Array:
    full = [a for a in rotations if a.heading_known]
    if full:
        total = sum((a.w_R_b @ w_T[a.k, :3, :3].T for a in full if a.w_R_b is not None), np.zeros((3, 3)))
        return np.asarray(se3.nearest_rotations(total[None])[0])
    up = np.sum([w_T[a.k, :3, :3] @ a.w_R_b[2] for a in rotations if a.w_R_b is not None], axis=0)
    return Rotation.align_vectors([[0, 0, 1.0]], [up / max(np.linalg.norm(up), 1e-12)])[0].as_matrix()


def _procrustes(w_T: Array, places: list[UnaryFactor], planar: bool) -> Array:
    """Return the rotation from trajectory to measured positions; later passes exclude outliers."""
    p = np.array([_place(w_T, a) for a in places])
    q = np.array([a.w_p_m for a in places])
    if planar:
        p[:, 2] = q[:, 2] = 0
    use = np.ones(len(p), dtype=bool)
    R = np.eye(3)
    for _ in range(3):
        M = (q[use] - q[use].mean(axis=0)).T @ (p[use] - p[use].mean(axis=0))
        if planar:
            angle = np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])
            R = Rotation.from_euler("z", angle).as_matrix()
        else:
            R = se3.nearest_rotations(M[None])[0]
        off = q - p @ R.T
        miss = np.linalg.norm(off - np.median(off, axis=0), axis=1)
        use = miss <= 3 * max(float(np.median(miss)), 1e-9)
    return R
