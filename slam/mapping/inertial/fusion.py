"""Parts of a map that no pictures connect, refined together with the readings of the instruments.

The bridges between the parts are the start. In the refinement the readings of the IMU take their place, and
the motion that the vehicle reports: those of the gap, and those before and after it, which determine velocity
and errors of the instruments at its ends. The bridges of the result are relative poses of the refined map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.information import Information
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import Inertial, RelativePose, ReportedMotion
from backend.quantiles import chi_square_limit
from backend.significance import FALSE_ALARM
from slam.core.messages import parsed, warning
from slam.mapping.calibration.lens import calibrated
from slam.mapping.control_points import ControlComparison
from slam.mapping.inertial.bridge import Bridge
from slam.mapping.inertial.measurements import tracked_frames
from slam.mapping.map import Map, largest_first
from slam.mapping.part_measurements import aligned_pairs, by_lines, part_measurements
from slam.mapping.refine import floor_tracks
from slam.mapping.setup import Setup
from slam.mapping.warnings.convergence import convergence_warnings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Motion:
    """Instruments that tell the motion across a gap, and their names in messages."""

    inertial: Inertial | None
    reported: ReportedMotion | None

    @property
    def name(self) -> str:
        """Folders of the instruments."""
        folders = {"imu0": self.inertial, "velocity0": self.reported}
        return " and ".join(folder for folder, used in folders.items() if used is not None)

    def choices(self) -> list[_Motion]:
        """Return the instruments together, and then each of them alone."""
        alone = [_Motion(self.inertial, None), _Motion(None, self.reported)]
        return [self, *alone] if self.inertial and self.reported else [self]


def fuse_parts(
    parts: Map, joined: Map, setup: Setup, inertial: Inertial | None, reported: ReportedMotion | None
) -> Map:
    """Return the ``joined`` map of ``parts``, with its joined parts refined together.

    ``inertial`` readings of the IMU connect them, and the motion that the vehicle ``reported``. Instruments
    that contradict the pictures are left out, with a warning. If none is left, parts that an IMU joined stay
    as they are, with unknown covariances behind the bridges; without an IMU they are taken apart.
    """
    # A velocity that a part could not use must not act on the whole either.
    motion = _Motion(inertial, None if parts.velocity_left_out else reported)
    aligned = aligned_pairs(joined, setup.camera)
    if not motion.name or not (joined.bridges or aligned):
        return joined
    open_ = by_lines(aligned, len(joined.component))
    # A barometer that the parts could not use must not act on the whole either.
    leaves_barometer = joined.bundle is None or not joined.bundle.uses_barometer
    for number in range(int(joined.component.max()) + 1):
        members = np.flatnonzero(joined.component == number)
        of_parts = np.unique(parts.component[members]).tolist()
        if len(of_parts) > 1 or open_[members].any():
            # Positions that have placed a part hold it. Parts that bridges join stand in no world of theirs.
            own = parts.setups[of_parts[0]] if len(of_parts) == 1 else setup.without_positions()
            own = own.without_heights() if leaves_barometer else own
            joined = _fused(parts, joined, members, own, motion)
    return replace(joined, component=largest_first(joined.component))


def _fused(parts: Map, joined: Map, members: NDArray[np.int64], setup: Setup, motion: _Motion) -> Map:
    """Return the map with the keyframes ``members`` (m,) of several parts refined together."""
    reasons: list[str] = []
    for choice in motion.choices():
        try:
            reason = _contradicted(parts, choice)
            if not reason:
                bundle = _refined(joined, members, setup, choice)
                damage = _damage(parts, members, bundle)
                reason = f"{choice.name} does not fit the pictures ({damage})" if damage else ""
            if not reason:
                return _with_bundle(joined, members, bundle, setup, reasons)
        except BackendError as error:
            reason = f"the refinement with {choice.name} failed ({error})"
        reasons.append(reason)
    if motion.inertial is None:
        return _apart(parts, joined, members, reasons[0])
    return _doubted(parts, joined, members, reasons[0])


def _contradicted(parts: Map, motion: _Motion) -> str:
    if motion.inertial is None or parts.inertial is None or not parts.inertial.contradiction:
        return ""
    return "lengths by imu0 contradict those of the map"


def _refined(joined: Map, members: NDArray[np.int64], setup: Setup, motion: _Motion) -> Bundle:
    """Refine the keyframes ``members`` (m,) together. Raises ``BackendError``."""
    noise = joined.bundle.noise if joined.bundle is not None else None
    measured = replace(
        part_measurements(
            setup,
            members,
            floor_tracks(joined, setup),
            aligned_pairs(joined, setup.camera),
        ),
        inertial=motion.inertial,
        reported=motion.reported,
        frames=tracked_frames(joined.observations, members, setup.camera),
    )
    return refine(measured, joined.w_T_b[members], joined.floor_z_m, setup.config.bundle, noise=noise)


def _apart(parts: Map, joined: Map, members: NDArray[np.int64], reason: str) -> Map:
    """Return the map with the parts of some keyframes as they were before they were joined."""
    w_T_b, component = joined.w_T_b.copy(), joined.component.copy()
    covariances, over_floor_covariances = joined.covariances.copy(), joined.over_floor_covariances.copy()
    w_T_b[members], covariances[members] = parts.w_T_b[members], parts.covariances[members]
    over_floor_covariances[members] = parts.over_floor_covariances[members]
    component[members] = component.max() + 1 + parts.component[members]
    return replace(
        joined,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        component=component,
        bridges=_bridges(joined, members)[1],
        warnings=(
            *joined.warnings,
            warning(f"a gap in the pictures is not bridged: {reason}", "measure on one side of it only"),
        ),
    )


def _doubted(parts: Map, joined: Map, members: NDArray[np.int64], reason: str) -> Map:
    """Return the map with unknown covariances behind the bridges, which rest on the same readings."""
    behind = members[parts.component[members] != parts.component[members[0]]]
    covariances, over_floor_covariances = joined.covariances.copy(), joined.over_floor_covariances.copy()
    covariances[behind] = over_floor_covariances[behind] = np.nan
    mine, others = _bridges(joined, members)
    return replace(
        joined,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        bridges=(*others, *(replace(bridge, doubt=reason) for bridge in mine)),
    )


def _damage(parts: Map, members: NDArray[np.int64], bundle: Bundle) -> str:
    """Describe why the readings cannot be right, in words; empty if they can be.

    Within each part the pictures alone determine the poses. If the readings are right, they move these by
    less than the poses' errors. Source: Hausman 1978 (Econometrica 46), with the covariance of the poses in
    place of the smaller one of the difference.
    """
    optimum = bundle.optimum
    inertial, reported = optimum.problem.inertial, optimum.problem.reported
    measured = optimum.problem.measurements
    for read, used in ((measured.inertial, inertial), (measured.reported, reported)):
        if read is not None and used is None:
            return "none of its readings fits"
    moved = []
    open_ = by_lines(measured.aligned, len(members))
    for part in np.unique(parts.component[members]).tolist():
        own = parts.component[members] == part
        if open_[own].any():  # The pictures alone do not determine it along the lines, and test nothing.
            continue
        before, after = parts.w_T_b[members[own]], bundle.w_T_b[own]
        off = se3.log(se3.inverse(_from_first(before, after) @ before) @ after)
        P = parts.covariances[members[own]]
        # A part that could not be refined alone has unknown covariances, and tests nothing.
        moved += [
            float(x @ np.linalg.solve(C, x))
            for x, C in zip(off[1:], P[1:], strict=True)
            if np.isfinite(C).all()
        ]
    if moved and max(moved) > chi_square_limit(FALSE_ALARM / len(moved), 6):
        return "it would bend the map by more than the errors of the pictures"
    damage = inertial.damage(optimum.values, bundle.noise.inertial) if inertial is not None else ""
    return damage or bundle.reported_damage


def _from_first(before: Array, after: Array) -> Array:
    """Return the transform (1, 4, 4) that puts the first of some poses (m, 4, 4) above, and heads it as, the
    first of others. Position and heading of the first keyframe define the world of a part."""
    found = se3.from_planar(se3.to_planar(after[:1] @ se3.inverse(before[:1])))
    found[:, :3, 3] += (after[:1] - found @ before[:1])[:, :3, 3]
    return found


def _with_bundle(
    joined: Map, members: NDArray[np.int64], bundle: Bundle, setup: Setup, left_out: Sequence[str]
) -> Map:
    """Return the map with the refined keyframes, and bridges that follow from them.

    ``left_out``: reasons why other choices of instruments were not used.
    """
    w_T_b, covariances = joined.w_T_b.copy(), joined.covariances.copy()
    over_floor_covariances = joined.over_floor_covariances.copy()
    w_T_b[members], covariances[members] = bundle.w_T_b, bundle.covariances
    over_floor_covariances[members] = bundle.over_floor_covariances
    mine, others = _bridges(joined, members)
    information = Information.of(bundle.optimum)
    refined = (Bridge(_refined_edge(bundle, members, bridge.edge, information)) for bridge in mine)
    main = bool(joined.component[members[0]] == 0)
    if main:
        joined = _with_control(joined, members, bundle, setup)
    is_scaled = main and bundle.scale_std is not None
    return replace(
        joined,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        floor_z_m=bundle.floor_z_m if main else joined.floor_z_m,
        camera=calibrated(setup.camera, bundle) if main else joined.camera,
        bundle=bundle if main else joined.bundle,
        metric=joined.metric or is_scaled,
        no_scale=() if is_scaled else joined.no_scale,
        bridges=(*others, *refined),
        warnings=(
            *joined.warnings,
            *convergence_warnings(bundle, setup.readings),
            *map(parsed, left_out[-1:]),
        ),
    )


def _with_control(joined: Map, members: NDArray[np.int64], bundle: Bundle, setup: Setup) -> Map:
    """Return the map with the residuals of the surveyed points on the refined keyframes."""
    before = joined.control
    if before is None:
        return joined
    used = np.array([point.used for point in before.points], dtype=bool)
    comparison = replace(ControlComparison.of(setup.surveyed, members), misread=before.misread)
    verdict = comparison.judge(bundle, used)
    return replace(joined, control=verdict.report(bundle, used, setup.readings.fixes))


def _bridges(joined: Map, members: NDArray[np.int64]) -> tuple[tuple[Bridge, ...], tuple[Bridge, ...]]:
    """Return the bridges between the keyframes ``members`` (m,), and the others."""
    mine = tuple(bridge for bridge in joined.bridges if bridge.edge.i in members)
    return mine, tuple(bridge for bridge in joined.bridges if bridge.edge.i not in members)


def _refined_edge(
    bundle: Bundle, members: NDArray[np.int64], edge: RelativePose, information: Information
) -> RelativePose:
    """Return the relative pose of an edge's keyframes in the refined map."""
    i, j = np.searchsorted(members, [edge.i, edge.j]).tolist()
    i_T_j = se3.inverse(bundle.w_T_b[i][None])[0] @ bundle.w_T_b[j]
    gradient = np.zeros((6, len(members), 6))
    gradient[:, j] = np.eye(6)
    gradient[:, i] = -se3.adjoint(se3.inverse(i_T_j[None]))[0]
    return replace(edge, i_T_j=i_T_j, covariance=information.covariance(gradient))
