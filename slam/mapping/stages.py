"""The stages of a map in their order. Each takes the context and a map, and returns a new map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from backend.clocks.picture_clock import PictureClock
from backend.significance import SURE_SIGMAS
from frontend.camera import Camera
from frontend.views import Masks
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.heap import large_blocks_kept
from slam.core.imu_at_rest import gravity_reading
from slam.core.instrument_readings import inertial_readings
from slam.core.progress import show_compilation
from slam.mapping.calibration.attitude_floor_tilt import tilt_over_map
from slam.mapping.calibration.camera_mount import estimated_mount
from slam.mapping.calibration.clock_offset import clock_correction, finer_correction
from slam.mapping.calibration.instrument_clocks import on_one_clock
from slam.mapping.calibration.picture_turns import tracked_clock
from slam.mapping.calibration.refuted import FreeCalibrations
from slam.mapping.calibration.rolling_shutter import with_row_motion
from slam.mapping.context import Context, Job
from slam.mapping.contradicted_odometry import contradicted_step, without_step
from slam.mapping.earlier_pass import EarlierPass
from slam.mapping.floor_doubts import floor_doubts
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.hidden_features import without_hidden
from slam.mapping.inertial.fusion import fuse_parts
from slam.mapping.inertial.measurements import inertial_measurements, reported_motion
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.lift_edges import lift_edges
from slam.mapping.line_loops import close_over_lines
from slam.mapping.map import Map, largest_first
from slam.mapping.obstacles import Obstacles
from slam.mapping.refine import refine_map
from slam.mapping.search_radius import KnownPoses, implausible_edges, search_radius
from slam.mapping.setup import Setup
from slam.mapping.solve_pose_graph import solve_pose_graph
from slam.mapping.tracked_pictures import TrackedPictures
from slam.mapping.tracking_gaps import without_false_links


def track(
    job: Job,
    flight: Flight,
    masks: Masks,
    earlier: EarlierPass | None = None,
    tracked: TrackedPictures | None = None,
) -> tuple[Context, Observations]:
    """Track the pictures, select keyframes, and register each to its neighbours.

    ``earlier``: work on the same pictures without masks. ``tracked``: pictures that are tracked already.
    Raises ``InputError`` where fewer than two pictures are usable.
    """
    front_end = FrontEnd(flight, job.camera, job.config, job.progress, earlier, masks, job.checkpoints)
    with job.timer("track"), large_blocks_kept():
        observations = front_end.observations(tracked) if tracked else _tracked(front_end)
        recorded, found = flight, _tracked_clock(flight, job, observations)
        flight = on_one_clock(recorded, found)
        if flight.imu is not recorded.imu:
            found = _tracked_clock(flight, job, observations)
        clock = clock_correction(found, observations.stamps_s)
        observations = observations.stamped_by(clock.delays_at)
        if not flight.all_keyframes:
            observations = with_row_motion(observations, job.camera, flight.imu, front_end.register)
        _refuse_unless(len(observations.stamps_s) >= 2, flight, observations)
        return _with_neighbours(Context.of(flight, job, front_end, observations), observations, clock)


def _tracked(front_end: FrontEnd) -> Observations:
    """Track the pictures, and again by the instruments if only these tell the floor's motion.

    Pictures that came in flight are not tracked again: not all of them may be there any more.
    """
    observations = front_end.track()
    if front_end.flight.all_keyframes:
        return observations
    doubts = floor_doubts(observations, front_end)
    if not doubts.are_open or SURE_SIGMAS * front_end.views.step_std_px > doubts.sure_px:
        return observations
    return front_end.track_by_instruments()


def hide(context: Context, found: Obstacles) -> tuple[Context, Observations] | None:
    """Leave out of the tracked keyframes what the masks of obstacles hide, and register them again.

    The result is None where the pictures must be tracked again with these masks.
    """
    job, flight = context.job, found.cleared(context.flight)
    earlier = context.front_end.work
    front_end = FrontEnd(flight, job.camera, job.config, job.progress, earlier, found.masks, job.checkpoints)
    with job.timer("track"), large_blocks_kept():
        assert context.tracked is not None
        observations = without_hidden(context.tracked, front_end, found.masks)
        if observations is None:
            return None
        return _with_neighbours(Context.of(flight, job, front_end, observations), observations, context.clock)


def _with_neighbours(
    context: Context, tracked: Observations, clock: PictureClock
) -> tuple[Context, Observations]:
    """Register each keyframe to its neighbours, after the links are gone that the instruments contradict."""
    checked = without_false_links(tracked, context.bridges)
    if checked is not tracked:
        context = Context.of(context.flight, context.job, context.front_end, checked)
    return replace(context, clock=clock, tracked=tracked), context.front_end.neighbours(checked)


def odometry(context: Context, observations: Observations) -> Map:
    """Solve the graph of neighbouring keyframes."""
    with context.timer("graph"):
        return _solved(observations, context.setup, context.on_step, covariances=True)


def close_loops(context: Context, chain: Map) -> Map:
    """Register keyframes that look alike and lie within reach, and solve the graph with the plausible ones.

    Raises ``InputError`` where no two pictures match.
    """
    setup, heights = context.setup, chain.edges.heights
    with context.timer("loops"), large_blocks_kept():
        radius = search_radius(setup, heights, chain.graph)
        observations = context.front_end.close_loops(chain.observations, radius)
        _refuse_unless(len(observations.registrations) > 0, context.flight, observations)
        chain, observations = _without_contradicted_steps(context, chain, observations)
        observations = _plausible(observations, setup, chain.known_poses())
        bridged = chain if context.flight.gps is not None else context.bridges.join_for_checks(chain)
        if bridged is not chain:
            # Not at once: all behind a bridge have its error in common, which would hide a false pair there.
            observations = _plausible(observations, setup, bridged.known_poses())
    with context.timer("graph"):
        return replace(_solved(observations, setup, context.on_step), odometry=chain)


def refine(context: Context, solved: Map, with_inertia: bool = False) -> Map:
    """Refine all parts on their floor points, and join them by inertial bridges.

    With inertia, the readings of the IMU and the motion that the vehicle reports then refine joined parts
    together.

    Over floors of lines they always do, because the pictures leave directions open.

    Raises ``InputError`` where no pose of a camera above a floor explains the matches.
    """
    flight, is_first = context.flight, not with_inertia
    with_inertia = with_inertia or any(r.by_lines for r in solved.kept_registrations)
    inertial = inertial_readings(flight.imu) if with_inertia else None
    reported = reported_motion(flight, context.job.config) if with_inertia else None
    with context.timer("refine"), show_compilation(context.job.progress):
        gravity = gravity_reading(flight.imu) if with_inertia and flight.imu is not None else None
        parts = refine_map(solved, context.setup, context.job.progress, inertial, reported, gravity)
        refined = context.bridges.join(parts)
        if with_inertia:
            measured = inertial_measurements(flight.imu, context.job.config)
            refined = fuse_parts(parts, refined, context.setup, measured, reported)
    if (refined.component < 0).all() and is_first:
        raise InputError(
            f"{flight.name}: the pictures match, but no pose of a camera above a floor explains how; "
            f"check T_BS (which way it looks) and intrinsics in {flight.camera_file}, and attitude0"
        )
    return refined


def match_overlaps(context: Context, refined: Map) -> Map:
    """Register all keyframes whose footprints overlap according to the refined poses, by their features or by
    the lines that they show."""
    with context.timer("loops"), large_blocks_kept():
        observations = context.front_end.match_overlaps(
            refined.observations, refined.over_floor_T_b, refined.floor_z_m, refined.world
        )
        observations = close_over_lines(context.front_end, observations, refined)
    return replace(refined, observations=observations)


def solve_again(context: Context, matched: Map) -> Map:
    """Solve the graph with the refined tilts, without edges that the refined poses contradict."""
    known = matched.known_poses()
    with context.timer("loops"):
        tilted = context.setup.with_tilts(known.w_T_b, matched.over_floor_covariances)
        # Overlapping footprints may match a look-alike piece of floor beside the common one.
        observations = _plausible(matched.observations, tilted, known)
    with context.timer("graph"):
        return replace(_solved(observations, tilted, context.on_step), odometry=matched.odometry)


def self_calibrate(context: Context, matched: Observations, refined: Map) -> tuple[Context, Map]:
    """Correct clock offset and camera mount where the flight determines them, and refine once more.

    ``matched``: all pairs that overlap, those too that the first map contradicts.
    """
    clock = finer_correction(refined.clock, context.clock, matched.stamps_s)
    camera = _estimated_mount(context, refined)
    if clock is context.clock and camera is None:
        return context, refined
    chain = refined.odometry or refined
    observations = matched.stamped_by(clock.delays_at)
    context = context.calibrated(clock, camera or context.job.camera, observations)
    chain = odometry(context, chain.observations.stamped_by(clock.delays_at))
    again = solve_again(context, replace(refined, observations=observations, odometry=chain))
    return context, refine(context, again, with_inertia=True)


def with_free_calibrations(context: Context, refined: Map, free: FreeCalibrations) -> tuple[Context, Map]:
    """Solve and refine once more with free calibrations, where the lens is as it was."""
    context = context.with_flight(free.of(context.flight), refined.observations)
    return context, refine(context, solve_again(context, refined), with_inertia=True)


def _estimated_mount(context: Context, refined: Map) -> Camera | None:
    if context.flight.parts:  # each has a level of its own
        return None
    tilt = tilt_over_map(context.flight, refined)
    return estimated_mount(context.job.camera, tilt, refined.inertial)


def _tracked_clock(flight: Flight, job: Job, observations: Observations) -> PictureClock | None:
    readings = KeyframeReadings.at(flight, observations.stamps_s, None, job.config)
    return tracked_clock(flight, observations, Setup(job.camera, readings, job.config))


def _solved(
    observations: Observations,
    setup: Setup,
    on_step: Callable[[int, float], None],
    covariances: bool = False,
) -> Map:
    edges = lift_edges(observations.registrations, setup)
    graph = solve_pose_graph(edges, setup, on_step, covariances)
    component = largest_first(graph.component)
    n = len(graph.w_T_b)
    known = np.full((n, 6, 6), np.nan) if graph.covariances is None else graph.covariances
    return Map(
        observations=observations,
        edges=edges,
        graph=graph,
        w_T_b=graph.w_T_b,
        covariances=known,
        over_floor_covariances=known,
        component=component,
        camera=setup.camera,
        metric=bool(edges.heights.metric.all()),
        height_std_m=(0.0,) * (int(component.max(initial=-1)) + 1),
    )


def _without_contradicted_steps(
    context: Context, chain: Map, found: Observations
) -> tuple[Map, Observations]:
    """Return chain and ``found`` pairs without the odometry that more pairs contradict than it has links."""
    while True:
        edges = lift_edges(found.registrations, context.setup).at_heights(chain.height_m)
        step = contradicted_step(context.front_end, chain, found, edges)
        if step is None:
            return chain, found
        found = without_step(found, chain, step)
        if not step.left_out:
            return chain, found
        chain = odometry(context, without_step(chain.observations, chain, step))


def _plausible(observations: Observations, setup: Setup, known: KnownPoses) -> Observations:
    """Drop the pairs that lie where the known poses exclude them."""
    edges = lift_edges(observations.registrations, setup).at_heights(known.height_m)
    return observations.without(implausible_edges(edges, known, setup.config.loops))


def _refuse_unless(joined: bool, flight: Flight, observations: Observations) -> None:
    if joined:
        return
    dropped = observations.rejected + Counter(r.reason.kind for r in observations.refused if r.reason)
    reasons = ", ".join(f"{count} x {reason}" for reason, count in dropped.most_common(3))
    usable, frames = len(observations.stamps_s), observations.frames
    what = (
        f"no two of {frames} pictures could be joined"
        if usable > 1
        else f"{usable} of {frames} pictures usable"
    )
    on_reading = next((m.text for m in flight.messages if m.about == "cam0"), "nothing to compare")
    if frames == 1:
        on_reading = f"there is one alone; {on_reading}"
    raise InputError(
        f"{flight.name}: {what} ({reasons or on_reading}); a map needs two pictures that overlap, "
        "of a floor with texture and light"
    )
