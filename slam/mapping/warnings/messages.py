"""The status and the warnings of a finished map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.ground_below import fit_ground_below
from backend.wording import counted, either
from slam.core.clock_steps import clock_step_left
from slam.core.flight import Flight
from slam.core.flight_info import anomalies, fix_anomalies
from slam.core.instrument_errors import MountTilt
from slam.core.lost_pictures import NOTABLE_SHARE
from slam.core.messages import Kind, Message, joined, note, parsed, warning
from slam.core.missing_streams import missing_for_map
from slam.core.names import listed
from slam.core.stream_anomalies import camera_anomalies, imu_axis_anomalies, stuck_ranges
from slam.mapping.calibration.antenna import antenna_place
from slam.mapping.calibration.attitude_floor_tilt import (
    AttitudeFloorTilt,
    attitude_floor_tilt_warning,
    tilt_over_map,
)
from slam.mapping.calibration.camera_mount import mount_warning
from slam.mapping.calibration.clock_offset import (
    clock_contradiction,
    clock_warning,
    disagreement_warning,
)
from slam.mapping.calibration.found_shutter import refuted_shutter_warning
from slam.mapping.calibration.picture_turns import disagreements_left
from slam.mapping.context import Context
from slam.mapping.floor_doubts import floor_doubts
from slam.mapping.front_end import Observations
from slam.mapping.map import Map
from slam.mapping.obstacles import MOST_STANDING, echoes_in_map, range_contradiction
from slam.mapping.warnings.accuracy_basis import Shares, scale_warning, vague_lengths_warning
from slam.mapping.warnings.contradicted_steps import contradicted_step_warnings
from slam.mapping.warnings.control_points import control_warnings
from slam.mapping.warnings.floor_doubts import floor_doubt_messages
from slam.mapping.warnings.gps_offset import offset_remarks
from slam.mapping.warnings.gravity_reading import GravityLine, gravity_line
from slam.mapping.warnings.lean import lean_warning
from slam.mapping.warnings.lines_alone import lines_alone_warning
from slam.mapping.warnings.lost_pictures import lost_picture_warnings
from slam.mapping.warnings.motions import KeyframeSteps
from slam.mapping.warnings.not_placed import ALONE, not_placed_warnings
from slam.mapping.warnings.one_place import one_place_warning
from slam.mapping.warnings.parts import parts_warning
from slam.mapping.warnings.refuted_ranges import refuted_ranges_warning
from slam.mapping.warnings.rolling_ground import rolling_ground_warning
from slam.mapping.warnings.single_join import single_join_warnings
from slam.mapping.warnings.slope_by_attitude import slope_by_attitude_warning
from slam.mapping.warnings.systematic_warning import (
    explains,
    is_outside_covariances,
    refuted_antenna_warning,
    refuted_lens_warning,
    stated_lens_warning,
    systematic_warning,
)
from slam.mapping.warnings.unknown_focal import unknown_focal_warning
from slam.mapping.warnings.wrong_moments import motion_warnings

MOST_STUCK = 0.5
"""Share of equal ranges from which on even a robust estimate of the height follows them."""


def messages(
    context: Context,
    map_: Map,
    not_placed: dict[str, str],
    shared: SystematicErrors | None,
    mount: MountTilt | None,
    shares: Shares,
    untested: Sequence[Message | None],
) -> tuple[Message, ...]:
    """Return the messages of a map: the reasons of its status, other warnings, and notes.

    Takes the pictures ``not_placed`` with their reasons, the errors that all pictures share, the camera's
    tilt, the shares of the instruments, and lines about tests that were not possible and on the velocity.
    """
    flight, observations = context.flight, map_.observations
    tilt, systematic = tilt_over_map(context.flight, map_), _systematic_warning(context, map_, shared)
    gravity = gravity_line(context, map_)
    reasons = _reasons(context, map_, not_placed, shared, systematic, tilt, shares)
    doubts = floor_doubts(observations, context.front_end)
    return joined(
        *reasons,
        *flight.messages,
        *judged_anomalies(context, map_, gravity),
        *missing_for_map(flight),
        *not_placed_warnings(not_placed),
        *lost_picture_warnings(flight, observations),
        *floor_doubt_messages(doubts, map_, flight.gps),
        *(_moving(observations, shared) if doubts.is_floor_known else ()),
        _tilt_warning(map_, tilt),
        mount_warning(mount, flight.camera_file),
        clock_warning(map_.clock, context.clock),
        _refuted_antenna(context, map_),
        systematic,
        *untested,
        *map_.remarks,
        *(offset_remarks(map_.control) if map_.control is not None else ()),
        *_graph_lines(map_),
    )


def judged_anomalies(context: Context, map_: Map, gravity: GravityLine | None) -> Iterator[Message]:
    """Yield the anomalies of the streams: judged by the map, and as notes where it has dealt with them."""
    flight = context.flight
    check, dealt_with = flight.fix_check(), list[Message]()
    if check is not None and flight.gps is not None:
        names = flight.picture_names(flight.gps.stamps_s)
        suspect = {names[k] for k in np.flatnonzero(~check.consistent).tolist()}
        dealt_with = fix_anomalies(flight) if suspect <= set(map_.fixes_left_out) else []
    for line in anomalies(flight):
        if gravity is not None and line == gravity.raw:
            yield gravity.judged
        else:
            yield line.as_note() if line in dealt_with else line


def _graph_lines(map_: Map) -> list[Message]:
    """Return the warnings of the pose graph that concern the refined map.

    The refinement measures the scatter of its own observations, so that its covariances stand although the
    edges of the pose graph before it contradict theirs.
    """
    solution = map_.graph
    if map_.bundle is None or not solution.contradictions:
        return [*map(parsed, (*solution.warnings, *solution.contradictions))]
    scatter = note(
        "pairs of pictures fit each other less exactly than was first assumed",
        "the accuracy of this map counts that: the refinement of all pictures together has measured how "
        "exactly they fit",
    )
    return [*map(parsed, solution.warnings), scatter]


def _reasons(
    context: Context,
    map_: Map,
    not_placed: dict[str, str],
    shared: SystematicErrors | None,
    systematic: Message | None,
    tilt: AttitudeFloorTilt | None,
    shares: Shares,
) -> list[Message]:
    """Return the reasons why a map may be wrong beyond its covariances."""
    flight = context.flight
    metric = bool(map_.edges.heights.metric[map_.component >= 0].all())
    by_metres = metric or map_.georeferenced
    antenna = _refuted_antenna(context, map_)
    lines: list[Message | None] = [
        _refuted_lens(context, map_),
        refuted_shutter_warning(map_.bundle, flight.camera_file),
        antenna if _antenna_is_stated(flight) else None,
        # First, because instruments contradict a map that a lens has bent.
        systematic if systematic is not None and systematic.kind is Kind.REASON else None,
        _refuted_ranges(context, map_),
        *(refuted.still_fixed_warning for refuted in context.still_fixed),
        *map_.no_scale,
        *map_.warnings,
        *(control_warnings(map_.control) if map_.control is not None else ()),
        *(bridge.warning for bridge in map_.bridges),
        lines_alone_warning(map_),
        unknown_focal_warning(flight, map_),
        *map(parsed, map_.graph.disputed_odometry),
        *contradicted_step_warnings(flight, map_),
        *(
            found.warning
            for found in map_.stated_accuracy
            if systematic is None or not explains(shared, found)
        ),
        *(camera_anomalies(flight.camera) if flight.camera is not None else ()),
        *(imu_axis_anomalies(flight.imu) if flight.imu is not None else ()),
        _tilt_warning(map_, tilt) if tilt is not None and tilt.is_too_large else None,
        slope_by_attitude_warning(map_),
        rolling_ground_warning(map_, shares),
        lean_warning(flight, map_, tilt),
        _stuck_ranges(flight, map_) or _range_contradiction(context, map_),
        *_motion_warnings(flight, map_, by_metres),
        clock_contradiction(map_.clock, context.clock)
        or disagreement_warning(disagreements_left(flight, map_.observations, context.setup)),
        clock_step_left(flight),
        one_place_warning(flight, map_, context.setup.config.keyframes.min_overlap, by_metres),
        *single_join_warnings(flight, map_, context.bridges.join(map_.odometry or map_).component),
        parts_warning(flight, map_),
        *_placement_warnings(map_, not_placed),
        vague_lengths_warning(map_) if by_metres else scale_warning(flight, map_, shares),
    ]
    return [line.as_reason() for line in lines if line]


def _motion_warnings(flight: Flight, map_: Map, metric: bool) -> list[Message]:
    """Report instruments that contradict the map's motion, all the time or in single steps."""
    if flight.frames is None:
        return []
    steps = KeyframeSteps.of(flight, map_.observations.stamps_s, map_.of_main(map_.w_T_b), metric)
    names = flight.picture_names(flight.frames.stamps_s[map_.observations.frame_index])
    return motion_warnings(steps, names)


