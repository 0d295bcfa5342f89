"""The post-flight job: a flight in, optimized keyframes out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from backend.pose_graph.heights import HeightEstimate
from backend.pose_graph.solution import Solution
from frontend.camera import Camera
from slam.core.arguments import check_flight
from slam.core.errors import NO_CAMERA, InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.heap import trim_heap
from slam.core.progress import Progress, silent
from slam.core.stage_timer import Stopwatch
from slam.mapping.account import Mapped, account, reason_kind
from slam.mapping.breaks import without_false_links
from slam.mapping.bridging import Bridges
from slam.mapping.clocks import delay_to_take_out, stamped_later
from slam.mapping.config import PipelineConfig
from slam.mapping.fusion import Fused, fuse
from slam.mapping.horizon import seeing_floor
from slam.mapping.lean import lean_of
from slam.mapping.mapper import Edges, Mapper, Sensors
from slam.mapping.mount import remounted
from slam.mapping.obstacles import Masks, Obstacles, echoes_in_map, find_obstacles, no_masks
from slam.mapping.reach import Known, implausible_edges
from slam.mapping.rolling import unrolled
from slam.mapping.sightings import Sighter, Sightings
from slam.mapping.synchronize import inertial_readings

MOST_PASSES = 2
"""Obstacles found in a first map, which they bend, may be misplaced; the second pass places them anew."""
LEAST_LEFT = 0.5
"""Of the share of keyframes in the map: where masks take more there is no floor to see beside them."""


def optimize(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> Estimate:
    """Trajectory, loops and covariances of a flight with a down-looking camera.

    Raises ``InputError`` where the flight has no camera or its pictures cannot be joined.
    """
    estimate = optimize_with_sightings(flight, config, progress)[0]
    trim_heap()
    return estimate


def optimize_with_sightings(
    flight: Flight, config: PipelineConfig = PipelineConfig(), progress: Progress = silent
) -> tuple[Estimate, Sightings]:
    """The same, and what the front end saw: features of the keyframes, registrations held and refused."""
    check_flight(flight)
    camera = _camera(flight)
    flight, job = seeing_floor(flight, camera), _Job(camera, config, progress, Stopwatch())
    # Threads of BLAS and of OpenCV would spin against each other for the same cores.
    with threadpool_limits(1, "blas"):
        obstacles, first = None, job.first_map(flight, no_masks)
        for _ in range(MOST_PASSES):
            found = job.obstacles(flight, first)
            if found is None or (obstacles is not None and not found.moved_from(obstacles)):
                break
            masked = job.without_obstacles(flight, found)
            if masked is None or masked.main_share < LEAST_LEFT * first.main_share:
                first = first.with_warning(found.torn)
                break
            obstacles, first = found, masked
        return job.final_map(flight, first)


@dataclass(frozen=True)
class _BackEnd:
    """The back end for one flight with its keyframes."""

    flight: Flight
    mapper: Mapper
    bridges: Bridges


@dataclass(frozen=True)
class _Chain:
    """Keyframe after keyframe, without loops."""

    sightings: Sightings
    heights: HeightEstimate
    solution: Solution


@dataclass(frozen=True)
class _FirstMap:
    """Refined once, with the loops that looks have found."""

    sighter: Sighter
    back_end: _BackEnd
    chain: _Chain
    sightings: Sightings
    fused: Fused

    @property
    def main_share(self) -> float:
        """Share of the keyframes that are in the largest part."""
        return float(np.mean(self.fused.component == 0))

    def with_warning(self, line: str) -> _FirstMap:
        """The same with one more line for the user."""
        return replace(self, back_end=replace(self.back_end, flight=self.back_end.flight.with_warning(line)))


@dataclass(frozen=True)
class _SettledMap:
    """Refined again, after all that must overlap was compared."""

    sightings: Sightings
    edges: Edges
    solution: Solution
    fused: Fused


@dataclass(frozen=True)
class _Job:
    """The stages of a map, in their order."""

    camera: Camera
    config: PipelineConfig
    progress: Progress
    clock: Stopwatch

    def first_map(self, flight: Flight, masks: Masks) -> _FirstMap:
        """Track, gate, retrieve, verify, solve, refine. Raises ``InputError`` where no two pictures join."""
        sighter = Sighter(flight, self.camera, self.config, self.progress)
        with self.clock("track"):
            sightings = sighter.watch(masks)
            if self.camera.readout_s > 0:
                sightings = unrolled(sightings, self.camera, flight.imu, sighter.register)
            _refuse_unless(len(sightings.stamps_s) >= 2, flight, sightings)
            back_end = self._back_end(flight, sightings)
            believed = without_false_links(sightings, back_end.bridges)
            if believed is not sightings:
                back_end = self._back_end(flight, believed)
            sightings = sighter.neighbours(believed)
        mapper = back_end.mapper
        chain = self._chain(mapper, sightings)
        with self.clock("loops"):
            sightings = sighter.retrieve(sightings, mapper.reach(chain.heights, chain.solution))
            _refuse_unless(len(sightings.registrations) > 0, flight, sightings)
            poses = back_end.bridges.chained(chain.solution)
            known = Known(poses.w_T_b, poses.covariances, poses.component, chain.heights.height_m)
            sightings = self._plausible(sightings, mapper, known)
        with self.clock("graph"):
            edges = mapper.edges(sightings.registrations)
            solution = mapper.solve(edges, self._step)
        with self.clock("refine"):
            fused = back_end.bridges.join(fuse(mapper, sightings, edges, solution, self.progress))
        if (fused.component < 0).all():
            raise InputError(
                f"{flight.name}: the pictures match, but no pose of a camera above a floor explains how; "
                "check T_BS (which way it looks) and intrinsics in cam0/sensor.yaml, and the attitude"
            )
        return _FirstMap(sighter, back_end, chain, sightings, fused)

    def obstacles(self, flight: Flight, first: _FirstMap) -> Obstacles | None:
        """What the sonar hears standing on the floor of the first map."""
        fused = first.fused
        poses = fused.of_main(fused.over_floor_T_b)
        return find_obstacles(
            flight, self.camera, first.sightings.stamps_s, poses, fused.floor_z_m, self.config.masking
        )

    def without_obstacles(self, flight: Flight, found: Obstacles) -> _FirstMap | None:
        """The first map anew with what was found masked; None where no pictures join any more."""
        try:
            return self.first_map(found.cleared(flight), found.masks)
        except InputError:
            return None

    def final_map(self, flight: Flight, first: _FirstMap) -> tuple[Estimate, Sightings]:
        """Compare what must overlap, refine, take out what clock and mount are off; ``flight`` is as it was
        flown."""
        back_end, chain, fused = first.back_end, first.chain, first.fused
        with self.clock("loops"):
            sightings = first.sighter.revisit(first.sightings, fused.over_floor_T_b, fused.floor_z_m)
        settled = self._settled(back_end, sightings, fused)
        late_s = delay_to_take_out(settled.fused.inertial)
        camera = self._remounted(back_end.flight, settled)
        if late_s != 0.0 or camera is not None:  # once more, by the pictures' clock and the mount as it is
            flight = stamped_later(flight, late_s)
            mended = replace(self, camera=camera or self.camera)
            back_end = mended._back_end(stamped_later(back_end.flight, late_s), sightings)
            chain = mended._chain(back_end.mapper, chain.sightings)
            settled = mended._settled(back_end, sightings, settled.fused)
        fused = settled.fused
        mapped = Mapped(
            settled.sightings, settled.edges, settled.solution, fused, chain.heights, chain.solution, late_s
        )
        estimate = account(back_end.flight, self.config, back_end.mapper, mapped, self.clock.seconds)
        echoes = echoes_in_map(flight.sonar, sightings.stamps_s, fused.over_floor_T_b, fused.floor_z_m)
        elevation = echoes.map if echoes else None
        return replace(estimate, elevation=elevation, metric=fused.metric), settled.sightings

    def _remounted(self, flight: Flight, settled: _SettledMap) -> Camera | None:
        if flight.parts:  # each has a level of its own
            return None
        lean = lean_of(flight, settled.sightings.stamps_s, settled.fused.of_main(settled.fused.w_T_b))
        return remounted(self.camera, lean, settled.fused.inertial)

    def _back_end(self, flight: Flight, sightings: Sightings) -> _BackEnd:
        sensors = Sensors.at(flight, sightings.stamps_s, flight.geo_origin(), self.config)
        mapper = Mapper(self.camera, sensors, self.config)
        bridges = Bridges(flight, mapper, sightings.links, self.config.inertial, self.progress)
        return _BackEnd(flight, mapper, bridges)

    def _chain(self, mapper: Mapper, sightings: Sightings) -> _Chain:
        with self.clock("graph"):
            edges = mapper.edges(sightings.registrations)
            return _Chain(sightings, edges.heights, mapper.solve(edges, self._step, covariances=True))

    def _settled(self, back_end: _BackEnd, sightings: Sightings, fused: Fused) -> _SettledMap:
        """Solved and refined once more, from what ``fused`` knows of the poses."""
        mapper, flight = back_end.mapper, back_end.flight
        with self.clock("loops"):
            informed = mapper.knowing(fused.over_floor_T_b, fused.over_floor_covariances)
            # Footprints that overlap may be registered by a look-alike piece of floor beside the shared one.
            height_m = fused.over_floor_T_b[:, 2, 3] - fused.floor_z_m
            known = Known(fused.over_floor_T_b, fused.over_floor_covariances, fused.component, height_m)
            sightings = self._plausible(sightings, informed, known)
        with self.clock("graph"):
            edges = informed.edges(sightings.registrations)
            solution = informed.solve(edges, self._step)
        with self.clock("refine"):
            readings = inertial_readings(flight.imu)
            fused = fuse(mapper, sightings, edges, solution, self.progress, readings)
            return _SettledMap(sightings, edges, solution, back_end.bridges.join(fused))

    def _plausible(self, sightings: Sightings, mapper: Mapper, known: Known) -> Sightings:
        """Without the pairs that lie where the poses known so far cannot have them."""
        edges = mapper.edges(sightings.registrations).at_heights(known.height_m)
        return sightings.without(implausible_edges(edges, known, self.config.loops))

    def _step(self, iteration: int, _: float) -> None:
        self.progress("graph", iteration, 0)


def _camera(flight: Flight) -> Camera:
    if flight.camera is None or flight.frames is None or len(flight.frames) == 0:
        why = flight.reason_not_read("cam0") or "no camera in this flight"
        raise InputError(f"{flight.name}: {why}, so no map; {NO_CAMERA}")
    return flight.camera


def _refuse_unless(joined: bool, flight: Flight, sightings: Sightings) -> None:
    if joined:
        return
    dropped = sightings.rejected + Counter(reason_kind(r.reason) for r in sightings.refused)
    reasons = ", ".join(f"{count} x {reason}" for reason, count in dropped.most_common(3))
    usable, frames = len(sightings.stamps_s), sightings.frames
    what = (
        f"no two of {frames} pictures could be joined"
        if usable > 1
        else f"{usable} of {frames} pictures usable"
    )
    on_reading = next((line for line in flight.warnings if line.startswith("cam0:")), "nothing to compare")
    if frames == 1:
        on_reading = f"there is one alone; {on_reading}"
    raise InputError(
        f"{flight.name}: {what} ({reasons or on_reading}); a map needs two pictures that overlap, "
        "of a floor with texture and light"
    )
