"""Parts of a map that no pictures connect, refined together with the readings of the IMU.

The bridges between the parts are the start. In the refinement the readings take their place: those of the
gap, and those before and after it, which determine velocity and biases at its ends. The bridges of the result
are relative poses of the refined map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.information import Information
from backend.bundle.minimise import BundleOptimum
from backend.bundle.refinement import Bundle, metric_jacobians, refine
from backend.errors import BackendError
from backend.measurements import Inertial, RelativePose
from backend.quantiles import chi_square_limit
from slam.core.flight import Flight
from slam.mapping.inertial.bridges import bridge_warning
from slam.mapping.inertial.measurements import inertial_measurements, tracked_frames
from slam.mapping.map import Map
from slam.mapping.refine import calibrated, floor_tracks
from slam.mapping.refine_part import part_measurements
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_FALSE_ALARM = 1e-3
"""Probability that a good IMU is left out."""


def fuse_parts(parts: Map, joined: Map, setup: Setup, flight: Flight) -> Map:
    """Return the ``joined`` map of ``parts``, with its joined parts refined together.

    Parts that the readings contradict stay as they are joined, and the reason is a warning. So do all parts
    of a flight with a measured velocity: the bridges rest on it too, and the refinement does not know it.
    """
    inertial = inertial_measurements(flight.imu, setup.config)
    if inertial is None or flight.velocity is not None or not joined.bridges:
        return joined
    for number in range(int(joined.component.max()) + 1):
        members = np.flatnonzero(joined.component == number)
        if len(np.unique(parts.component[members])) > 1:
            joined = _fused(parts, joined, members, setup.without_positions(), inertial)
    return joined


def _fused(parts: Map, joined: Map, members: NDArray[np.int64], setup: Setup, inertial: Inertial) -> Map:
    """Return the map with the keyframes ``members`` (m,) of several parts refined together."""
    try:
        measured = replace(
            part_measurements(setup, members, floor_tracks(joined, setup)),
            inertial=inertial,
            frames=tracked_frames(joined.observations, members, setup.camera),
        )
        noise = joined.bundle.noise if joined.bundle is not None else None
        start, config = joined.w_T_b[members], setup.config.bundle
        bundle = refine(measured, start, joined.floor_z_m, config, noise=noise)
        damage = _damage(parts, members, bundle)
    except BackendError as error:
        damage = str(error)
    if damage:
        line = (
            f"imu0 does not fit the pictures ({damage}); parts of the map that it connects may be misplaced "
            "by more than is stated: check imu0"
        )
        return replace(joined, warnings=(*joined.warnings, line))
    return _with_bundle(joined, members, bundle, setup)


def _damage(parts: Map, members: NDArray[np.int64], bundle: Bundle) -> str:
    """Describe why the readings cannot be right, in words; empty if they can be.

    Within each part the pictures alone determine the poses. If the readings are right, they move these by
    less than the poses' errors. Source: Hausman 1978 (Econometrica 46), with the covariance of the poses in
    place of the smaller one of the difference.
    """
    optimum = bundle.optimum
    inertial = optimum.problem.inertial
    if inertial is None:
        return "none of its readings fits"
    if parts.inertial is not None and parts.inertial.contradiction:
        return "its lengths contradict those of the map"
    moved = []
    for part in np.unique(parts.component[members]).tolist():
        own = parts.component[members] == part
        before, after = parts.w_T_b[members[own]], bundle.w_T_b[own]
        off = se3.log(se3.inverse(_from_first(before, after) @ before) @ after)
        P = parts.covariances[members[own]]
        moved += [float(x @ np.linalg.solve(C, x)) for x, C in zip(off[1:], P[1:], strict=True)]
    if max(moved) > chi_square_limit(_FALSE_ALARM / len(moved), 6):
        return "it would bend the map by more than the errors of the pictures"
    return inertial.damage(optimum.values, bundle.noise.inertial)


def _from_first(before: Array, after: Array) -> Array:
    """Return the transform (1, 4, 4) that puts the first of some poses (m, 4, 4) above, and heads it as, the
    first of others. Position and heading of the first keyframe define the world of a part."""
    found = se3.from_planar(se3.to_planar(after[:1] @ se3.inverse(before[:1])))
    found[:, :3, 3] += (after[:1] - found @ before[:1])[:, :3, 3]
    return found


def _with_bundle(joined: Map, members: NDArray[np.int64], bundle: Bundle, setup: Setup) -> Map:
    """Return the map with the refined keyframes, and bridges that follow from them."""
    w_T_b, covariances = joined.w_T_b.copy(), joined.covariances.copy()
    over_floor_covariances = joined.over_floor_covariances.copy()
    w_T_b[members], covariances[members] = bundle.w_T_b, bundle.covariances
    over_floor_covariances[members] = bundle.over_floor_covariances
    bridges = tuple(_bridge(bundle, members, edge) for edge in joined.bridges)
    old = {bridge_warning(edge) for edge in joined.bridges}
    main = bool(joined.component[members[0]] == 0)
    return replace(
        joined,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        camera=calibrated(setup.camera, bundle) if main else joined.camera,
        bundle=bundle if main else joined.bundle,
        bridges=bridges,
        warnings=(
            *(line for line in joined.warnings if line not in old),
            *(bridge_warning(edge) for edge in bridges),
        ),
    )


def _bridge(bundle: Bundle, members: NDArray[np.int64], edge: RelativePose) -> RelativePose:
    """Return the relative pose of an edge's keyframes in the refined map; others have another part."""
    at = [int(np.searchsorted(members, k)) for k in (edge.i, edge.j)]
    if not np.isin([edge.i, edge.j], members).all():
        return edge
    i, j = at
    i_T_j = se3.inverse(bundle.w_T_b[i][None])[0] @ bundle.w_T_b[j]
    gradient = np.zeros((6, len(members), 6))
    gradient[:, j] = np.eye(6)
    gradient[:, i] = -se3.adjoint(se3.inverse(i_T_j[None]))[0]
    return replace(edge, i_T_j=i_T_j, covariance=_information(bundle.optimum).covariance(gradient))


def _information(optimum: BundleOptimum) -> Information:
    to_metres = metric_jacobians(optimum.problem, optimum.values, np.zeros(3))
    return Information(optimum.linearise().eliminate(), to_metres)
