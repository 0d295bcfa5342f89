"""A slope of the ground that the attitude alone tells: positions are too coarse or too close together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import SLOPE, WORLD
from backend.bundle.refinement import Bundle
from backend.sparse_cholesky import SingularMatrixError
from slam.core.messages import Message, warning
from slam.mapping.calibration.attitude_floor_tilt import NOTABLE_RAD, SURE, ZERO_STDS
from slam.mapping.map import Map

Array = NDArray[np.float64]


def slope_by_attitude_warning(map_: Map) -> Message | None:
    """Return a warning where the ground slopes notably by the attitude, and positions do not show it.

    A wrong zero of the attitude, or a wrong mount of the camera, then looks like a slope. The refinement
    knows the noise of the attitude, but not its zero. The result is None elsewhere.
    """
    bundle = map_.bundle
    attitudes = () if bundle is None else bundle.optimum.problem.measurements.attitudes
    if not map_.georeferenced or bundle is None or not attitudes:
        return None
    turn = np.array(bundle.floor_slope_rad)
    size = float(np.linalg.norm(turn))
    stated = float(np.median([a.std_rad[:2].max() for a in attitudes]))
    if size < max(NOTABLE_RAD, ZERO_STDS * stated):
        return None
    try:
        std = float(bundle.optimum.standard_deviations(WORLD)[SLOPE].max())
    except SingularMatrixError:
        return None
    by_positions = _std_by_positions(bundle, np.array([-turn[1], turn[0]]) / size)
    if size < SURE * std or size > SURE * by_positions:
        return None
    return warning(
        f"the ground of the map slopes by {np.degrees(size):.1f}° because attitude0 differs so from "
        f"the floor in the pictures",
        f"positions alone determine it to ± {np.degrees(by_positions):.1g}° only, so it may also be the "
        "camera's mounting (T_BS) or the zero of the attitude: heights across the map may be wrong by as "
        "much",
        "check the mounting with the vehicle level, or fly over more ground",
    )


def _std_by_positions(bundle: Bundle, across: Array) -> float:
    """Return the standard deviation in rad of a slope along the unit vector (2,) by heights alone: those of
    positions, and those of control points."""
    measured, noise = bundle.optimum.problem.measurements, bundle.noise
    positions = [p.w_p_antenna_m for p in measured.positions if np.isfinite(p.std_m[2])]
    control = [p for p in measured.control if np.isfinite(p.std_m[2])]
    survey_m = noise.control * float(np.median([p.std_m[2] for p in control])) if control else np.inf
    # Both may lie at different heights, so that each tells the slope about its own middle.
    information = sum(
        (_spread_m(places, across) / std_m) ** 2
        for places, std_m in ((positions, noise.position_m[2]), ([p.w_p_m for p in control], survey_m))
    )
    return float(information**-0.5) if information > 0 else np.inf


def _spread_m(places: Sequence[Array], across: Array) -> float:
    """Return the root of the sum of squared distances along the unit vector (2,) from the middle."""
    along = np.array(places).reshape(-1, 3)[:, :2] @ across
    return float(np.linalg.norm(along - along.mean())) if len(along) > 1 else 0.0
