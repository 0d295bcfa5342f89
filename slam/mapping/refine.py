"""Refinement of a map: each connected part is placed in the world and refined on its floor points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.contradicted import contradicted_keyframes
from backend.bundle.position_steps import position_step
from backend.bundle.refinement import Bundle
from backend.errors import BackendError
from backend.inertial_scale.scale import NoScale
from backend.measurements import FloorTracks, InertialReadings, ReportedMotion
from frontend.registration import Registration
from frontend.tracks import join_tracks
from slam.core.floor_points import FloorPoints
from slam.core.heap import trim_heap
from slam.core.imu_at_rest import GravityReading
from slam.core.messages import Message, warning
from slam.core.progress import Progress
from slam.mapping.calibration.inertial_scale import AccelerometerScale
from slam.mapping.calibration.lens import calibrated
from slam.mapping.control_pixels import misread
from slam.mapping.control_points import ControlComparison
from slam.mapping.floor_points import refined_floor_points
from slam.mapping.gps.comparison import FixComparison
from slam.mapping.gps.consensus import Agreement
from slam.mapping.gps.verdicts import FixVerdicts
from slam.mapping.map import Map, largest_first
from slam.mapping.map_part import MapPart
from slam.mapping.metric_refinement import MetricRefinement, no_scale_line
from slam.mapping.part_measurements import LEAST_SEEN, aligned_pairs, by_lines
from slam.mapping.place_part import aligned_part, aligned_with_control, headed
from slam.mapping.setup import Setup
from slam.mapping.warnings.convergence import convergence_warnings

Array = NDArray[np.float64]

_MOST_SELECTIONS = 4
"""Largest number of refinements of one part with other GPS fixes. One suffices in most flights."""
_NOT_SETTLED = warning(
    f"which GPS fixes and control points agree with the map still changed after {_MOST_SELECTIONS} "
    "refinements: those near the limit are uncertain",
    "compare their places in the report with the ground",
)


def _not_placed(count: int, fixes: FixComparison | None) -> Message:
    """Return the warning about a part of ``count`` keyframes that no position places."""
    why = " (all fixes repeat one place to the last digit)" if fixes and fixes.at_one_place else ""
    return warning(
        f"{count} keyframes have no usable GPS position{why}: they are in coordinates of their own, "
        "not on Earth",
        "measure within them only, or add control points",
    )


def refine_map(
    solved: Map,
    setup: Setup,
    progress: Progress,
    inertial: InertialReadings | None = None,
    reported: ReportedMotion | None = None,
    gravity: GravityReading | None = None,
) -> Map:
    """Place each connected part of a solved graph and refine it on its floor points.

    With ``inertial`` readings the accelerometer takes part in the scale, and with ``reported`` motion the
    velocity, if nothing else measures lengths. Measurements are those of ``setup``. ``gravity``: the
    accelerometer's reading of it, where that is off.
    """
    observations, edges, solution = solved.observations, solved.edges, solved.graph
    n = len(setup.readings.stamps_s)
    tracks = floor_tracks(solved, setup)
    component = largest_first(np.where(_tied(n, solved.kept_registrations), solution.component, -1))
    aligned = aligned_pairs(solved, setup.camera)
    refinement = MetricRefinement(observations, tracks, inertial, reported, progress, aligned, gravity)
    evidence = _Evidence(setup, edges.heights.metric, refinement)
    is_tied = np.bincount(tracks.keyframe, minlength=n) >= LEAST_SEEN
    is_tied |= by_lines(aligned, n)
    parts = []
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        if is_tied[members].sum() >= 2:
            # A picture that shares almost no point with the others must not prevent their refinement.
            component[members[~is_tied[members]]] = -1
            members = np.flatnonzero(component == number)
        parts.append(evidence.part(members, solution.w_T_b[members]))
    w_T_b, covariances, over_floor_covariances = _poses(parts, n)
    main = parts[0] if parts else None
    return replace(
        solved,
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=over_floor_covariances,
        component=component,
        floor_z_m=main.floor_z_m if main else 0.0,
        camera=calibrated(setup.camera, main.bundle if main else None),
        bundle=main.bundle if main else None,
        georeferenced=main.georeferenced if main else False,
        setups=tuple(part.setup for part in parts),
        warnings=tuple(line for part in parts for line in part.warnings),
        remarks=tuple(line for part in parts for line in part.remarks),
        no_scale=tuple(line for part in parts for line in part.no_scale),
        velocity_left_out=any(part.velocity_left_out for part in parts),
        fixes_left_out=tuple(name for part in parts for name in part.fixes_left_out),
        stated_accuracy=tuple(found for part in parts for found in part.stated_accuracy),
        control=main.control if main else None,
        height_std_m=tuple(part.height_std_m for part in parts),
        inertial=main.inertial if main else None,
        clock=main.clock if main else None,
        metric=main.metric if main else True,
        floor_points=FloorPoints.joined(
            [refined_floor_points(p.bundle, p.members) for p in parts if p.bundle]
        ),
    )


def _poses(parts: Sequence[MapPart], n: int) -> tuple[Array, Array, Array]:
    """Return the poses (n, 4, 4) of all parts, and covariances (n, 6, 6) in the world and over the floor.

    They are NaN for keyframes of no part, and the covariances also for a part that was not refined.
    """
    w_T_b, (covariances, over_floor_covariances) = np.full((n, 4, 4), np.nan), np.full((2, n, 6, 6), np.nan)
    for part in parts:
        w_T_b[part.members] = part.w_T_b
        if part.bundle is not None:
            covariances[part.members] = part.bundle.covariances
            over_floor_covariances[part.members] = part.bundle.over_floor_covariances
    return w_T_b, covariances, over_floor_covariances


def floor_tracks(solved: Map, setup: Setup) -> FloorTracks:
    """Return the floor points that the registrations of a solved graph follow through the keyframes."""
    points = solved.observations.store.points
    tracks = join_tracks(points, solved.kept_registrations, setup.camera, setup.config.tracks)
    trim_heap()
    return tracks


@dataclass(frozen=True)
class _Used:
    """Measurements that place a part."""

    agreement: Agreement | None
    """The fixes that agree; None without any to compare."""
    points: NDArray[np.bool_]
    """(p,) control points."""


@dataclass(frozen=True)
class _Evidence:
    """Inputs of placement and refinement that all parts share."""

    setup: Setup
    metric: NDArray[np.bool_]
    """(n,) which keyframes have a height in metres."""
    refinement: MetricRefinement

    def part(self, members: NDArray[np.int64], w_T_b: Array, misread_points: str = "") -> MapPart:
        """Keyframes ``members`` (m,), placed and refined from the pose graph's ``w_T_b`` (m, 4, 4).

        ``misread_points``: why the pixels of the control points cannot be followed.
        """
        ranged = bool(self.metric[members].all())
        readings = self.setup.readings
        fixes = FixComparison(readings.fixes, readings.stamps_s[members]) if readings.fixes else None
        fixes = fixes.without_repeats(w_T_b, ranged) if fixes else None
        agreement = fixes.rough(w_T_b, ranged) if fixes else None
        control = replace(ControlComparison.of(self.setup.surveyed, members), misread=misread_points)
        base = self.setup
        aligned = aligned_part(base.with_fixes(agreement), members, w_T_b, ranged, control)
        if aligned is None:
            # Positions that could not place the part must not act on its shape either.
            base, agreement = base.without_positions(), None
            aligned = aligned_with_control(base.camera, w_T_b, ranged, control)
        start, floor_z_m = aligned or (headed(w_T_b, self.setup.readings, members), 0.0)
        placed = MapPart(
            members=members,
            w_T_b=start,
            floor_z_m=floor_z_m,
            georeferenced=aligned is not None,
            ranged=ranged,
            setup=base.with_fixes(agreement),
        )
        if aligned is None and readings.positions:
            placed = replace(placed, warnings=(_not_placed(len(members), fixes),))
        try:
            followed = control.rough(base.camera, w_T_b, ranged) & placed.georeferenced
            used = _Used(agreement, followed)
            placed, agreement = self._refined_with_agreeing(base, placed, fixes, control, used)
        except BackendError as error:
            line = warning(
                f"the part of the map with {len(members)} keyframes could not be refined: {error}",
                "its standard deviations are unknown: do not measure there",
            )
            return replace(placed, warnings=(*placed.warnings, line))
        if not misread_points and (wrong := _misread(placed, control, w_T_b)):
            return self.part(members, w_T_b, wrong)
        if agreement is None or fixes is None:
            return placed
        fixes = placed.refined_fixes(fixes)
        messages = fixes.messages(agreement, position_step(placed.bundle.optimum) if placed.bundle else None)
        return replace(
            placed,
            warnings=(*placed.warnings, *messages.warnings),
            remarks=(*placed.remarks, *messages.remarks),
            fixes_left_out=messages.left_out,
            stated_accuracy=tuple(fixes.contradictions(agreement, placed.w_T_b)),
        )

    def _refined_with_agreeing(
        self,
        base: Setup,
        part: MapPart,
        fixes: FixComparison | None,
        control: ControlComparison,
        first: _Used,
    ) -> tuple[MapPart, Agreement | None]:
        """Refine the part, and again while the refined map changes the verdict on a fix or control point."""
        agreement, used_points = first.agreement, first.points
        verdicts = None if agreement is None else FixVerdicts.first(agreement)
        for _ in range(_MOST_SELECTIONS):
            setup = base.with_fixes(agreement).with_control(used_points)
            refined = self.refinement.of(setup, part)
            bundle, compared = refined.bundle, refined.compared
            verdict = control.judge(bundle, used_points)
            by_inertia = compared.scale if compared else None
            part = replace(
                part,
                setup=setup,
                w_T_b=bundle.w_T_b,
                floor_z_m=bundle.floor_z_m,
                bundle=bundle,
                inertial=by_inertia if isinstance(by_inertia, AccelerometerScale) else None,
                clock=compared.clock if compared else None,
                control=verdict.report(bundle, used_points, fixes.fixes if fixes else None)
                if control.points
                else None,
            )
            used, settled = agreement, np.array_equal(verdict.used, used_points)
            if fixes and used and verdicts:
                map_std_m = fixes.map_std_m(bundle.w_T_b, bundle.antenna_covariances, ~used.used)
                found = part.refined_fixes(fixes).exact(bundle.w_T_b, map_std_m)
                verdicts = verdicts.after(found, fixes.of_keyframes(contradicted_keyframes(bundle.optimum)))
                agreement = verdicts.agreement
                settled = settled and agreement.same(used)
            if settled:
                break
            used_points = verdict.used
        else:
            # The messages follow the fixes that the last refinement used.
            agreement = used
            part = replace(part, warnings=(*part.warnings, _NOT_SETTLED))
        contradicted = part.inertial.contradiction if part.inertial else None
        warnings = [contradicted] if contradicted else []
        warnings += convergence_warnings(bundle, base.readings)
        part = replace(
            part,
            warnings=(*part.warnings, *refined.warnings, *warnings),
            remarks=refined.remarks,
            no_scale=_no_scale(by_inertia, bundle, refined.reasons),
            velocity_left_out=refined.velocity_left_out,
        )
        return part, agreement


def _misread(part: MapPart, control: ControlComparison, w_T_b: Array) -> str:
    """Return what is wrong with the pixels of control points that a refined part follows; empty if nothing.

    ``w_T_b`` (m, 4, 4) are its poses of the pose graph.
    """
    if part.bundle is None or part.control is None or not part.control.is_followed:
        return ""
    points = [surveyed.point for surveyed in control.points]
    return misread(part.bundle, points, part.setup.camera, w_T_b)


def _no_scale(
    by_inertia: AccelerometerScale | NoScale | None, bundle: Bundle, by_others: tuple[Message, ...]
) -> tuple[Message, ...]:
    """Return why a scale that was needed was not found."""
    if bundle.scale_std is not None:
        return ()
    if not by_others and isinstance(by_inertia, NoScale):
        return (no_scale_line("imu0", by_inertia.reason),)
    return by_others


def _tied(n: int, kept: Sequence[Registration]) -> NDArray[np.bool_]:
    """Return which of ``n`` keyframes any registration ties to another one."""
    tied = np.zeros(n, bool)
    for r in kept:
        tied[[r.i, r.j]] = True
    return tied
