"""Measurements of one connected part of a map, and its planar bundle adjustment with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.problem import NoiseLevels, ScalePrior
from backend.bundle.refinement import Bundle, refine
from backend.errors import BackendError
from backend.measurements import AlignedPair, Attitude, FloorTracks, Measurements, PinholeModel
from frontend.camera import Camera
from frontend.homography import transfer
from slam.mapping.map import Map
from slam.mapping.setup import Setup

Array = NDArray[np.float64]

LEAST_SEEN = 4
"""Floor points that a keyframe must share with others to be refined: they determine a homography."""


def refine_part(
    setup: Setup,
    members: NDArray[np.int64],
    w_T_b: Array,
    floor_z_m: float,
    tracks: FloorTracks,
    on_step: Callable[[int, float], None] | None = None,
    lengths: ScalePrior | None = None,
    noise: NoiseLevels | None = None,
    aligned: tuple[AlignedPair, ...] = (),
) -> Bundle:
    """Refine one connected set of keyframes ``members`` (m,), sorted, from poses ``w_T_b`` (m, 4, 4)."""
    measured = part_measurements(setup, members, tracks, aligned)
    return refine(measured, w_T_b, floor_z_m, setup.config.bundle, on_step, lengths, noise)


def part_measurements(
    setup: Setup, members: NDArray[np.int64], tracks: FloorTracks, aligned: tuple[AlignedPair, ...] = ()
) -> Measurements:
    """Collect the measurements of one connected set of keyframes, renumbered from 0.

    ``aligned``: pairs of all keyframes that lines register.

    Raises ``BackendError`` if a keyframe shares too few floor points with others.
    """
    readings = setup.readings
    tracks = tracks.of_keyframes(members.tolist(), len(readings.stamps_s))
    seen = np.bincount(tracks.keyframe, minlength=len(members))
    if len(members) < 2 or ((seen < LEAST_SEEN) & ~by_lines(aligned, len(readings.stamps_s))[members]).any():
        raise BackendError("some keyframes share too few floor points with others")
    level = np.array([setup.config.trust.level_std_rad] * 2 + [np.inf])
    attitudes = readings.attitudes or tuple(Attitude(k, np.zeros(3), level) for k in members.tolist())
    whole = Measurements(
        readings.stamps_s,
        attitudes=attitudes,
        ranges=readings.ranges,
        positions=readings.positions,
        heights=readings.heights,
        control=setup.control,
        antenna_m=readings.fixes.antenna_m if readings.fixes else np.zeros(3),
        antenna_std_m=readings.fixes.antenna_std_m if readings.fixes else 0.0,
        antenna_up_std_m=readings.fixes.antenna_up_std_m if readings.fixes else 0.0,
        range_gain_std=readings.range_gain_std,
        range_datum_std_m=readings.range_datum_std_m,
        camera=pinhole_model(setup.camera),
        aligned=aligned,
        exposure=readings.exposure,
    )
    return replace(whole.of_keyframes(members.tolist()), tracks=tracks)


def aligned_pairs(solved: Map, camera: Camera) -> tuple[AlignedPair, ...]:
    """Return the kept registrations of a solved graph that rest on grey levels, not on features."""
    corners = camera.undistort(camera.corners_px)
    return tuple(
        AlignedPair(r.i, r.j, corners, transfer(r.i_H_j, corners), r.corner_covariance)
        for r in solved.kept_registrations
        if r.by_lines
    )


def by_lines(aligned: Iterable[AlignedPair], count: int) -> NDArray[np.bool_]:
    """Return (count,) which keyframes some pairs align by lines."""
    found = np.zeros(count, dtype=bool)
    found[[k for pair in aligned for k in pair.keyframes]] = True
    return found


def pinhole_model(camera: Camera) -> PinholeModel:
    """Return the camera as the back end needs it."""
    return PinholeModel(
        focal_px=camera.focal_px,
        center_px=camera.center_px,
        b_T_c=camera.b_T_c,
        distortion=camera.all_distortion,
        focal_std_ratio=camera.focal_std_ratio,
        aspect_std_ratio=camera.aspect_std_ratio,
        center_std_px=camera.center_std_px,
        radial_std=camera.radial_std,
        tangential_std=camera.tangential_std,
        mount_std_rad=camera.mount_std_rad or 0.0,
        lens=camera.lens,
        stated=camera.stated_numbers if camera.stated else None,
    )