def _placement_warnings(map_: Map, not_placed: dict[str, str]) -> list[Message]:
    """Report keyframes that are on no part, and keyframes of unknown uncertainty."""
    lines = []
    lost = [name for name, reason in not_placed.items() if reason == ALONE]
    if lost:
        lines.append(
            warning(
                f"{counted(len(lost), 'keyframe')} {ALONE}: not on the map ({listed(lost)})",
                f"look at {either(len(lost), 'it', 'them')}: fly slower or with more overlap if you need "
                "that ground, and leave pictures of water or of another place out",
            )
        )
    vague = int(((map_.component >= 0) & ~np.isfinite(map_.covariances).all(axis=(1, 2))).sum())
    if vague:
        lines.append(
            warning(
                f"no uncertainty is known for {counted(vague, 'keyframe: it', 'keyframes: they')} could "
                f"not be refined, or the measurements do not determine {either(vague, 'it', 'them')}",
                "do not measure there",
            )
        )
    return lines


def _moving(observations: Observations, shared: SystematicErrors | None) -> list[Message]:
    """Report objects that move by themselves, if there are more than by chance."""
    if len(observations.moving) <= NOTABLE_SHARE * observations.frames:
        return []
    pictures = f"in {len(observations.moving)} of {observations.frames} pictures"
    if shared is not None and is_outside_covariances(shared) and "radial" in shared.coefficients:
        return [
            warning(
                f"{pictures} some features do not move as the others do, which a lens distortion explains "
                "as well as moving things",
                "they are left out of the map",
                "calibrate the camera if nothing moved",
            )
        ]
    return [
        note(
            f"{pictures} something moves by itself, or the pattern of the floor repeats",
            "features on it are left out of the map, which is right but for that ground, where the mosaic "
            "may show things cut or twice",
        )
    ]


