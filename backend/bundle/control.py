"""Control points: surveyed points of the ground that the pictures show.

Each point is a variable of its own in the frame of the pictures, in mean heights. Its views are projections
like those of floor points, but it may have any height. Its survey ties it to the world.

Source: Förstner and Wrobel 2016, section 15.3 (control points in a bundle adjustment).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import G as POINT
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.exposure_motion import NO_SHIFT, ExposureMotion, RowShift, row_shifts
from backend.bundle.factors import (
    FLOOR_Z,
    LOG_SCALE,
    SLOPE,
    WORLD,
    WORLD_SIZE,
    rotation_jacobian,
    rotation_of,
)
from backend.bundle.floor_points import intersect_floor
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.projections import linearise
from backend.measurements import ControlPoint, FloorTracks, Measurements, PinholeModel
from backend.robust import robust
from backend.se3 import cross_matrix

Array = NDArray[np.float64]


class ControlWeights(NamedTuple):
    """How control points are weighted."""

    survey: float
    """Factor on the stated deviations of the survey."""
    marks: float
    """Factor on the stated deviations of the pixels."""
    huber_sigmas: float
    """Pixels off by more count less."""


def start_control(
    values: gtsam.Values, measurements: Measurements, camera: PinholeModel, f_T_c: Array
) -> None:
    """Insert each point where its rays meet the floor; ``f_T_c`` (n, 4, 4) is in mean heights."""
    for number, point in enumerate(measurements.control):
        values.insert(POINT(number), on_floor(point, camera, f_T_c))


def on_floor(point: ControlPoint, camera: PinholeModel, f_T_c: Array) -> Array:
    """Return (3,) the mean of the places where the rays of a point meet the floor z = 0."""
    count = len(point.keyframe)
    views = FloorTracks(point.keyframe, np.zeros(count, dtype=np.int64), point.pixel, np.ones(count))
    return np.asarray(intersect_floor(views, camera, f_T_c)[0])


def add_control(
    pose_side: PoseSideFactors,
    points: Sequence[ControlPoint],
    lens: Array | None,
    weights: ControlWeights,
    exposure_motion: ExposureMotion | None = None,
) -> None:
    """Add the views and the surveys of control points, both with robust losses.

    ``lens`` (q,) is the calibration, or None where it is a variable.
    """
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(weights.huber_sigmas)
    for number, point in enumerate(points):
        mark = gtsam.noiseModel.Isotropic.Sigma(2, point.std_px * weights.marks)
        views = gtsam.noiseModel.Robust.Create(kernel, mark)
        shifts = row_shifts(exposure_motion, point.keyframe, point.pixel)
        for k, pixel, shift in zip(point.keyframe.tolist(), point.pixel, shifts, strict=True):
            pose_side.add("mark", view_factor(POSE(k), POINT(number), pixel, views, lens, shift))
        # An axis with an infinite deviation was not surveyed: it has no weight.
        precisions = gtsam.noiseModel.Diagonal.Precisions((point.std_m * weights.survey) ** -2.0)
        survey = robust(precisions, int(np.isfinite(point.std_m).sum()))
        pose_side.add("survey", survey_factor(POINT(number), point.w_p_m, survey))


def view_factor(
    pose_key: int,
    point_key: int,
    pixel: Array,
    model: gtsam.noiseModel.Base,
    lens: Array | None,
    shift: RowShift = NO_SHIFT,
) -> gtsam.CustomFactor:
    """Return the factor of a point in a picture: projection minus ``pixel`` (2,).

    ``lens`` (q,) as in `add_control`. ``shift``: how the camera had moved on from its pose at the exposure.
    """
    keys = [pose_key, point_key] if lens is not None else [pose_key, point_key, CALIBRATION(0)]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        numbers = values.atVector(CALIBRATION(0)) if lens is None else lens
        pose = values.atPose3(pose_key).matrix()
        point = shift.point_at_once(values.atVector(point_key), pose[:3, 3])
        residual, *found = view(pose, point, numbers, pixel)
        if jacobians is not None:
            for at, J in enumerate(found[: len(keys)]):
                jacobians[at] = J
        return residual

    return gtsam.CustomFactor(model, keys, error)


def view(f_T_c: Array, point: Array, lens: Array, pixel: Array) -> tuple[Array, Array, Array, Array]:
    """Return projection minus pixel (2,), with its Jacobians by pose (2, 6), point (2, 3) and lens (2, q)."""
    J_pose, J_point, J_lens = np.zeros((1, 2, 6)), np.zeros((1, 2, 3)), np.zeros((1, 2, lens.size))
    first, pixels = np.zeros(1, dtype=np.int64), np.ascontiguousarray(pixel[None], dtype=float)
    right = linearise(
        np.ascontiguousarray(f_T_c[None]), point[None], np.ascontiguousarray(lens), first, first, pixels,
        np.ones(1), math.inf, J_pose, J_point, J_lens,
    )  # fmt: skip
    return -right[0], J_pose[0], J_point[0], J_lens[0]


def survey_factor(point_key: int, w_p_m: Array, model: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Return the factor of a surveyed place (3,): s A p + (0, 0, f) minus the survey."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        place, of_point, of_world = in_metres(np.asarray(values.atVector(point_key)), values.atVector(WORLD))
        if jacobians is not None:
            jacobians[0], jacobians[1] = of_point, of_world
        return place - w_p_m

    return gtsam.CustomFactor(model, [point_key, WORLD], error)


def in_metres(f_p: Array, world: Array) -> tuple[Array, Array, Array]:
    """Return the place (3,) of a point in mean heights, with its Jacobians by point (3, 3) and world."""
    scale, A = math.exp(world[LOG_SCALE]), rotation_of(world, SLOPE)
    place = scale * A @ f_p
    of_world = np.zeros((3, WORLD_SIZE))
    of_world[:, LOG_SCALE], of_world[2, FLOOR_Z] = place, 1.0
    of_world[:, SLOPE] = -A @ cross_matrix(scale * f_p) @ rotation_jacobian(world, SLOPE)
    return place + [0.0, 0.0, world[FLOOR_Z]], scale * A, of_world


def survey_residuals(points: Sequence[ControlPoint], values: gtsam.Values) -> Array:
    """Return the points minus their surveys over the stated deviations (n, 3)."""
    world = values.atVector(WORLD)
    places = [in_metres(np.asarray(values.atVector(POINT(k))), world)[0] for k in range(len(points))]
    return np.array([(place - c.w_p_m) / c.std_m for place, c in zip(places, points, strict=True)])


def mark_residuals(
    points: Sequence[ControlPoint],
    values: gtsam.Values,
    f_T_c: Array,
    lens: Array,
    exposure_motion: ExposureMotion | None,
) -> Array:
    """Return projections minus pixels over the stated deviations (m, 2), for camera poses (n, 4, 4)."""
    rows = [
        view(f_T_c[k], shift.point_at_once(values.atVector(POINT(number)), f_T_c[k, :3, 3]), lens, pixel)[0]
        / point.std_px
        for number, point in enumerate(points)
        for k, pixel, shift in zip(
            point.keyframe.tolist(),
            point.pixel,
            row_shifts(exposure_motion, point.keyframe, point.pixel),
            strict=True,
        )
    ]
    return np.array(rows).reshape(-1, 2)
