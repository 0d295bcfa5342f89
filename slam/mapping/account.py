"""What came of a flight, put together as an `Estimate`: verdicts, counts, warnings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.heights import HeightEstimate
from backend.pose_graph.solution import Solution
from slam.core.estimate import Estimate, InstrumentErrors, LoopVerdict, MountTilt
from slam.core.flight import Flight
from slam.core.flight_info import describe, missing_for_map
from slam.mapping.chain import chain
from slam.mapping.clocks import delay_warning
from slam.mapping.config import PipelineConfig
from slam.mapping.contradictions import contradictions
from slam.mapping.fusion import Fused, comparable
from slam.mapping.instrument_errors import accelerometer_errors, attitude_errors
from slam.mapping.lean import lean_of, lean_warning
from slam.mapping.mapper import Edges, Mapper
from slam.mapping.mount import mount_tilt, mount_warning
from slam.mapping.sightings import Sightings

Array = NDArray[np.float64]


MOVING_SHARE = 0.02
"""Of the pictures: fewer in which something seems to move by itself are chance."""


@dataclass(frozen=True)
class Mapped:
    """Everything that the pipeline has found."""

    sightings: Sightings
    edges: Edges
    solution: Solution
    """The pose graph of ``edges``."""
    fused: Fused
    heights_without_loops: HeightEstimate
    """By the edges between neighbours in time alone."""
    without_loops: Solution
    """The pose graph of these edges."""
    late_s: float = 0.0
    """By so much the pictures were found to be stamped late, and the instruments' stamps moved; what comes of
    it is told on the instruments' clock again, which is the flight's."""


def _loop_verdicts(
    config: PipelineConfig, sightings: Sightings, edges: Edges, solution: Solution
) -> tuple[LoopVerdict, ...]:
    """What became of each pair of keyframes that lies far enough apart in time to be a loop."""
    t, apart = sightings.stamps_s, config.loops.min_separation_s
    verdicts = [
        LoopVerdict(r.i, r.j, "rejected", r.reason)
        for r in sightings.refused
        if abs(t[r.j] - t[r.i]) >= apart
    ]
    for r, ok, reason in zip(edges.registrations, solution.edge_kept, solution.edge_reason, strict=True):
        if abs(t[r.j] - t[r.i]) >= apart:
            verdicts.append(LoopVerdict(r.i, r.j, "kept" if ok else "rejected", reason))
    return tuple(sorted(verdicts, key=lambda v: (v.i, v.j)))


def _status(flight: Flight, stamps_s: Array, fused: Fused, metric: bool) -> tuple[str, list[str]]:
    by_metres = metric or fused.georeferenced
    main = fused.of_main(fused.w_T_b)
    warnings = [*fused.warnings, *contradictions(flight, stamps_s, main, by_metres)]
    parts = int(fused.component.max(initial=-1)) + 1
    lost = int((fused.component < 0).sum())
    if parts > 1:
        sizes = ", ".join(str(int((fused.component == k).sum())) for k in range(parts))
        warnings.append(
            f"the map is in {parts} parts ({sizes} keyframes) that no overlapping pictures connect"
        )
    if lost:
        who = f"{lost} keyframes overlap" if lost > 1 else "1 keyframe overlaps"
        warnings.append(f"{who} too little with any other: not on the map")
    vague = int(((fused.component >= 0) & ~np.isfinite(fused.covariances).all(axis=(1, 2))).sum())
    if vague:
        warnings.append(
            f"no uncertainty is known for {vague} keyframes: they could not be refined, or the measurements "
            "do not determine them"
        )
    if not by_metres:
        warnings.append(_scale_told(flight, fused))
    status = "ok" if not warnings else "; ".join(warnings)
    return status, warnings


def _scale_told(flight: Flight, fused: Fused) -> str:
    heard = flight.sonar is not None and bool(np.isfinite(flight.sonar.range_m).any())
    lacking = "no sonar range that fits the pictures, and no GPS" if heard else "no sonar and no GPS"
    if fused.bundle is None or fused.bundle.scale_std is None:
        return f"{lacking}: no metric scale; lengths are in units of the camera's mean height over the floor"
    std = 100 * fused.bundle.scale_std
    return f"{lacking}: lengths come from the accelerometer and are known to {std:.2g} %"


def account(
    flight: Flight, config: PipelineConfig, mapper: Mapper, mapped: Mapped, timing_s: dict[str, float]
) -> Estimate:
    """The estimate of a flight from what was found."""
    sightings, edges, solution, fused = mapped.sightings, mapped.edges, mapped.solution, mapped.fused
    assert flight.frames is not None
    metric = bool(edges.heights.metric[fused.component >= 0].all())
    status, warnings = _status(flight, sightings.stamps_s, fused, metric)
    loops = _loop_verdicts(config, sightings, edges, solution)
    rejected = Counter(sightings.rejected)
    rejected.update(Counter(f"loop: {reason_kind(v.reason)}" for v in loops if v.verdict == "rejected"))
    if fused.bundle is not None and fused.bundle.dropped_observations:
        rejected["view of a floor point far off"] = fused.bundle.dropped_observations
    height_m = fused.over_floor_T_b[:, 2, 3] - fused.floor_z_m
    kept = tuple(
        r
        for r, ok in zip(edges.at_heights(height_m), solution.edge_kept, strict=True)
        if ok and np.isfinite(fused.w_T_b[[r.i, r.j]]).all()
    )
    kept += fused.bridges
    mount = mount_tilt(flight.camera, fused.bundle)
    chained = chain(
        sightings.links, mapper.camera, mapper.sensors.roll_pitch_rad, mapped.heights_without_loops.height_m
    )
    return Estimate(
        name=flight.name,
        status=status,
        epoch_ns=flight.epoch_ns,
        stamps_s=sightings.stamps_s - mapped.late_s,
        frame_names=tuple(flight.frames.names[k] for k in sightings.frame_index),
        frame_index=sightings.frame_index,
        w_T_b=fused.w_T_b,
        covariances=fused.covariances,
        over_floor_covariances=fused.over_floor_covariances,
        component=fused.component,
        camera=fused.camera,
        floor_z_m=fused.floor_z_m,
        origin=flight.geo_origin() if fused.georeferenced else None,
        relative_poses=kept,
        loops=loops,
        chain_w_T_b=comparable(chained, mapper, fused),
        odometry_w_T_b=comparable(mapped.without_loops.w_T_b, mapper, fused),
        frames=sightings.frames,
        rejected=dict(rejected),
        timing_s=timing_s,
        warnings=(
            *flight.warnings,
            *describe(flight).anomalies,
            *missing_for_map(flight),
            *_moving(sightings),
            *_instruments_off(flight, mapped, mount),
            *warnings,
            *solution.warnings,
        ),
        floor_slope_rad=fused.slope_rad,
        instruments=InstrumentErrors(
            attitude_errors(flight, sightings.stamps_s, fused.of_main(fused.w_T_b), not flight.parts),
            accelerometer_errors(fused.inertial, mapped.late_s),
            mount,
        ),
        scale_std=fused.bundle.scale_std if fused.bundle else None,
        range_errors=fused.bundle.range_errors if fused.bundle else None,
        graph_error=fused.bundle.error if fused.bundle else solution.error,
        iterations=solution.iterations + (fused.bundle.iterations if fused.bundle else 0),
    )


def _moving(sightings: Sightings) -> list[str]:
    """What else than the floor moves in the pictures, if it is more than a chance find."""
    if sightings.moving <= MOVING_SHARE * sightings.frames:
        return []
    return [
        f"in {sightings.moving} of {sightings.frames} pictures something moves by itself, or the pattern of "
        "the floor repeats; features on it are left out of the map"
    ]


def _instruments_off(flight: Flight, mapped: Mapped, mount: MountTilt | None) -> list[str]:
    sightings, fused = mapped.sightings, mapped.fused
    told = [mount_warning(mount), delay_warning(fused.inertial, mapped.late_s)]
    if not fused.georeferenced and not flight.parts:
        # Positions would have told whether the ground slopes.
        told.insert(0, lean_warning(lean_of(flight, sightings.stamps_s, fused.of_main(fused.w_T_b))))
    return [line for line in told if line]


def reason_kind(reason: str) -> str:
    """The reason without its figures, for counting."""
    return reason.split(":")[0].split(" by ")[0]