def _tilt_warning(map_: Map, tilt: AttitudeFloorTilt | None) -> Message | None:
    """Return the warning of a tilt against the floor; none where positions determine the slope."""
    return None if map_.georeferenced else attitude_floor_tilt_warning(tilt)


def _range_contradiction(context: Context, map_: Map) -> Message | None:
    """Report ranges that contradict the map whose scale rests on them."""
    if map_.bundle is None or map_.bundle.range_errors is None:
        return None
    config, optimum = context.job.config.masking, map_.bundle.optimum
    fits = fit_ground_below(optimum.problem, optimum.values, config.gamma_3_m, 1.0 - MOST_STANDING)
    stamps_s, poses = map_.observations.stamps_s, map_.of_main(map_.over_floor_T_b)
    echoes = echoes_in_map(context.flight.sonar, stamps_s, poses, map_.floor_z_m)
    return None if echoes is None else range_contradiction(echoes, config, fits)


def _stuck_ranges(flight: Flight, map_: Map) -> Message | None:
    """Report a stuck height sensor that the scale of the map rests on."""
    if flight.sonar is None or map_.bundle is None or map_.bundle.range_errors is None:
        return None
    return stuck_ranges(flight.sonar, MOST_STUCK)


def _refuted_lens(context: Context, map_: Map) -> Message | None:
    """Report a declared lens that the map refutes: it has an estimated one instead, or keeps it."""
    refuted, flight, height_m = context.refuted_lens, context.flight, _main_height_m(map_)
    if refuted is None or context.doubted_lens:
        return context.doubted_lens
    assert flight.camera is not None
    if refuted.errors is None:
        return stated_lens_warning(flight.camera, map_, flight.camera_file)
    return refuted_lens_warning(
        refuted.errors, flight.camera, map_.camera, height_m, map_.metric, flight.camera_file
    )


def _refuted_antenna(context: Context, map_: Map) -> Message | None:
    """Report an antenna in whose stated or assumed place the map has an estimated one."""
    place = antenna_place(map_.bundle)
    errors = next((refuted.errors for refuted in context.refuted if refuted.what == "antenna"), None)
    if errors is None or place is None:
        return None
    stated = _antenna_is_stated(context.flight)
    return refuted_antenna_warning(errors, place, map_.camera, _main_height_m(map_), stated)


def _refuted_ranges(context: Context, map_: Map) -> Message | None:
    """Report a stated gain or zero of the height sensor in whose place the map has an estimated one."""
    stated = next((each.stated_ranges for each in context.refuted if each.stated_ranges is not None), None)
    found = map_.bundle.range_errors if map_.bundle is not None else None
    if stated is None or map_.bundle is None or found is None:
        return None
    return refuted_ranges_warning(stated, found, map_.bundle.scale_std)


def _antenna_is_stated(flight: Flight) -> bool:
    """Return whether a place of the antenna is stated, so that a map may not contradict it without a word in
    the status; the body's origin is assumed."""
    return flight.gps is not None and not flight.gps.antenna_assumed


def _main_height_m(map_: Map) -> float:
    return float(np.nanmedian(map_.height_m[map_.component == 0]))


def _systematic_warning(context: Context, map_: Map, shared: SystematicErrors | None) -> Message | None:
    """Return the warning about errors that all pictures share, with the accuracies that these contradict."""
    flight = context.flight
    line = systematic_warning(shared, map_.camera, _main_height_m(map_), map_.metric, flight.camera_file)
    if not line:
        return None
    reason = context.reason_still_fixed
    antenna = () if reason is None else reason.prefixed("the antenna's place is held, because").clauses
    contradicted = [f"{c.differs} for this reason" for c in map_.stated_accuracy if explains(shared, c)]
    line = line.extended(*antenna, *contradicted)
    return line.as_reason() if contradicted or is_outside_covariances(shared) else line
