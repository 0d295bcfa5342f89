"""The main loop of a map: its stages in their order, and again where a map refutes what it was made with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from threadpoolctl import threadpool_limits

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.checkpoints import use_checkpoints
from frontend.camera import Camera
from slam.core.arguments import check_flight
from slam.core.checkpoints import Checkpoints
from slam.core.clock_steps import without_clock_steps
from slam.core.errors import NO_CAMERA, InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.heap import map_large_blocks
from slam.core.messages import Message
from slam.core.progress import Progress
from slam.core.repeated_readings import without_held_readings
from slam.core.stage_timer import Stopwatch
from slam.core.turn_units import in_radians
from slam.mapping.build_estimate import build_estimate, shared_errors
from slam.mapping.calibration.found_shutter import with_found_shutter
from slam.mapping.calibration.height_sensor import range_prior
from slam.mapping.calibration.refuted import FIXABLE, FreeCalibrations, ImplausibleFocal, with_fixed_focal
from slam.mapping.checkpoints.refinement import RefinementCheckpoints
from slam.mapping.config import PipelineConfig
from slam.mapping.context import Context, Job
from slam.mapping.floor_visibility import without_horizon_frames
from slam.mapping.free_refuted import free_refuted_calibrations
from slam.mapping.front_end import Observations
from slam.mapping.map import Map
from slam.mapping.obstacle_list import map_elevation, map_obstacles
from slam.mapping.obstacles import Obstacles, cleared_echoes, find_obstacles, no_masks
from slam.mapping.stages import (
    close_loops,
    hide,
    match_overlaps,
    odometry,
    refine,
    self_calibrate,
    solve_again,
    track,
    with_free_calibrations,
)
from slam.mapping.tracked_pictures import TrackedPictures

MOST_PASSES = 2
"""Obstacles bend the first map and are then misplaced in it; the second pass places them again. A rolling
shutter bends it too, so that a second pass measures the read-out time again."""
MOST_REFUTATIONS = len(FIXABLE)
"""A map with one free calibration may refute another one. Each becomes free once: a lens may be refuted
anew, or change its model to and fro."""
LEAST_LEFT = 0.5
"""Smallest share of the mapped keyframes that masks must leave: below it there is no floor to see."""


def map_flight(
    flight: Flight,
    config: PipelineConfig,
    progress: Progress,
    tracked: TrackedPictures | None,
    checkpoints: Checkpoints,
) -> tuple[Estimate, Observations]:
    """Return the estimate of a flight, and the observations that it was made of."""
    map_large_blocks()
    camera = _camera(flight)
    flight = without_horizon_frames(without_clock_steps(in_radians(without_held_readings(flight))), camera)
    job = Job(camera, config, progress, Stopwatch(), checkpoints)
    # Threads of BLAS and of OpenCV would compete for the same cores.
    with threadpool_limits(1, "blas"), use_checkpoints(RefinementCheckpoints(checkpoints)):
        finished = _with_refuted_free(_finished(job, flight, tracked), flight)
        finished = _without_implausible_focal(finished, flight)
        context, refined = finished.context, finished.refined
        estimate = build_estimate(context, refined, finished.shared, finished.untested)
        estimate = replace(
            estimate,
            elevation=map_elevation(refined, flight.sonar),
            obstacles=map_obstacles(refined, flight.sonar, config.masking),
            metric=refined.metric,
            rejected=estimate.rejected | cleared_echoes(flight.sonar, context.flight.sonar),
        )
        return estimate, refined.observations


@dataclass(frozen=True)
class _Finished:
    """A map with the errors that all its pictures share."""

    context: Context
    refined: Map
    shared: SystematicErrors | None
    untested: Sequence[Message]
    lens_is_suspect: bool
    """Whether a fixed lens may be wrong although ``shared`` has no error of it."""


def _finished(job: Job, flight: Flight, tracked: TrackedPictures | None = None) -> _Finished:
    context, matched, solved = _with_overlaps(job, flight, tracked)
    refined = refine(context, solved, with_inertia=True)
    context, refined = self_calibrate(context, matched, refined)
    return _Finished(context, refined, *shared_errors(refined, context.flight.gps))


def _with_overlaps(
    job: Job, flight: Flight, tracked: TrackedPictures | None
) -> tuple[Context, Observations, Map]:
    """Return the pictures with all pairs that overlap on a first map, and the graph of the plausible ones.

    The first map ends here: the system of its refinement is as large as that of the second.
    """
    context, first = _map_without_obstacles(job, flight, tracked)
    matched = match_overlaps(context, first)
    return context, matched.observations, solve_again(context, matched)


def _with_refuted_free(finished: _Finished, flight: Flight) -> _Finished:
    """Map the flight again where it refutes a calibration that is fixed: once for each of these
    at most."""
    for _ in range(MOST_REFUTATIONS):
        free = free_refuted_calibrations(
            finished.context, finished.refined, finished.shared, finished.lens_is_suspect
        )
        if free is None:
            break
        if free.changes_nothing(finished.context.job.camera):
            fixed = replace(finished.context, reason_still_fixed=free.reason, doubted_lens=free.doubted_lens)
            return replace(finished, context=fixed)
        again = _again(finished, flight, free)
        if again is None:
            return replace(finished, context=replace(finished.context, still_fixed=free.refuted))
        finished = again
    return finished


def _without_implausible_focal(finished: _Finished, flight: Flight) -> _Finished:
    """Warn of an implausible focal length that a map has estimated, and map again with the stated one where
    it is better.
    """
    context, refined = finished.context, finished.refined
    implausible = ImplausibleFocal.of(context.job.camera, refined)
    if implausible is None:
        return finished
    reason, ranges = context.reason_still_fixed, range_prior(context.flight)
    camera = with_fixed_focal(context.job.camera)
    fixed = FreeCalibrations(camera, context.flight.gps, ranges, reason=reason)
    again = None if implausible.is_believed else _again(finished, flight, fixed)
    found = again or finished
    return replace(
        found, context=replace(found.context, doubted_lens=implausible.warning(used=again is None))
    )


def _again(first: _Finished, flight: Flight, free: FreeCalibrations) -> _Finished | None:
    """Return the map with free calibrations; None where no map comes out of it.

    The pictures are rectified anew for another lens: features that the old one made move are found again.
    """
    job = first.context.job
    try:
        if free.camera is job.camera:
            context, refined = with_free_calibrations(first.context, first.refined, free)
            again = _Finished(context, refined, *shared_errors(refined, context.flight.gps))
        else:
            again = _finished(replace(job, camera=free.camera), free.of(flight))
    except InputError:  # no pictures join with this lens
        return None
    if again.refined.main_share < LEAST_LEFT * first.refined.main_share:
        return None
    refuted = (*first.context.refuted, *free.refuted)
    return replace(again, context=replace(again.context, refuted=refuted, reason_still_fixed=free.reason))


def _map_without_obstacles(job: Job, flight: Flight, tracked: TrackedPictures | None) -> tuple[Context, Map]:
    """Map the flight, mask the obstacles that the sonar finds on this map, and map it again."""
    masked: Obstacles | None = None
    context, refined = _with_shutter(*_first_map(*track(job, flight, no_masks, tracked=tracked)), flight)
    job, unmasked = context.job, context
    for _ in range(MOST_PASSES):
        poses, stamps_s = refined.of_main(refined.over_floor_T_b), refined.observations.stamps_s
        found = find_obstacles(flight, job.camera, stamps_s, poses, refined.floor_z_m, job.config.masking)
        if found is None or (masked is not None and not found.moved_from(masked)):
            break
        try:
            again, remapped = _first_map(*_masked(unmasked, flight, found))
        except InputError:  # no pictures join with these masks
            return context.with_warning(found.unusable_masks_warning), refined
        if remapped.main_share < LEAST_LEFT * refined.main_share:
            return context.with_warning(found.unusable_masks_warning), refined
        masked, context, refined = found, again, remapped
    return context, refined


def _with_shutter(context: Context, refined: Map, flight: Flight) -> tuple[Context, Map]:
    """Map the flight again with the read-out time that the first map has found, where it is a video.

    Its features and its stamps then belong to the middle rows. The pictures are not tracked again.
    """
    if flight.all_keyframes:
        return context, refined
    for _ in range(MOST_PASSES):
        camera = with_found_shutter(context.job.camera, refined)
        if camera is None:
            break
        job = replace(context.job, camera=camera)
        try:
            context, refined = _first_map(*track(job, flight, no_masks, tracked=context.front_end.tracked))
        except InputError:  # no pictures join with these rows
            break
    return context, refined


def _masked(unmasked: Context, flight: Flight, found: Obstacles) -> tuple[Context, Observations]:
    """Take what the masks hide out of the pictures that were tracked without masks, or track them again."""
    hidden = hide(unmasked, found)
    return hidden or track(unmasked.job, found.cleared(flight), found.masks, unmasked.front_end.work)


def _first_map(context: Context, observations: Observations) -> tuple[Context, Map]:
    return context, refine(context, close_loops(context, odometry(context, observations)))


def _camera(flight: Flight) -> Camera:
    check_flight(flight)
    if flight.camera is None or flight.frames is None or len(flight.frames) == 0:
        why = flight.reason_not_read("cam0") or "no camera in this flight"
        raise InputError(f"{flight.name}: {why}, so no map; {NO_CAMERA}")
    return flight.camera
