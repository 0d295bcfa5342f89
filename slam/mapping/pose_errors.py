"""Errors of all poses together: those that the refinement knows, and those of instruments that it holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackError

from backend.bundle.accuracy.joint_errors import joint_errors
from backend.sparse_cholesky import SingularMatrixError
from slam.core.flight import Flight
from slam.mapping.calibration.attitude_floor_tilt import AttitudeFloorTilt, tilt_over_map
from slam.mapping.calibration.clock_offset import NO_CORRECTION, clock_displacements
from slam.mapping.calibration.fixed_mount import (
    fixed_mount_covariance,
    level_floor_covariance,
    level_floor_displacements,
    mount_displacements,
)
from slam.mapping.context import Context
from slam.mapping.map import Map

Array = NDArray[np.float64]

REFINED = 12
"""Errors that are kept of the refinement's. On figure eights the twelfth has less than a twentieth of the
largest's variance."""


def instrument_displacements(context: Context, map_: Map) -> Array:
    """Return (n, 6, e) right perturbations of the poses by one standard deviation of each error that the
    refinement does not estimate: the delays of a corrected clock, the tilt of a fixed mount, and the slope of
    a floor that counts as level."""
    stamps_s, n = map_.observations.stamps_s, len(map_.w_T_b)
    found = [np.zeros((n, 6, 0))]
    if context.clock is not NO_CORRECTION:
        camera_stamps_s = map_.observations.camera_stamps_s[map_.observations.frame_index]
        found.append(clock_displacements(context.clock, map_.w_T_b, stamps_s, camera_stamps_s))
    if context.flight.parts:  # each has a level of its own
        return np.concatenate(found, axis=2)
    mount, slope = _mount_and_slope(tilt_over_map(context.flight, map_), map_)
    if mount.any():
        of_mount = mount_displacements(map_.camera.b_T_c, mount)
        found.append(np.broadcast_to(of_mount, (n, *of_mount.shape)))
    if slope.any():
        found.append(level_floor_displacements(map_.w_T_b, map_.component, slope))
    return np.concatenate(found, axis=2)


def _mount_and_slope(tilt: AttitudeFloorTilt | None, map_: Map) -> tuple[Array, Array]:
    """Return the covariances (2, 2) of a mount and of a level floor; zero where the refinement estimates
    them."""
    is_held = map_.bundle is None or map_.bundle.mount_std_rad == 0
    none, stated_exact = np.zeros((2, 2)), map_.camera.mount_std_rad == 0.0

    def shared_by(causes: int) -> tuple[Array, Array]:
        mount = fixed_mount_covariance(tilt, map_.inertial, stated_exact, causes) if is_held else none
        slope = none if map_.georeferenced else level_floor_covariance(tilt, map_.inertial, causes)
        return mount, slope

    mount, slope = shared_by(2)
    # A lean may be all of a slope, or all of a mount that is stated as exact: either statement is wrong then.
    return shared_by(3) if mount.any() and slope.any() and not stated_exact else (mount, slope)


def datum_displacements(flight: Flight, map_: Map) -> Array:
    """Return (n, 6, e) right perturbations of the poses by the error of the datum of the control points that
    the map follows, east and north; e is 0 where it has none."""
    std_m = max((point.datum_std_m for point in flight.surveyed if point.role == "control"), default=0.0)
    if map_.control is None or not map_.control.is_followed or std_m == 0:
        return np.zeros((len(map_.w_T_b), 6, 0))
    found = np.zeros((len(map_.w_T_b), 6, 2))
    found[:, 3:] = std_m * np.swapaxes(map_.w_T_b[:, :2, :3], 1, 2)
    return found


def with_displacements(covariances: Array, errors: Array) -> Array:
    """Return covariances (n, 6, 6) with those of ``errors`` (n, 6, e)."""
    return np.asarray(covariances + errors @ errors.transpose(0, 2, 1))


def of_all_poses(map_: Map, errors: Array) -> Array | None:
    """Return the largest errors (n, 6, s) of all poses together, those of the refinement first, then
    ``errors`` (n, 6, e).

    None without a refinement, where a direction is open, and where instruments have joined other parts to the
    refined one.
    """
    main = np.flatnonzero(map_.component == 0)
    if map_.bundle is None or len(main) != len(map_.bundle.w_T_b):
        return None
    try:
        of_main = joint_errors(map_.bundle.optimum, map_.bundle.covariances, REFINED)
    except (SingularMatrixError, ArpackError):
        return None
    refined = np.zeros((len(map_.component), *of_main.shape[1:]))
    refined[main] = of_main
    return np.concatenate([refined, errors], axis=2)
