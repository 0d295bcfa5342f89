"""The post-flight job: a flight in, optimized keyframes out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.bundle import Bundle
from backend.errors import BackendError
from backend.solution import Solution
from frontend.camera import Camera
from slam.chain import chain
from slam.errors import InputError
from slam.estimate import Estimate, LoopVerdict, over_floor
from slam.flight import Flight
from slam.mapping import Edges, Mapper, Sensors
from slam.placement import lay_onto
from slam.progress import Progress, silent
from slam.settings import PipelineConfig
from slam.sightings import Sighter, Sightings
from slam.stopwatch import Stopwatch

Array = NDArray[np.float64]


def optimize(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> Estimate:
    """Trajectory, loops and covariances of a flight with a down-looking camera.

    Raises ``InputError`` where the flight has no camera or its pictures cannot be joined.
    """
    camera = _camera(flight)
    clock = Stopwatch()
    sighter = Sighter(flight, camera, config, progress)
    with clock("track"):
        sightings = sighter.watch()  # track -> gate -> keyframe
        _refuse_if_blind(flight, sightings)
        sightings = sighter.neighbours(sightings)
    origin = flight.geo_origin()
    mapper = Mapper(camera, Sensors.at(flight, sightings.stamps_s, origin, config), config)
    with clock("graph"):
        odometry = mapper.edges(sightings.registrations)
        without_loops = mapper.solve(odometry, lambda k, _: progress("graph", k, 0), covariances=True)
    with clock("loops"):
        sightings = sighter.retrieve(sightings)  # retrieve -> verify
        edges = mapper.edges(sightings.registrations)
        sightings = sightings.without(mapper.contradictions(edges, without_loops))
    with clock("graph"):
        edges = mapper.edges(sightings.registrations)
        solution = mapper.solve(edges, lambda k, _: progress("graph", k, 0))
    with clock("refine"):
        fused = _fuse(mapper, sightings, edges, solution, progress)
    with clock("loops"):
        sightings = sighter.revisit(sightings, fused.over_floor_T_b, fused.floor_z_m)
    with clock("graph"):
        informed = mapper.knowing(fused.over_floor_T_b, fused.covariances)
        edges = informed.edges(sightings.registrations)
        solution = informed.solve(edges, lambda k, _: progress("graph", k, 0))
    with clock("refine"):
        fused = _fuse(mapper, sightings, edges, solution, progress)
    return _estimate(
        flight, config, sightings, mapper, edges, solution, without_loops, odometry, fused, clock
    )


@dataclass(frozen=True)
class _Fused:
    """All connected parts, refined and placed."""

    w_T_b: Array
    covariances: Array
    component: NDArray[np.int64]
    floor_z_m: float
    camera: Camera
    bundle: Bundle | None
    """Of the largest part."""
    georeferenced: bool
    warnings: tuple[str, ...]

    @property
    def slope_rad(self) -> tuple[float, float]:
        return self.bundle.floor_slope_rad if self.bundle else (0.0, 0.0)

    @property
    def over_floor_T_b(self) -> Array:
        return over_floor(self.w_T_b, self.slope_rad, self.floor_z_m)


def _camera(flight: Flight) -> Camera:
    if flight.camera is None or flight.frames is None or len(flight.frames) == 0:
        raise InputError(
            f"{flight.name}: no camera in this flight, so no map; slam estimate works without one"
        )
    return flight.camera


def _refuse_if_blind(flight: Flight, sightings: Sightings) -> None:
    if len(sightings.stamps_s) >= 2 and sightings.registrations:
        return
    reasons = ", ".join(f"{count} x {reason}" for reason, count in sightings.rejected.most_common(3))
    raise InputError(
        f"{flight.name}: no two of {sightings.frames} pictures could be joined ({reasons or 'nothing moved'})"
        "; the floor needs texture, light and overlap"
    )


def _fuse(
    mapper: Mapper, sightings: Sightings, edges: Edges, solution: Solution, progress: Progress
) -> _Fused:
    """Place each connected part and refine it on its floor points."""
    sensors = mapper.sensors
    n = len(sensors.stamps_s)
    kept = [r for r, ok in zip(edges.registrations, solution.edge_kept, strict=True) if ok]
    tracks = mapper.tracks(sightings.store.pixels, kept)
    w_T_b, covariances = solution.w_T_b.copy(), np.full((n, 6, 6), np.nan)
    component = np.where(_tied(n, kept), solution.component, -1)
    w_T_b[component < 0] = np.nan
    warnings: list[str] = []
    camera, floor_z_m, first, georeferenced = mapper.camera, 0.0, None, False
    for part in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == part)
        if len(members) < 2:
            component[members] = -1
            continue
        metric = bool(edges.heights.metric[members].all())
        laid = lay_onto(w_T_b[members], _renumbered(mapper, members), metric)
        start, floor = laid if laid is not None else (_headed(w_T_b[members], sensors, members), 0.0)
        if laid is None and sensors.positions:
            warnings.append(
                f"{len(members)} keyframes have no usable position; they stand in their own frame"
            )
        w_T_b[members] = start
        try:
            bundle = mapper.refine(members, w_T_b, floor, tracks, lambda k, _: progress("refine", k, 0))
        except BackendError as error:
            warnings.append(f"part of {len(members)} keyframes not refined: {error}")
        else:
            w_T_b[members], covariances[members], floor = bundle.w_T_b, bundle.covariances, bundle.floor_z_m
            if part == 0:
                first, camera = bundle, _calibrated(camera, bundle)
        if part == 0:
            floor_z_m, georeferenced = floor, laid is not None
    return _Fused(w_T_b, covariances, component, floor_z_m, camera, first, georeferenced, tuple(warnings))


def _tied(n: int, kept: list) -> NDArray[np.bool_]:
    tied = np.zeros(n, bool)
    for r in kept:
        tied[[r.i, r.j]] = True
    return tied


def _renumbered(mapper: Mapper, members: NDArray[np.int64]) -> list:
    number = {int(k): m for m, k in enumerate(members)}
    return [replace(p, k=number[p.k]) for p in mapper.sensors.positions if p.k in number]


def _comparable(w_T_b: Array, mapper: Mapper, fused: _Fused) -> Array:
    """Poses of a lesser method where the result stands, so that the two can be compared."""
    if fused.georeferenced:
        laid = lay_onto(w_T_b, mapper.sensors.positions, metric=False)
        return np.full_like(w_T_b, np.nan) if laid is None else laid[0] + _lift(fused.floor_z_m - laid[1])
    placed = np.flatnonzero(np.isfinite(w_T_b).all(axis=(1, 2)))
    comparable = w_T_b.copy()
    if len(placed):
        comparable[placed] = _headed(w_T_b[placed], mapper.sensors, placed)
    return comparable


def _lift(z_m: float) -> Array:
    shift = np.zeros((4, 4))
    shift[2, 3] = z_m
    return shift


def _headed(w_T_b: Array, sensors: Sensors, members: NDArray[np.int64]) -> Array:
    """The first keyframe above the origin, its heading as its own attitude has it."""
    yaw = next((a.roll_pitch_yaw_rad[2] for a in sensors.attitudes if a.k == members[0]), 0.0)
    now = np.arctan2(w_T_b[0, 1, 0], w_T_b[0, 0, 0])
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw - now).as_matrix()
    shift = np.eye(4)
    shift[:2, 3] = -w_T_b[0, :2, 3]
    return turn @ shift @ w_T_b


def _calibrated(camera: Camera, bundle: Bundle) -> Camera:
    if camera.focal_std_ratio == 0:
        return camera
    return replace(camera, focal_px=bundle.focal_px, distortion=(*bundle.radial, 0.0, 0.0))


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


def _status(fused: _Fused, metric: bool) -> tuple[str, list[str]]:
    warnings = list(fused.warnings)
    parts = int(fused.component.max(initial=-1)) + 1
    lost = int((fused.component < 0).sum())
    if parts > 1:
        sizes = ", ".join(str(int((fused.component == k).sum())) for k in range(parts))
        warnings.append(f"the flight falls into {parts} parts that no picture joins ({sizes} keyframes)")
    if lost:
        warnings.append(f"{lost} keyframes overlap no other and are not placed")
    if not metric and not fused.georeferenced:
        warnings.append("no sonar and no GPS: no metric scale; lengths are in mean heights of the camera")
    status = "ok" if not warnings else "; ".join(warnings)
    return status, warnings


def _estimate(
    flight: Flight,
    config: PipelineConfig,
    sightings: Sightings,
    mapper: Mapper,
    edges: Edges,
    solution: Solution,
    without_loops: Solution,
    odometry: Edges,
    fused: _Fused,
    clock: Stopwatch,
) -> Estimate:
    assert flight.frames is not None
    status, warnings = _status(fused, bool(edges.heights.metric.all()))
    loops = _loop_verdicts(config, sightings, edges, solution)
    rejected = Counter(sightings.rejected)
    rejected.update(Counter(f"loop: {_kind(v.reason)}" for v in loops if v.verdict == "rejected"))
    kept = tuple(
        r
        for r, ok in zip(edges.relative_poses, solution.edge_kept, strict=True)
        if ok and np.isfinite(fused.w_T_b[[r.i, r.j]]).all()
    )
    chained = chain(sightings.links, mapper.camera, mapper.sensors.roll_pitch_rad, odometry.heights.height_m)
    return Estimate(
        name=flight.name,
        status=status,
        epoch_ns=flight.epoch_ns,
        stamps_s=sightings.stamps_s,
        frame_names=tuple(flight.frames.names[k] for k in sightings.frame_index),
        frame_index=sightings.frame_index,
        w_T_b=fused.w_T_b,
        covariances=fused.covariances,
        component=fused.component,
        camera=fused.camera,
        floor_z_m=fused.floor_z_m,
        origin=flight.geo_origin() if fused.georeferenced else None,
        relative_poses=kept,
        loops=loops,
        chain_w_T_b=_comparable(chained, mapper, fused),
        odometry_w_T_b=_comparable(without_loops.w_T_b, mapper, fused),
        frames=sightings.frames,
        rejected=dict(rejected),
        timing_s=clock.seconds,
        warnings=(*flight.warnings, *warnings, *solution.warnings),
        floor_slope_rad=fused.slope_rad,
        graph_error=fused.bundle.error if fused.bundle else solution.error,
        iterations=solution.iterations + (fused.bundle.iterations if fused.bundle else 0),
    )


def _kind(reason: str) -> str:
    """The reason without its figures, for counting."""
    return reason.split(":")[0].split(" by ")[0]
