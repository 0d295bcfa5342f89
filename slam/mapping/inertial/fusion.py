"""Parts of a map that no pictures connect, refined together with the readings of the IMU.

The bridges between the parts are the start. In the refinement the readings take their place: those of the
gap, and those before and after it, which determine velocity and biases at its ends. The bridges of the result
are relative poses of the refined map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.information import Information
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import Inertial, RelativePose
from backend.quantiles import chi_square_limit
from slam.core.flight import Flight
from slam.mapping.inertial.bridges import bridge_warning, doubted_bridge_warning
from slam.mapping.inertial.measurements import inertial_measurements, tracked_frames
from slam.mapping.map import Map
from slam.mapping.refine import calibrated, convergence_warnings, floor_tracks
from slam.mapping.refine_part import part_measurements
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

_FALSE_ALARM = 1e-3
"""Probability that a good IMU is left out."""


def fuse_parts(parts: Map, joined: Map, setup: Setup, flight: Flight) -> Map:
    """Return the ``joined`` map of ``parts``, with its joined parts refined together.

    Where the readings contradict the pictures, the parts stay as they are joined, with unknown covariances
    behind the bridges, and the reason is a warning. A flight with a measured velocity stays as it is: its
    bridges rest on the velocity too, which the refinement does not know.
    """
    inertial = inertial_measurements(flight.imu, setup.config)
    if inertial is None or flight.velocity is not None or not joined.bridges:
        return joined
    setup = setup.without_positions()
    for number in range(int(joined.component.max()) + 1):
        members = np.flatnonzero(joined.component == number)
        if len(np.unique(parts.component[members])) > 1:
            joined = _fused(parts, joined, members, setup, inertial)
    return joined


def _fused(parts: Map, joined: Map, members: NDArray[np.int64], setup: Setup, inertial: Inertial) -> Map:
    """Return the map with the keyframes ``members`` (m,) of several parts refined together."""
    if parts.inertial is not None and parts.inertial.contradiction:
        return _doubted(parts, joined, members, "lengths by imu0 contradict those of the map")
    noise = joined.bundle.noise if joined.bundle is not None else None
    start, config = joined.w_T_b[members], setup.config.bundle
    try:
        measured = replace(
            part_measurements(setup, members, floor_tracks(joined, setup)),
            inertial=inertial,
            frames=tracked_frames(joined.observations, members, setup.camera),
        )
        bundle = refine(measured, start, joined.floor_z_m, config, noise=noise)
        damage = _damage(parts, members, bundle)
        if damage:
            return _doubted(parts, joined, members, f"imu0 does not fit the pictures ({damage})")
        return _with_bundle(joined, members, bundle, setup)
    except BackendError as error:
        return _doubted(parts, joined, members, f"the refinement with imu0 failed ({error})")


def _doubted(parts: Map, joined: Map, members: NDArray[np.int64], reason: str) -> Map:
    """Return the map with unknown covariances behind the bridges, which rest on the same readings."""
    behind = members[parts.component[members] != parts.component[members[0]]]
    covariances, over_floor_covariances = joined.covariances.copy(), joined.over_floor_covariances.copy()
    covariances[behind] = over_floor_covariances[behind] = np.nan
    mine = [edge for edge in joined.bridges if edge.i in members]
    return replace(
        joined,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        warnings=_replaced(joined.warnings, mine, [doubted_bridge_warning(edge, reason) for edge in mine]),
    )


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
    moved = []
    for part in np.unique(parts.component[members]).tolist():
        own = parts.component[members] == part
        before, after = parts.w_T_b[members[own]], bundle.w_T_b[own]
        off = se3.log(se3.inverse(_from_first(before, after) @ before) @ after)
        P = parts.covariances[members[own]]
        # A part that could not be refined alone has unknown covariances, and tests nothing.
        moved += [
            float(x @ np.linalg.solve(C, x))
            for x, C in zip(off[1:], P[1:], strict=True)
            if np.isfinite(C).all()
        ]
    if moved and max(moved) > chi_square_limit(_FALSE_ALARM / len(moved), 6):
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
    mine = [edge for edge in joined.bridges if edge.i in members]
    information = Information.of(bundle.optimum)
    refined = [_refined_bridge(bundle, members, edge, information) for edge in mine]
    main = bool(joined.component[members[0]] == 0)
    return replace(
        joined,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        camera=calibrated(setup.camera, bundle) if main else joined.camera,
        bundle=bundle if main else joined.bundle,
        bridges=(*(edge for edge in joined.bridges if edge.i not in members), *refined),
        warnings=(
            *_replaced(joined.warnings, mine, [bridge_warning(edge) for edge in refined]),
            *convergence_warnings(bundle),
        ),
    )


def _replaced(
    warnings: tuple[str, ...], edges: Sequence[RelativePose], lines: Sequence[str]
) -> tuple[str, ...]:
    """Return the warnings with other lines about the bridges ``edges``."""
    old = {bridge_warning(edge) for edge in edges}
    return (*(line for line in warnings if line not in old), *lines)


def _refined_bridge(
    bundle: Bundle, members: NDArray[np.int64], edge: RelativePose, information: Information
) -> RelativePose:
    """Return the relative pose of an edge's keyframes in the refined map."""
    i, j = np.searchsorted(members, [edge.i, edge.j]).tolist()
    i_T_j = se3.inverse(bundle.w_T_b[i][None])[0] @ bundle.w_T_b[j]
    gradient = np.zeros((6, len(members), 6))
    gradient[:, j] = np.eye(6)
    gradient[:, i] = -se3.adjoint(se3.inverse(i_T_j[None]))[0]
    return replace(edge, i_T_j=i_T_j, covariance=information.covariance(gradient))
