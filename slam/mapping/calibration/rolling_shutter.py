"""Rolling shutter: keyframes, and the frames between them, as a global shutter would have taken them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backend.measurements import RowExposure
from backend.preintegration.integrals import integrate
from frontend.camera import Camera
from frontend.features import Features
from frontend.motions import Expectation
from frontend.points import Points
from frontend.registration import Registration
from frontend.rolling_shutter import NeighbourView, RowMotion, global_shutter_homography
from frontend.store import FeatureStore
from frontend.tracked import IntermediateFrame
from slam.core.streams import Imu
from slam.mapping.front_end import Observations

Array = NDArray[np.float64]

NEAR_S = 0.3
"""Largest time to a neighbouring picture that still determines the current speed."""

Register = Callable[[int, int, Features, Features, Expectation | None], Registration]


def with_row_motion(
    observations: Observations, camera: Camera, imu: Imu | None, register: Register
) -> Observations:
    """Return the observations of a video with the speed of the floor in each keyframe.

    Where the read-out time is known, features are moved to where they would lie if all rows had been exposed
    with the middle one.
    """
    neighbours = _neighbours(observations)
    stamps_s = observations.frame_stamps_s
    turned = turning(imu, camera)

    def motion_of(frame: int) -> RowMotion:
        return RowMotion.estimate(camera, neighbours[frame], lambda since_s: turned(stamps_s[frame], since_s))

    frames = observations.frame_index.tolist()
    motions = [motion_of(frame) for frame in frames]
    speed = [
        motion.corner_speed() if neighbours[frame] else np.full((4, 2), np.nan)
        for frame, motion in zip(frames, motions, strict=True)
    ]
    observations = replace(observations, corner_speed=np.array(speed).reshape(-1, 4, 2))
    if camera.readout_s == 0:
        return observations
    return _corrected(observations, camera, register, motions, motion_of)


def _corrected(
    observations: Observations,
    camera: Camera,
    register: Register,
    motions: Sequence[RowMotion],
    motion_of: Callable[[int], RowMotion],
) -> Observations:
    """Return the observations with moved features. Links are registered again; a link that then fails stays
    as it was.

    ``motions`` are those of the keyframes; ``motion_of`` gives that of a frame.
    """
    store = FeatureStore()
    for k, motion in enumerate(motions):
        features = observations.store[k]
        points = Points(motion.to_global_shutter(features.pixel), features.points.spread)
        store.append(replace(features, points=points))
    corners_px = camera.undistort(camera.corners_px)

    def again(link: Registration | None) -> Registration | None:
        if link is None:
            return None
        i_H_j = global_shutter_homography(link.i_H_j, motions[link.i], motions[link.j])
        expected = Expectation.at(i_H_j, corners_px)
        found = register(link.i, link.j, store[link.i], store[link.j], expected)
        return found if found.ok else link

    def straight(passed: IntermediateFrame) -> IntermediateFrame:
        i_H_j = global_shutter_homography(passed.i_H_j, motions[passed.keyframe], motion_of(passed.frame))
        return replace(passed, i_H_j=i_H_j)

    links = tuple(again(link) for link in observations.links)
    return replace(
        observations,
        store=store,
        links=links,
        registrations=tuple(link for link in links if link is not None),
        passed=tuple(straight(passed) for passed in observations.passed),
    )


def frames_exposure(observations: Observations, camera: Camera) -> RowExposure | None:
    """Return how the rows of a video's keyframes are exposed; None where no frames tell how they move."""
    if not len(observations.corner_speed):
        return None
    is_found = camera.stated_readout_s is not None
    stated_s = camera.stated_readout_s if is_found else camera.readout_s
    return RowExposure(
        rows=camera.size_px[1],
        readout_s=stated_s or None,
        w_v_m_s=np.full((len(observations.corner_speed), 3), np.nan),
        corrected_s=camera.readout_s,
        is_refuted=is_found,
        xy=camera.rays(camera.undistort(camera.corners_px))[:, :2],
        floor_speed=observations.corner_speed,
    )


def turning(imu: Imu | None, camera: Camera) -> Callable[[float, Array], Array]:
    """From when, and (m,) seconds since -> (m, 3) rotation vectors of the camera; zero without a gyro.

    For the short times in which turns simply add up.
    """
    if imu is None or len(imu.stamps_s) < 2:
        return lambda at_s, since_s: np.zeros((len(since_s), 3))
    known = np.isfinite(imu.gyro_rad_s).all(axis=1)
    times_s = imu.stamps_s[known]
    c_R_s = camera.b_T_c[:3, :3].T @ imu.b_T_s[:3, :3]
    rate = imu.gyro_rad_s[known] @ c_R_s.T
    angle = integrate(times_s, rate)

    def turned(at_s: float, since_s: Array) -> Array:
        at = np.concatenate([[at_s], at_s + since_s])
        found = np.column_stack([np.interp(at, times_s, axis) for axis in angle.T])
        return np.asarray(found[1:] - found[0])

    return turned


def _neighbours(observations: Observations) -> dict[int, list[NeighbourView]]:
    """Return, for each frame, the adjacent frames that were registered to the same keyframe."""
    neighbours: dict[int, list[NeighbourView]] = defaultdict(list)
    for frames in observations.registered():
        for a, b in pairwise(frames):
            apart_s = float(observations.frame_stamps_s[b.frame] - observations.frame_stamps_s[a.frame])
            if 0 < apart_s <= NEAR_S:
                b_H_a = np.asarray(np.linalg.solve(b.i_H_j, a.i_H_j), dtype=float)
                neighbours[a.frame].append(NeighbourView(apart_s, b_H_a))
                a_H_b = np.asarray(np.linalg.inv(b_H_a), dtype=float)
                neighbours[b.frame].append(NeighbourView(-apart_s, a_H_b))
    return neighbours
