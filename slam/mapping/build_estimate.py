"""The `Estimate` of a finished map: poses, verdicts of loops, counts and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from backend.bundle.information_shares import information_shares
from backend.bundle.systematic_errors import SystematicErrors, systematic_errors
from backend.errors import BackendError
from backend.measurements import RelativePose
from backend.pose_graph.solution import Solution
from backend.sparse_cholesky import SingularMatrixError
from slam.core.estimate import Estimate, InstrumentErrors, LoopVerdict, MountTilt
from slam.core.flight import Flight
from slam.core.flight_info import describe, missing_for_map
from slam.core.names import listed
from slam.core.stream_anomalies import camera_anomalies, imu_axis_anomalies
from slam.mapping.calibration.attitude_floor_tilt import attitude_floor_tilt, attitude_floor_tilt_warning
from slam.mapping.calibration.camera_mount import mount_tilt, mount_warning
from slam.mapping.calibration.clock_offset import (
    NO_CORRECTION,
    clock_contradiction,
    clock_errors,
    clock_warning,
    with_clock_error,
)
from slam.mapping.calibration.instrument_errors import accelerometer_errors, attitude_errors
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context
from slam.mapping.front_end import Observations
from slam.mapping.homography_chain import chain
from slam.mapping.lift_edges import Edges
from slam.mapping.map import Map
from slam.mapping.refine import comparable
from slam.mapping.warnings.accuracy_basis import accuracy_basis
from slam.mapping.warnings.contradictions import contradictions
from slam.mapping.warnings.lost_pictures import NOTABLE_SHARE, lost_picture_warnings
from slam.mapping.warnings.not_placed import ALONE, not_placed_warnings, pictures_not_placed
from slam.mapping.warnings.one_place import one_place_warning
from slam.mapping.warnings.systematic_warning import explains, is_outside_covariances, systematic_warning

Array = NDArray[np.float64]


def _loop_verdicts(
    config: PipelineConfig, observations: Observations, edges: Edges, solution: Solution
) -> tuple[LoopVerdict, ...]:
    """List the verdict on each pair of keyframes that lies far enough apart in time to be a loop."""
    t, apart = observations.stamps_s, config.loops.min_separation_s
    verdicts = [
        LoopVerdict(r.i, r.j, "rejected", r.reason)
        for r in observations.refused
        if abs(t[r.j] - t[r.i]) >= apart
    ]
    for r, ok, reason in zip(edges.registrations, solution.edge_kept, solution.edge_reason, strict=True):
        if abs(t[r.j] - t[r.i]) >= apart:
            verdicts.append(LoopVerdict(r.i, r.j, "kept" if ok else "rejected", reason))
    return tuple(sorted(verdicts, key=lambda v: (v.i, v.j)))


def _status(
    context: Context,
    map_: Map,
    metric: bool,
    not_placed: dict[str, str],
    shared: SystematicErrors | None,
) -> tuple[str, list[str]]:
    flight, stamps_s = context.flight, map_.observations.stamps_s
    by_metres = metric or map_.georeferenced
    main = map_.of_main(map_.w_T_b)
    systematic, is_in_status = _systematic_warning(flight, map_, shared)
    lines = [
        # First, because instruments contradict a map that a lens has bent.
        systematic if is_in_status else "",
        *map_.warnings,
        *(found.warning for found in map_.stated_accuracy if not (systematic and explains(shared, found))),
        *(camera_anomalies(flight.camera) if flight.camera is not None else ()),
        *(imu_axis_anomalies(flight.imu) if flight.imu is not None else ()),
        *contradictions(flight, stamps_s, main, by_metres),
        clock_contradiction(map_.clock, context.clock),
        one_place_warning(flight, map_, context.setup.config.keyframes.min_overlap, by_metres),
    ]
    warnings = [line for line in lines if line]
    parts = int(map_.component.max(initial=-1)) + 1
    lost = [name for name, reason in not_placed.items() if reason == ALONE]
    if parts > 1:
        sizes = ", ".join(str(int((map_.component == k).sum())) for k in range(parts))
        warnings.append(
            f"the map is in {parts} parts ({sizes} keyframes) that no overlapping pictures connect"
        )
    if lost:
        who = f"{len(lost)} keyframes overlap" if len(lost) > 1 else "1 keyframe overlaps"
        warnings.append(f"{who} too little with any other: not on the map ({listed(lost)})")
    vague = int(((map_.component >= 0) & ~np.isfinite(map_.covariances).all(axis=(1, 2))).sum())
    if vague:
        warnings.append(
            f"no uncertainty is known for {vague} keyframes: they could not be refined, or the measurements "
            "do not determine them"
        )
    if not by_metres:
        warnings.append(_scale_warning(flight, map_))
    return "; ".join(warnings) or "ok", warnings


def _scale_warning(flight: Flight, map_: Map) -> str:
    measured = flight.sonar is not None and bool(np.isfinite(flight.sonar.range_m).any())
    lacking = "no sonar range that fits the pictures, and no GPS" if measured else "no sonar and no GPS"
    if map_.bundle is None or map_.bundle.scale_std is None:
        return f"{lacking}: no metric scale; lengths are in units of the camera's mean height over the floor"
    std = 100 * map_.bundle.scale_std
    return f"{lacking}: lengths come from the accelerometer and are known to {std:.2g} %"


def build_estimate(context: Context, map_: Map) -> Estimate:
    """Collect poses, verdicts, counts and warnings of a finished map."""
    flight, setup = context.flight, context.setup
    observations, edges, solution = map_.observations, map_.edges, map_.graph
    odometry = map_.odometry or map_
    assert flight.frames is not None
    metric = bool(edges.heights.metric[map_.component >= 0].all())
    shared, untested = _systematic_errors(map_)
    not_placed = pictures_not_placed(flight, map_)
    status, warnings = _status(context, map_, metric, not_placed, shared)
    loops = _loop_verdicts(setup.config, observations, edges, solution)
    mount, clock = mount_tilt(flight.camera, map_.bundle), clock_errors(map_.clock, context.clock)
    chained = chain(
        observations.links,
        setup.camera,
        setup.readings.roll_pitch_rad,
        odometry.edges.heights.height_m,
    )
    return Estimate(
        name=flight.name,
        status=status,
        epoch_ns=flight.epoch_ns,
        stamps_s=observations.stamps_s,
        frame_names=tuple(flight.frames.names[k] for k in observations.frame_index),
        frame_index=observations.frame_index,
        w_T_b=map_.w_T_b,
        covariances=_covariances(context, map_),
        over_floor_covariances=map_.over_floor_covariances,
        component=map_.component,
        camera=map_.camera,
        floor_z_m=map_.floor_z_m,
        origin=flight.geo_origin() if map_.georeferenced else None,
        relative_poses=_kept_edges(map_),
        loops=loops,
        chain_w_T_b=comparable(chained, setup.readings, map_),
        odometry_w_T_b=comparable(odometry.graph.w_T_b, setup.readings, map_),
        frames=observations.frames,
        rejected=_rejected_counts(map_, loops),
        not_placed=not_placed,
        timing_s=context.timer.seconds,
        warnings=tuple(
            dict.fromkeys(  # a line of the flight may be part of the status too
                [
                    *flight.warnings,
                    *describe(flight).anomalies,
                    *missing_for_map(flight),
                    *not_placed_warnings(not_placed),
                    *lost_picture_warnings(flight, observations),
                    *_moving(observations, shared),
                    *_instrument_warnings(context, map_, mount, shared),
                    *untested,
                    *map_.remarks,
                    *warnings,
                    *solution.warnings,
                ]
            )
        ),
        floor_slope_rad=map_.slope_rad,
        instruments=InstrumentErrors(
            attitude_errors(flight, observations.stamps_s, map_.of_main(map_.w_T_b), not flight.parts),
            accelerometer_errors(map_.inertial, clock),
            mount,
            shared,
            clock,
        ),
        accuracy_basis=accuracy_basis(flight, map_),
        information_shares=_information_shares(flight, map_),
        scale_std=map_.bundle.scale_std if map_.bundle else None,
        range_errors=map_.bundle.range_errors if map_.bundle else None,
        graph_error=map_.bundle.error if map_.bundle else solution.error,
        iterations=solution.iterations + (map_.bundle.iterations if map_.bundle else 0),
    )


def _systematic_errors(map_: Map) -> tuple[SystematicErrors | None, list[str]]:
    """Return the errors that all pictures or positions share, and a line where they cannot be tested for."""
    try:
        return (None if map_.bundle is None else systematic_errors(map_.bundle)), []
    except BackendError as error:
        return None, [f"errors that all pictures or all positions share cannot be tested for: {error}"]


def _information_shares(flight: Flight, map_: Map) -> Mapping[str, Mapping[str, float]]:
    """Return the shares of the instruments; a level vehicle is assumed where no attitude was measured."""
    if map_.bundle is None:
        return {}
    try:
        found = information_shares(map_.bundle.optimum)
    except SingularMatrixError:
        return {}
    if flight.attitude is not None:
        return found
    return {direction: _attitude_assumed(shares) for direction, shares in found.items()}


def _attitude_assumed(shares: Mapping[str, float]) -> Mapping[str, float]:
    measured = {name: share for name, share in shares.items() if name not in ("attitude", "assumed")}
    return {"assumed": 1.0 - sum(measured.values()), **measured}


def _covariances(context: Context, map_: Map) -> Array:
    """Return the covariances of the poses, with the error of a corrected clock."""
    if context.clock is NO_CORRECTION:
        return map_.covariances
    camera_stamps_s = map_.observations.camera_stamps_s[map_.observations.frame_index]
    std_s = context.clock.stds_at(camera_stamps_s)
    return with_clock_error(map_.covariances, map_.w_T_b, map_.observations.stamps_s, std_s)


def _rejected_counts(map_: Map, loops: tuple[LoopVerdict, ...]) -> dict[str, int]:
    """Count dropped pictures, rejected loops and dropped observations by reason."""
    rejected = Counter(map_.observations.rejected)
    rejected.update(Counter(f"loop: {reason_kind(v.reason)}" for v in loops if v.verdict == "rejected"))
    if map_.bundle is not None and map_.bundle.dropped_observations:
        rejected["view of a floor point far off"] = map_.bundle.dropped_observations
    return dict(rejected)


def _kept_edges(map_: Map) -> tuple[RelativePose, ...]:
    """Return the accepted edges between placed keyframes, at the final heights, and the bridges."""
    accepted = zip(map_.edges.at_heights(map_.height_m), map_.graph.edge_kept, strict=True)
    kept = [r for r, ok in accepted if ok and np.isfinite(map_.w_T_b[[r.i, r.j]]).all()]
    return (*kept, *map_.bridges)


def _moving(observations: Observations, shared: SystematicErrors | None) -> list[str]:
    """Report objects that move by themselves, if there are more than by chance."""
    if observations.moving <= NOTABLE_SHARE * observations.frames:
        return []
    pictures = f"in {observations.moving} of {observations.frames} pictures"
    if shared is not None and is_outside_covariances(shared) and "radial" in shared.coefficients:
        return [
            f"{pictures} some features do not move as the others do, which a lens distortion explains as "
            "well as moving things; they are left out of the map"
        ]
    return [
        f"{pictures} something moves by itself, or the pattern of the floor repeats; features on it are left "
        "out of the map"
    ]


def _instrument_warnings(
    context: Context, map_: Map, mount: MountTilt | None, shared: SystematicErrors | None
) -> list[str]:
    lines = [mount_warning(mount, context.flight.camera_file), clock_warning(map_.clock, context.clock)]
    if not map_.georeferenced and not context.flight.parts:
        # Positions would have determined the slope of the ground.
        poses = map_.of_main(map_.w_T_b)
        tilt = attitude_floor_tilt(context.flight, map_.observations.stamps_s, poses)
        lines.insert(0, attitude_floor_tilt_warning(tilt))
    systematic, is_in_status = _systematic_warning(context.flight, map_, shared)
    return [line for line in (*lines, "" if is_in_status else systematic) if line]


def _systematic_warning(flight: Flight, map_: Map, shared: SystematicErrors | None) -> tuple[str, bool]:
    """Return the warning, with the accuracies that the same errors contradict, and whether the status is not
    ok for it."""
    assert flight.camera is not None
    height_m = float(np.nanmedian(map_.height_m[map_.component == 0]))
    line = systematic_warning(shared, flight.camera, height_m, map_.metric, flight.camera_file)
    contradicted = [f"; {c.differs} for this reason" for c in map_.stated_accuracy if explains(shared, c)]
    if not line:
        return "", False
    return line + "".join(contradicted), bool(contradicted) or is_outside_covariances(shared)


def reason_kind(reason: str) -> str:
    """The reason without its figures, for counting."""
    return reason.split(":")[0].split(" by ")[0]
