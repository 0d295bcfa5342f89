"""Maps of one flight made in several ways, and how far their landmarks are off.

The paper's way composes the homographies of consecutive pictures (section 3.1); how many of the 15 pictures a
second its computer managed is set by the 150 ms that one took. Its other way puts each where a Kalman filter
has the vehicle (section 3.1.2). Ours composes those of keyframes, or solves the pose graph.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.keyframes import KeyframeConfig
from slam.core.estimate import Estimate
from slam.core.flight import Flight, Frames
from slam.core.progress import silent
from slam.core.rotations import roll_pitch_yaw_of
from slam.evaluation.aligned_maps import aligned_maps
from slam.evaluation.association import associate
from slam.evaluation.landmarks import landmark_places, landmark_table
from slam.inertial.filter_chain import filter_chain
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd
from slam.mapping.homography_chain import chain

Array = NDArray[np.float64]

PICTURE_S = 0.150
"""Time that the paper's computer took over one picture."""
LARGEST = "largest"
_EVERY_PICTURE = PipelineConfig(keyframes=KeyframeConfig(min_overlap=2.0))
"""No picture overlaps by so much: each that holds becomes a keyframe, one that fails is dropped."""


@dataclass(frozen=True)
class LandmarkErrors:
    """What the paper's tables hold of one map."""

    error_m: dict[str, float]
    """Pair -> absolute error of its distance; NaN where one of the two is not on the map."""
    percent: dict[str, float]
    """Of the true distance; with ``largest``, NaN where any is."""
    places: dict[str, Array]
    """Where the map has each landmark (3,), first pose and heading on the truth's."""


def consecutive(flight: Flight, estimate: Estimate) -> Estimate:
    """The paper's map: pictures as fast as its computer took them, each registered to the one before.

    The first picture's attitude and height are those of ``estimate``, so that what differs is the stitching.
    A picture whose registration does not hold is dropped; where too many in a row fail, the rest is NaN.
    """
    assert flight.camera is not None
    taken = at_pace(flight, PICTURE_S)
    observations = FrontEnd(taken, flight.camera, _EVERY_PICTURE, silent).track()
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


def filtered(flight: Flight, estimate: Estimate) -> Estimate:
    """The paper's map with inertia (section 3.1.2): each picture where the Kalman filter has the vehicle.

    The filter knows what all instruments but the camera have read until then; pictures from before or after
    are left out.
    """
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
    """An estimate with its keyframes at ``w_T_b`` (n, 4, 4) over a level floor, and nothing else known."""
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
    """The errors of a map's landmark distances, and where it has the landmarks."""
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
    """The flight with those pictures that somebody sees who takes so long over each."""
    assert flight.frames is not None
    stamps = flight.frames.stamps_s
    due = stamps[0] + picture_s * np.arange(int((stamps[-1] - stamps[0]) / picture_s) + 1)
    k = np.unique(np.searchsorted(stamps, due - 1e-6))
    return with_pictures(flight, k[k < len(stamps)])


def with_pictures(flight: Flight, k: NDArray[np.int64]) -> Flight:
    """The flight with some of its pictures, by number (n,)."""
    frames = flight.frames
    assert frames is not None
    names = tuple(frames.names[index] for index in k)
    return replace(flight, frames=Frames(frames.stamps_s[k], names, lambda index: frames.load(int(k[index]))))


def _numbers(flight: Flight, taken: Flight) -> NDArray[np.int64]:
    """Which picture of ``flight`` each picture of ``taken`` is."""
    assert flight.frames is not None
    assert taken.frames is not None
    return np.searchsorted(flight.frames.stamps_s, taken.frames.stamps_s)
