"""Covariances of the ground in a picture: consistent with an uncertain lens, the pose's with a held one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from backend.bundle.accuracy.ground_covariances import SeenGround, ground_covariances
from backend.bundle.projections import undistorted
from backend.bundle.refinement import Bundle, refine
from frontend.mosaic.quality import ground_jacobian
from slam.core.estimate import over_floor
from tests.backend.bundle.made_scenes import AT_ONE_HEIGHT, SCENES, SURVEY
from tests.backend.made_floor import Made, Scene, _recorded, make


def shown_at(made: Made, found: Bundle, k: int, ahead: float) -> tuple[np.ndarray, np.ndarray]:
    """Where picture k shows a mark ``ahead`` heights of the camera, less where it is (2,); and the Jacobian
    (2, 6) of the former by the body's pose."""
    true_pose = over_floor(made.w_T_b, made.slope_rad, made.floor_z_m)[k] @ made.measurements.camera.b_T_c
    hat_body = over_floor(found.w_T_b, found.floor_slope_rad, found.floor_z_m)[k]
    hat = hat_body @ found.b_T_c
    mark = true_pose[:3, 3] + [ahead * (true_pose[2, 3] - made.floor_z_m), 0.0, 0.0]
    mark[2] = made.floor_z_m
    c_p = (mark - true_pose[:3, 3]) @ true_pose[:3, :3]
    pixel = _recorded(c_p[None, :2] / c_p[2], made.lens)
    assert found.lens is not None
    ray = hat[:3, :3] @ [*undistorted(found.lens.calibration, pixel)[0], 1.0]
    place = hat[:3, 3] + ray * (found.floor_z_m - hat[2, 3]) / ray[2]
    J = ground_jacobian(place, hat[:3, 3], hat_body[:3, 3]) @ np.kron(np.eye(2), hat_body[:3, :3])
    return (place - mark)[:2], J


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", [AT_ONE_HEIGHT, SCENES["rtk, lens wrong"]], ids=["focal length untold", "lens wrong"]
)
def test_the_ground_is_as_far_off_as_its_covariances_say(scene: Scene):
    """The covariance of the pose alone counts an error of the lens as one of the ground, which it is not."""
    squares, of_pose, seeds = [], [], range(16)
    for seed in seeds:
        made = make(replace(scene, focal_ratio=1 + 0.02 * np.random.default_rng(seed).normal()), seed)
        found = refine(made.measurements, made.start, made.floor_z_m)
        k = scene.keyframes // 4
        off, J = shown_at(made, found, k, 0.45)
        for covariances, into in (
            (ground_covariances(found.optimum), squares), (found.over_floor_covariances, of_pose),
        ):  # fmt: skip
            into.append(off @ np.linalg.solve(J @ covariances[k] @ J.T, off))
    low, high = chi2.ppf([0.001, 0.999], 2 * len(seeds))
    assert low < sum(squares) < high
    if scene is AT_ONE_HEIGHT:
        assert sum(of_pose) < low


def test_with_a_held_lens_they_are_those_of_the_pose():
    made = make(SURVEY, 0)
    found = refine(made.measurements, made.start, made.floor_z_m)
    np.testing.assert_allclose(ground_covariances(found.optimum), found.over_floor_covariances, rtol=1e-9)


def test_an_error_of_the_focal_length_cancels_that_of_the_height():
    made = make(replace(AT_ONE_HEIGHT, keyframes=8, points_in_view=15), 0)
    found = refine(made.measurements, made.start, made.floor_z_m)
    _, J = shown_at(made, found, 4, 0.45)
    ground, of_pose = (
        np.sqrt(np.trace(J @ covariances[4] @ J.T))
        for covariances in (ground_covariances(found.optimum), found.over_floor_covariances)
    )
    height_m = found.w_T_b[4, 2, 3] - found.floor_z_m
    assert of_pose > 0.45 * 0.015 * height_m, "the height is as uncertain as the focal length"
    assert ground < 0.5 * of_pose


def test_the_ground_in_a_picture_moves_with_the_body_as_the_mosaic_has_it():
    made = make(replace(AT_ONE_HEIGHT, keyframes=8, points_in_view=15), 0)
    found = refine(made.measurements, made.start, made.floor_z_m)
    assert found.lens is not None
    pixel, k = found.optimum.cost.observations.pixel, 4
    sides = np.linspace(pixel.min(axis=0), pixel.max(axis=0), 5)
    corner = undistorted(found.lens.calibration, sides[:1])[0]
    body = over_floor(found.w_T_b, found.floor_slope_rad, found.floor_z_m)[k]
    hat = body @ found.b_T_c
    ray = hat[:3, :3] @ [*corner, 1.0]
    place = hat[:3, 3] + ray * (found.floor_z_m - hat[2, 3]) / ray[2]
    J = ground_jacobian(place, hat[:3, 3], body[:3, 3]) @ np.kron(np.eye(2), body[:3, :3])
    in_heights = SeenGround.of(found.optimum).jacobian(k)[:2]
    height_m = np.linalg.norm(J[:, 3:]) / np.linalg.norm(in_heights[:, 3:])
    np.testing.assert_allclose(height_m * in_heights, J, rtol=1e-6, atol=1e-6)
