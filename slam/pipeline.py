"""The post-flight job: a flight in, optimized keyframes out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from backend.solution import Solution
from frontend.camera import Camera
from slam.errors import NO_CAMERA, InputError
from slam.estimate import Estimate
from slam.flight import Flight
from slam.mapping.account import Mapped, account
from slam.mapping.bridging import Bridges
from slam.mapping.clocks import delay_to_take_out, stamped_later
from slam.mapping.fusion import Fused, fuse
from slam.mapping.horizon import seeing_floor
from slam.mapping.mapper import Edges, Known, Mapper, Sensors
from slam.mapping.obstacles import Obstacles, echoes_in_map, find_obstacles, no_masks
from slam.mapping.sightings import Sighter, Sightings
from slam.mapping.synchronize import inertial_readings
from slam.progress import Progress, silent
from slam.settings import PipelineConfig
from slam.stopwatch import Stopwatch

MOST_PASSES = 2
"""Obstacles bend the first map, so that it may have them at the wrong places; the second has not."""


def optimize(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> Estimate:
    """Trajectory, loops and covariances of a flight with a down-looking camera.

    Raises ``InputError`` where the flight has no camera or its pictures cannot be joined.
    """
    return optimize_with_sightings(flight, config, progress)[0]


def optimize_with_sightings(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> tuple[Estimate, Sightings]:
    """The same, and what the front end saw: features of the keyframes, registrations held and refused."""
    # Threads of BLAS and of OpenCV would spin against each other for the same cores.
    with threadpool_limits(1, "blas"):
        camera = _camera(flight)
        return _optimize(seeing_floor(flight, camera), camera, config, progress, Stopwatch())


def _optimize(
    flown: Flight,
    camera: Camera,
    config: PipelineConfig,
    progress: Progress,
    clock: Stopwatch,
    obstacles: Obstacles | None = None,
    passes: int = 0,
) -> tuple[Estimate, Sightings]:
    flight = flown if obstacles is None else obstacles.cleared(flown)

    def step(iteration: int, _: float) -> None:
        progress("graph", iteration, 0)

    sighter = Sighter(flight, camera, config, progress)
    with clock("track"):
        sightings = sighter.watch(obstacles.masks if obstacles else no_masks)  # track -> gate -> keyframe
        _refuse_unless(len(sightings.stamps_s) >= 2, flight, sightings)
        sightings = sighter.neighbours(sightings)
    origin = flight.geo_origin()
    mapper = Mapper(camera, Sensors.at(flight, sightings.stamps_s, origin, config), config)
    bridges = Bridges(flight, mapper, sightings.links, config.inertial, progress)
    with clock("graph"):
        odometry = mapper.edges(sightings.registrations)
        without_loops = mapper.solve(odometry, step, covariances=True)
    with clock("loops"):
        reach = mapper.reach(odometry, without_loops)
        sightings = sighter.retrieve(sightings, reach)  # retrieve -> verify
        _refuse_unless(len(sightings.registrations) > 0, flight, sightings)
        height_m = odometry.heights.height_m
        known = Known(without_loops.w_T_b, without_loops.covariances, without_loops.component, height_m)
        edges = mapper.edges(sightings.registrations)
        sightings = sightings.without(mapper.contradictions(edges, known))
    with clock("graph"):
        edges = mapper.edges(sightings.registrations)
        solution = mapper.solve(edges, step)
    with clock("refine"):
        fused = bridges.join(fuse(mapper, sightings, edges, solution, progress))
        if (fused.component < 0).all():
            raise InputError(
                f"{flight.name}: the pictures match, but no pose of a camera above a floor explains how; "
                "check T_BS (which way it looks) and intrinsics in cam0/sensor.yaml, and the attitude"
            )
    found = _obstacles(flown, camera, sightings, fused, config) if passes < MOST_PASSES else None
    if found is not None and (obstacles is None or found.moved_from(obstacles)):
        return _optimize(flown, camera, config, progress, clock, found, passes + 1)  # once more, without them
    with clock("loops"):
        sightings = sighter.revisit(sightings, fused.over_floor_T_b, fused.floor_z_m)
    settled = _settled(flight, mapper, bridges, sightings, fused, progress, clock)
    late_s = delay_to_take_out(settled.fused.inertial)
    if late_s != 0.0:  # once more, the instruments read at the pictures' moments
        flight, flown = stamped_later(flight, late_s), stamped_later(flown, late_s)
        mapper = Mapper(camera, Sensors.at(flight, sightings.stamps_s, origin, config), config)
        bridges = Bridges(flight, mapper, sightings.links, config.inertial, progress)
        settled = _settled(flight, mapper, bridges, sightings, settled.fused, progress, clock)
    sightings, fused = settled.sightings, settled.fused
    mapped = Mapped(sightings, settled.edges, settled.solution, fused, odometry, without_loops, late_s)
    estimate = account(flight, config, mapper, mapped, clock.seconds)
    echoes = echoes_in_map(flown.sonar, sightings.stamps_s, fused.over_floor_T_b, fused.floor_z_m)
    return replace(estimate, elevation=echoes.map if echoes else None), sightings


@dataclass(frozen=True)
class _Settled:
    """A map in which what must overlap was compared."""

    sightings: Sightings
    edges: Edges
    solution: Solution
    fused: Fused


def _settled(
    flight: Flight,
    mapper: Mapper,
    bridges: Bridges,
    sightings: Sightings,
    fused: Fused,
    progress: Progress,
    clock: Stopwatch,
) -> _Settled:
    """Solved and refined once more, from what ``fused`` knows of the poses."""

    def step(iteration: int, _: float) -> None:
        progress("graph", iteration, 0)

    with clock("graph"):
        informed = mapper.knowing(fused.over_floor_T_b, fused.over_floor_covariances)
        # Footprints that overlap may be registered by a look-alike piece of floor beside the shared one.
        height_m = fused.over_floor_T_b[:, 2, 3] - fused.floor_z_m
        known = Known(fused.over_floor_T_b, fused.over_floor_covariances, fused.component, height_m)
        edges = informed.edges(sightings.registrations)
        sightings = sightings.without(informed.contradictions(edges, known))
        edges = informed.edges(sightings.registrations)
        solution = informed.solve(edges, step)
    with clock("refine"):
        readings = inertial_readings(flight.imu)
        fused = bridges.join(fuse(mapper, sightings, edges, solution, progress, readings))
    return _Settled(sightings, edges, solution, fused)


def _obstacles(
    flight: Flight, camera: Camera, sightings: Sightings, fused: Fused, config: PipelineConfig
) -> Obstacles | None:
    poses = np.where((fused.component == 0)[:, None, None], fused.over_floor_T_b, np.nan)
    return find_obstacles(flight, camera, sightings.stamps_s, poses, fused.floor_z_m, config.masking)


def _camera(flight: Flight) -> Camera:
    if flight.camera is None or flight.frames is None or len(flight.frames) == 0:
        raise InputError(f"{flight.name}: no camera in this flight, so no map; {NO_CAMERA}")
    return flight.camera


def _refuse_unless(joined: bool, flight: Flight, sightings: Sightings) -> None:
    if joined:
        return
    dropped = sightings.rejected + Counter(r.reason for r in sightings.refused)
    reasons = ", ".join(f"{count} x {reason}" for reason, count in dropped.most_common(3))
    usable, frames = len(sightings.stamps_s), sightings.frames
    what = (
        f"no two of {frames} pictures could be joined"
        if usable > 1
        else f"{usable} of {frames} pictures usable"
    )
    on_reading = next((line for line in flight.warnings if line.startswith("cam0:")), "nothing to compare")
    raise InputError(
        f"{flight.name}: {what} ({reasons or on_reading}); a map needs two pictures that overlap, "
        "of a floor with texture and light"
    )
