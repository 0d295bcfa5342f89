"""Keyframes that lines alone tie together: a refinement without floor points, and what it leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.bundle.homography_factor import ImagePlane, transfer
from backend.bundle.refinement import refine
from backend.measurements import AlignedPair, Attitude, FloorTracks, Measurements, PinholeModel, SlantRange

CAMERA = PinholeModel((200.0, 200.0), (160.0, 120.0), np.diag([1.0, -1.0, -1.0, 1.0]))
PLANE = ImagePlane(np.array(CAMERA.focal_px), np.array(CAMERA.center_px))
CORNERS = np.array([[0.0, 0.0], [320.0, 0.0], [320.0, 240.0], [0.0, 240.0]])
NO_TRACKS = FloorTracks(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
COUNT, STD_PX, OPEN_PX = 8, 0.1, 100.0


def measured(seed: int, open_along: bool) -> tuple[Measurements, np.ndarray]:
    """Return pairs along a flight, with lines along x in the picture or also across, and the true poses."""
    rng = np.random.default_rng(seed)
    w_T_b = np.tile(np.eye(4), (COUNT, 1, 1))
    w_T_b[:, 0, 3], w_T_b[:, 2, 3] = 0.3 * np.arange(COUNT), 1.0
    w_T_c = w_T_b @ CAMERA.b_T_c
    covariance = STD_PX**2 * np.eye(8)
    if open_along:
        along = np.tile([0.5, 0.0], 4)
        covariance += OPEN_PX**2 * np.outer(along, along)
    pairs = []
    for k in range(COUNT - 1):
        seen = transfer(w_T_c[k : k + 1], w_T_c[k + 1 : k + 2], PLANE.rays(CORNERS)[None], PLANE).pixel[0]
        k_pixel = (seen + rng.normal(0, STD_PX, 8)).reshape(4, 2)
        pairs.append(AlignedPair(k, k + 1, CORNERS, k_pixel, covariance))
    return Measurements(
        stamps_s=np.arange(float(COUNT)),
        attitudes=tuple(Attitude(k, np.zeros(3), np.array([0.01, 0.01, np.inf])) for k in range(COUNT)),
        ranges=tuple(SlantRange(k, 1.0 + rng.normal(0, 0.01), 0.01) for k in range(COUNT)),
        tracks=NO_TRACKS,
        camera=CAMERA,
        aligned=tuple(pairs),
    ), w_T_b


@pytest.mark.parametrize("seed", range(3))
def test_pairs_alone_place_the_keyframes_as_exactly_as_told(seed):
    measurements, w_T_b = measured(seed, open_along=False)
    start = w_T_b @ se3.exp(np.random.default_rng(9).normal(0, 0.02, (COUNT, 6)))
    start[0] = w_T_b[0]
    found = refine(measurements, start)
    off = found.w_T_b[1:, :3, 3] - w_T_b[1:, :3, 3]
    std_m = np.sqrt(found.covariances[1:, [3, 4, 5], [3, 4, 5]])
    assert (np.abs(off) < 4 * std_m).all()
    assert std_m.max() < 0.2
    assert found.scale_std is not None
    assert 0 < found.scale_std < 0.2


def test_a_direction_that_lines_leave_open_is_as_uncertain_as_the_picture_is_wide():
    measurements, w_T_b = measured(0, open_along=True)
    found = refine(measurements, w_T_b)
    std_m = np.sqrt(found.covariances[-1][[3, 4], [3, 4]])
    assert std_m[0] == pytest.approx(np.sqrt(COUNT - 1) * OPEN_PX / 2 / 200.0, rel=0.5)
    assert std_m[1] < 0.3


def test_a_range_weighs_as_little_as_its_stated_deviation_says():
    measurements, w_T_b = measured(1, open_along=False)
    loose = tuple(replace(pair, covariance=1e4 * pair.covariance) for pair in measurements.aligned)
    measurements = replace(measurements, aligned=loose)
    off = [
        SlantRange(r.k, 1.06 if r.k == 3 else 1.0, 0.06 if r.k == 3 else 0.01) for r in measurements.ranges
    ]
    equal = [replace(r, std_m=0.01) for r in off]
    height_m, as_others_m = (
        refine(replace(measurements, ranges=tuple(ranges)), w_T_b).w_T_b[:, 2, 3] for ranges in (off, equal)
    )
    assert abs(height_m[3] - np.delete(height_m, 3).mean()) < 0.01
    assert as_others_m[3] - np.delete(as_others_m, 3).mean() > 0.015
