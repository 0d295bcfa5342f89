"""The `Estimate` of a finished map: poses, verdicts of loops, counts and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from backend.bundle.accuracy.ground_covariances import ground_covariances
from backend.bundle.accuracy.information_shares import information_shares
from backend.bundle.accuracy.length_stds import length_stds
from backend.bundle.accuracy.systematic_errors import SystematicErrors, error_test
from backend.errors import BackendError
from backend.measurements import RelativePose
from backend.pose_graph.certificate import Certificate, certify_poses
from backend.pose_graph.graph import build_pose_graph
from backend.pose_graph.solution import Solution
from backend.sparse_cholesky import SingularMatrixError
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.flight import Flight
from slam.core.heap import trim_heap
from slam.core.instrument_errors import InstrumentErrors
from slam.core.messages import Message, warning
from slam.core.streams import Gps
from slam.mapping.calibration.antenna import (
    antenna_height_note,
    antenna_m,
    antenna_place,
    unknown_antenna_warning,
)
from slam.mapping.calibration.barometer_errors import barometer_errors, barometer_warning
from slam.mapping.calibration.camera_mount import mount_tilt
from slam.mapping.calibration.clock_offset import clock_errors
from slam.mapping.calibration.found_shutter import rolling_shutter, row_motion
from slam.mapping.calibration.instrument_errors import accelerometer_errors, attitude_errors
from slam.mapping.calibration.lens import lens_numbers
from slam.mapping.calibration.refuted import is_fixed_lens_suspect
from slam.mapping.calibration.velocity_errors import velocity_errors, velocity_warning
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context
from slam.mapping.front_end import Observations
from slam.mapping.homography_chain import chain
from slam.mapping.lift_edges import Edges
from slam.mapping.map import Map
from slam.mapping.place_part import comparable
from slam.mapping.pose_errors import (
    datum_displacements,
    instrument_displacements,
    of_all_poses,
    with_displacements,
)
from slam.mapping.warnings.accuracy_basis import accuracy_basis
from slam.mapping.warnings.messages import messages
from slam.mapping.warnings.not_placed import pictures_not_placed

Array = NDArray[np.float64]


def _loop_verdicts(
    config: PipelineConfig, observations: Observations, edges: Edges, solution: Solution
) -> tuple[LoopVerdict, ...]:
    """List the verdict on each pair of keyframes that lies far enough apart in time to be a loop."""
    t, apart = observations.stamps_s, config.loops.min_separation_s
    verdicts = [
        LoopVerdict(r.i, r.j, r.reason) for r in observations.refused if abs(t[r.j] - t[r.i]) >= apart
    ]
    for r, reason in zip(edges.registrations, solution.edge_reason, strict=True):
        if abs(t[r.j] - t[r.i]) >= apart:
            verdicts.append(LoopVerdict(r.i, r.j, reason))
    return tuple(sorted(verdicts, key=lambda v: (v.i, v.j)))


def build_estimate(
    context: Context, map_: Map, shared: SystematicErrors | None, untested: Sequence[Message]
) -> Estimate:
    """Collect poses, verdicts, counts and warnings of a finished map, with its `shared_errors`."""
    flight, setup = context.flight, context.setup
    observations, edges, solution = map_.observations, map_.edges, map_.graph
    chained, odometry = _lesser_maps(context, map_)
    assert flight.frames is not None
    not_placed = pictures_not_placed(flight, map_)
    loops = _loop_verdicts(setup.config, observations, edges, solution)
    instruments = _instrument_errors(context, map_, shared)
    datum = datum_displacements(flight, map_)
    displacements = np.concatenate([instrument_displacements(context, map_), datum], axis=2)
    kept = _kept_edges(map_)
    by_instruments = [velocity_warning(instruments.velocity), barometer_warning(map_.bundle)]
    shares = _information_shares(flight, map_)
    row_motion_m, row_turn_rad = row_motion(map_)
    said = messages(
        context, map_, not_placed, shared, instruments.mount, shares, (*untested, *by_instruments)
    )
    return Estimate(
        name=flight.name,
        epoch_ns=flight.epoch_ns,
        stamps_s=observations.stamps_s,
        frame_names=tuple(flight.frames.names[k] for k in observations.frame_index),
        frame_index=observations.frame_index,
        w_T_b=map_.w_T_b,
        covariances=with_displacements(map_.covariances, displacements),
        over_floor_covariances=with_displacements(map_.over_floor_covariances, datum),
        component=map_.component,
        camera=map_.camera,
        floor_z_m=map_.floor_z_m,
        origin=flight.geo_origin() if map_.georeferenced else None,
        relative_poses=kept,
        loops=loops,
        chain_w_T_b=comparable(chained, setup.readings, map_),
        odometry_w_T_b=comparable(odometry, setup.readings, map_),
        frames=observations.frames,
        rejected=_rejected_counts(map_, loops),
        not_placed=not_placed,
        timing_s=context.timer.seconds,
        messages=said,
        control=map_.control,
        floor_slope_rad=map_.slope_rad,
        instruments=instruments,
        antenna_m=antenna_m(map_.bundle),
        antenna_covariances=_antenna_covariances(map_),
        accuracy_basis=accuracy_basis(flight, map_, shares),
        information_shares=shares,
        ground_covariances=_ground_covariances(map_, datum),
        scale_std=map_.bundle.scale_std if map_.bundle else None,
        joint_errors=of_all_poses(map_, displacements),
        row_motion_m=row_motion_m,
        row_turn_rad=row_turn_rad,
        length_stds=_length_stds(map_),
        middle_std_m=_middle_std_m(map_, datum),
        range_errors=map_.bundle.range_errors if map_.bundle else None,
        graph_error=map_.bundle.error if map_.bundle else solution.error,
        iterations=solution.iterations + (map_.bundle.iterations if map_.bundle else 0),
        floor_points=map_.floor_points,
        certificate=_certificate(context, map_, kept),
    )


def _instrument_errors(context: Context, map_: Map, shared: SystematicErrors | None) -> InstrumentErrors:
    """Return the errors of the instruments in a map, with those ``shared`` by pictures or positions."""
    flight, clock = context.flight, clock_errors(map_.clock, context.clock)
    stamps_s, main_w_T_b = map_.observations.stamps_s, map_.of_main(map_.w_T_b)
    return InstrumentErrors(
        attitude=attitude_errors(flight, stamps_s, main_w_T_b, not flight.parts),
        accelerometer=accelerometer_errors(map_.inertial, clock),
        mount=mount_tilt(flight.camera, map_.bundle),
        systematic=shared or (context.refuted_lens.errors if context.refuted_lens else None),
        picture_clock=clock,
        lens=lens_numbers(map_.bundle),
        velocity=velocity_errors(map_.bundle),
        barometer=barometer_errors(map_.bundle),
        antenna=antenna_place(map_.bundle),
        rolling_shutter=rolling_shutter(map_.bundle),
    )


def _certificate(context: Context, map_: Map, kept: tuple[RelativePose, ...]) -> Certificate:
    """Return whether the accepted matches allow no better arrangement of the keyframes than one near the map.

    It is about the pairs of pictures alone: with the other measurements there is no such bound.
    """
    with context.timer("graph"):
        trim_heap()  # its factor is as large as that of a refinement
        graph = build_pose_graph(map_.w_T_b, kept)
        everything = np.ones(len(graph.i), dtype=bool)
        return certify_poses(graph, graph.poses, map_.component[graph.ids], everything)


def _lesser_maps(context: Context, map_: Map) -> tuple[Array, Array]:
    """Return the poses (n, 4, 4) of the plain chain and of the map without loops.

    The inertial bridges that join the parts of the map join theirs too: what is compared are the loops. Where
    nothing but loops connects a part to the largest one, such as a second flight, its poses are NaN.
    """
    setup, odometry = context.setup, map_.odometry or map_
    in_parts = odometry.component.max(initial=-1) > 0 and context.flight.gps is None
    chained = chain(
        map_.observations.links,
        setup.camera,
        setup.readings.roll_pitch_rad,
        odometry.edges.heights.height_m,
        context.bridges.edges() if in_parts else (),
    )
    if not in_parts:
        return chained, odometry.w_T_b
    joined = context.bridges.join(odometry)
    return chained, np.where(joined.component[:, None, None] == 0, joined.w_T_b, np.nan)


def shared_errors(map_: Map, gps: Gps | None) -> tuple[SystematicErrors | None, list[Message], bool]:
    """Return the errors that all pictures or positions share, a line where they cannot be tested for, and
    whether a fixed lens is suspect without any."""
    if map_.bundle is None:
        return None, [], False
    try:
        tested = error_test(map_.bundle.optimum, map_.bundle.covariances)
        is_assumed = gps is not None and gps.antenna_assumed
        line = unknown_antenna_warning(map_.bundle, tested) if tested and is_assumed else None
        lines = [each for each in (line, antenna_height_note(map_.bundle)) if each]
        suspect = tested is not None and is_fixed_lens_suspect(map_.bundle, tested)
        return tested.errors if tested else None, lines, suspect
    except BackendError as error:
        why = f"errors that all pictures or all positions share cannot be tested for: {error}"
        return None, [warning(why, "compare one distance with the ground")], False


def _middle_std_m(map_: Map, datum: Array) -> float | None:
    """Return how uncertain the place of the whole ground is, with the error ``datum`` (n, 6, e) of all poses;
    None of a map that is not on Earth."""
    if map_.bundle is None or not map_.georeferenced:
        return None
    common_m = np.nanmax(np.linalg.norm(datum[:, 3:], axis=(1, 2)))  # NaN where a pose is not placed
    return float(np.hypot(map_.bundle.middle_std_m, common_m))


def _ground_covariances(map_: Map, datum: Array) -> Array | None:
    """Return the covariances of the ground with the errors of an estimated lens; None where it was fixed.

    ``datum`` (n, 6, e) are errors that move it with all poses. Those of lesser parts are theirs over the
    floor.
    """
    if map_.bundle is None or map_.bundle.lens is None:
        return None
    try:
        of_main = ground_covariances(map_.bundle.optimum)
    except SingularMatrixError:
        return None
    main = np.flatnonzero(map_.component == 0)
    if len(main) != len(of_main):  # instruments have joined other parts to the refined one
        return None
    found = map_.over_floor_covariances.copy()
    found[main] = of_main
    return with_displacements(found, datum)


def _length_stds(map_: Map) -> tuple[tuple[float, float, float], ...]:
    """Return how accurate distances are; empty where a direction is open."""
    if map_.bundle is None:
        return ()
    try:
        return length_stds(map_.bundle.optimum)
    except SingularMatrixError:
        return ()


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


def _antenna_covariances(map_: Map) -> Array | None:
    """Return the covariances (n, 3, 3) of the antenna's positions; NaN for pictures outside the main part."""
    bundle = map_.bundle
    if bundle is None or not bundle.optimum.problem.measurements.antenna_is_free:
        return None
    covariances = np.full((len(map_.w_T_b), 3, 3), np.nan)
    covariances[map_.component == 0] = bundle.antenna_covariances
    return covariances


def _rejected_counts(map_: Map, loops: tuple[LoopVerdict, ...]) -> dict[str, int]:
    """Count dropped pictures, rejected loops and dropped observations by reason."""
    rejected = Counter(map_.observations.rejected)
    rejected.update(Counter(f"loop: {v.rejection.kind}" for v in loops if v.rejection))
    if map_.bundle is not None and map_.bundle.dropped_observations:
        rejected["view of a floor point far off"] = map_.bundle.dropped_observations
    if map_.fixes_left_out:
        rejected["fix contradicts the others"] = len(map_.fixes_left_out)
    return dict(rejected)


def _kept_edges(map_: Map) -> tuple[RelativePose, ...]:
    """Return the accepted edges between placed keyframes, at the final heights, and the bridges."""
    accepted = zip(map_.edges.at_heights(map_.height_m), map_.graph.edge_kept, strict=True)
    kept = [r for r, ok in accepted if ok and np.isfinite(map_.w_T_b[[r.i, r.j]]).all()]
    return (*kept, *(bridge.edge for bridge in map_.bridges))
