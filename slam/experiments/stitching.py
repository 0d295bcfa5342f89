"""Maps of one flight made with several methods, and their landmark errors.

The paper's method composes the homographies of consecutive pictures (section 3.1). Its computer took 150 ms
for a picture, which limits how many of the 15 pictures a second it used. The paper's second method places
each picture where a Kalman filter has the vehicle (section 3.1.2). Our methods compose the homographies of
keyframes, or solve the pose graph.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.keyframes import KeyframeConfig
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import Frames
from slam.evaluation.aligned_maps import aligned_maps
from slam.evaluation.association import associate
from slam.evaluation.landmarks import landmark_places, landmark_table
from slam.inertial.filter_chain import filter_chain
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.homography_chain import chain

Array = NDArray[np.float64]

PICTURE_S = 0.150
"""Time that the paper's computer took for one picture."""
LARGEST = "largest"
_EVERY_PICTURE = PipelineConfig(keyframes=KeyframeConfig(min_overlap=2.0))
"""No pair overlaps by this much: each registered picture becomes a keyframe, a failed one is dropped."""


@dataclass(frozen=True)
class LandmarkErrors:
    """Landmark errors of one map, as in the paper's tables."""

    error_m: dict[str, float]
    """Pair -> absolute error of its distance; NaN where one of the two is not on the map."""
    percent: dict[str, float]
    """Errors in percent of the true distance; with ``largest``, NaN where any is."""
    places: dict[str, Array]
    """Position (3,) of each landmark on the map, with the first pose and heading on the truth's."""


def consecutive(flight: Flight, estimate: Estimate) -> Estimate:
    """Make the paper's map: pictures at its computer's rate, each registered to the previous one.

    The first picture's attitude and height are those of ``estimate``, so that only the stitching differs. A
    picture whose registration fails is dropped; where too many in a row fail, the rest is NaN.
    """
    assert flight.camera is not None
    taken = at_pace(flight, PICTURE_S)
    observations = every_picture(taken)
    n = len(observations.stamps_s)
    roll_pitch = roll_pitch_yaw_of(estimate.over_floor_T_b[0, :3, :3])[:2]
    height_m = estimate.over_floor_T_b[0, 2, 3] - estimate.floor_z_m
    tilt = np.tile(roll_pitch, (n, 1))
    poses = chain(observations.links, flight.camera, tilt, np.full(n, height_m))
    assert taken.frames is not None
    names = tuple(taken.frames.names[k] for k in observations.frame_index)
    return placed(
        replace(
            estimate,
            stamps_s=observations.stamps_s,
            frame_names=names,
            frame_index=_numbers(flight, taken)[observations.frame_index],
            floor_z_m=0.0,
        ),
        poses,
    )


def every_picture(flight: Flight) -> Observations:
    """Register each picture to the one before it."""
    assert flight.camera is not None
    return FrontEnd(flight, flight.camera, _EVERY_PICTURE, silent).track()


def filtered(flight: Flight, estimate: Estimate, inertial_alone: bool = False) -> Estimate:
    """Make the paper's map with inertia (section 3.1.2): each picture at the Kalman filter's pose.

    The filter uses the readings of all instruments except the camera until then; ``inertial_alone``: only
    acceleration and attitude as in the paper, and the sonar's height, which every map here has. Pictures
    from before or after its time range are left out.
    """
    if inertial_alone:
        flight = replace(flight, velocity=None, gps=None)
    assert flight.frames is not None
    taken = at_pace(flight, PICTURE_S)
    numbers = _numbers(flight, taken)
    poses = filter_chain(flight, flight.frames.stamps_s[numbers])
    known = np.isfinite(poses).all(axis=(1, 2))
    numbers, poses = numbers[known], poses[known]
    stamps_s = flight.frames.stamps_s[numbers]
    names = tuple(flight.frames.names[k] for k in numbers)
    seen = replace(estimate, stamps_s=stamps_s, frame_names=names, frame_index=numbers, floor_z_m=0.0)
    return placed(seen, poses)


def placed(estimate: Estimate, w_T_b: Array) -> Estimate:
    """Return an estimate with its keyframes at ``w_T_b`` (n, 4, 4) over a level floor, and all else
    unknown."""
    n = len(w_T_b)
    known = np.isfinite(w_T_b).all(axis=(1, 2))
    return replace(
        estimate,
        w_T_b=w_T_b,
        chain_w_T_b=w_T_b,
        odometry_w_T_b=w_T_b,
        covariances=np.full((n, 6, 6), np.nan),
        over_floor_covariances=np.full((n, 6, 6), np.nan),
        component=np.where(known, 0, -1),
        camera=None,
        relative_poses=(),
        loops=(),
        floor_slope_rad=(0.0, 0.0),
    )


def landmark_errors(estimate: Estimate, flight: Flight) -> LandmarkErrors:
    """Compute the errors of a map's landmark distances, and the positions of the landmarks."""
    association = associate(estimate, flight)
    maps = aligned_maps(estimate, association)
    rows, _ = landmark_table(estimate, flight, association, maps)
    percent = {row.name: row.error_percent.loops for row in rows}
    return LandmarkErrors(
        {row.name: row.error_m.loops for row in rows},
        {**percent, LARGEST: float(np.max(list(percent.values())))},
        landmark_places(estimate, flight, association, maps),
    )


def at_pace(flight: Flight, picture_s: float) -> Flight:
    """Return the flight with only the pictures that a computer with this processing time can use."""
    assert flight.frames is not None
    stamps = flight.frames.stamps_s
    due = stamps[0] + picture_s * np.arange(int((stamps[-1] - stamps[0]) / picture_s) + 1)
    k = np.unique(np.searchsorted(stamps, due - 1e-6))
    return with_pictures(flight, k[k < len(stamps)])


def with_pictures(flight: Flight, k: NDArray[np.int64]) -> Flight:
    """Return the flight with some of its pictures, by number (n,)."""
    frames = flight.frames
    assert frames is not None
    names = tuple(frames.names[index] for index in k)
    return replace(flight, frames=Frames(frames.stamps_s[k], names, lambda index: frames.load(int(k[index]))))


def _numbers(flight: Flight, taken: Flight) -> NDArray[np.int64]:
    """Return the number in ``flight`` of each picture of ``taken``."""
    assert flight.frames is not None
    assert taken.frames is not None
    return np.searchsorted(flight.frames.stamps_s, taken.frames.stamps_s)
