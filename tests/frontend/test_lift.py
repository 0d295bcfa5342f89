"""The lift from homographies to metric relative poses: exact without noise, honest with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import RigidTransform, Rotation

from frontend.camera import Camera
from frontend.homography import transfer
from frontend.lift import LiftedPoses, level_T_body, lift
from tests.frontend.floor_pairs import CAMERA, FISHY, Array, homography_of, mounted, pair, true_homography

TURNED = mounted((0.0, 0.0, 1.5), (0.0, 0.0, 0.0))
LEANING = mounted((0.3, -0.2, 0.5), (0.0, 0.0, 0.0))
LEVER = mounted((0.1, -0.2, 2.0), (0.10, 0.05, -0.04))


@dataclass(frozen=True)
class Pairs:
    """m pairs with their truth."""

    i_H_j: Array
    roll_pitch_rad: Array
    height_m: Array
    i_T_j: Array


def true_pairs(
    rng: np.random.Generator, camera: Camera, count: int, ratio: float, tilt_rad: float, height_m: float = 0.8
) -> Pairs:
    H, angles, heights, poses = [], [], [], []
    for _ in range(count):
        w_T_i, w_T_j = pair(rng, height_m * rng.uniform(0.8, 1.2), ratio, tilt_rad)
        H.append(true_homography(camera, w_T_i, w_T_j))
        angles.append(Rotation.from_matrix(w_T_i[:3, :3]).as_euler("ZYX")[[2, 1]])
        heights.append(w_T_i[2, 3])
        poses.append(np.linalg.inv(w_T_i) @ w_T_j)
    return Pairs(np.array(H), np.array(angles), np.array(heights), np.array(poses))


def difference(a_T_b: Array, a_T_c: Array) -> Array:
    """(m, 6) of b_T_c, rotation first."""
    return RigidTransform.from_matrix(np.linalg.inv(a_T_b) @ a_T_c).as_exp_coords()


def tight(m: int) -> Array:
    return np.tile(0.01 * np.eye(8), (m, 1, 1))


@pytest.mark.parametrize("camera", [CAMERA, FISHY, TURNED, LEANING, LEVER])
@pytest.mark.parametrize("ratio", [1 / 3, 1.0, 3.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("std_rad", [0.0, 0.01])
def test_without_noise_the_truth_comes_back(
    camera: Camera, ratio: float, tilt_rad: float, std_rad: float
) -> None:
    pairs = true_pairs(np.random.default_rng(0), camera, 20, ratio, tilt_rad)
    lifted = lift(pairs.i_H_j, tight(20), camera, pairs.roll_pitch_rad, np.full((20, 2), std_rad))
    i_T_j, _ = lifted.scale(pairs.height_m, np.zeros(20))
    np.testing.assert_allclose(i_T_j, pairs.i_T_j, atol=2e-6)
    np.testing.assert_allclose(lifted.misfit, 0, atol=1e-6)
    if camera is not LEVER:  # the ratio is that of the cameras' heights
        np.testing.assert_allclose(lifted.height_ratio, ratio, rtol=1e-6)


def test_lever_arm_counts_in_metres_however_high_the_flight() -> None:
    for height_m in (0.5, 50.0):
        pairs = true_pairs(np.random.default_rng(1), LEVER, 20, 1.0, 0.05, height_m)
        lifted = lift(pairs.i_H_j, tight(20), LEVER, pairs.roll_pitch_rad, np.full((20, 2), 0.01))
        i_T_j, _ = lifted.scale(pairs.height_m, np.zeros(20))
        np.testing.assert_allclose(i_T_j, pairs.i_T_j, atol=1e-6 * height_m)


@dataclass(frozen=True)
class Noisy:
    """What is lifted when homography, attitude and height are drawn around the truth."""

    lifted: LiftedPoses
    error: Array
    covariance: Array


def noisy(
    rng: np.random.Generator,
    camera: Camera,
    count: int,
    ratio: float,
    noise_px: float,
    attitude_std_rad: float,
    height_std_ratio: float,
) -> Noisy:
    pairs = true_pairs(rng, camera, count, ratio, 0.05)
    corners = camera.undistort(camera.corners_px)
    H, covariances = [], []
    for true_H in pairs.i_H_j:
        A = rng.normal(size=(8, 8))
        covariance = noise_px**2 * (A @ A.T / 8 + 0.3 * np.eye(8))
        seen = transfer(true_H, corners) + rng.multivariate_normal(np.zeros(8), covariance).reshape(4, 2)
        H.append(homography_of(corners, seen))
        covariances.append(covariance)
    angles = pairs.roll_pitch_rad + rng.normal(0, attitude_std_rad, (count, 2))
    heights = pairs.height_m * (1 + rng.normal(0, height_std_ratio, count))
    lifted = lift(np.array(H), np.array(covariances), camera, angles, np.full((count, 2), attitude_std_rad))
    i_T_j, covariance = lifted.scale(heights, height_std_ratio * heights)
    return Noisy(lifted, difference(i_T_j, pairs.i_T_j), covariance)


@pytest.mark.parametrize(
    "camera",
    [LEVER, *(pytest.param(camera, marks=pytest.mark.slow) for camera in (CAMERA, FISHY, LEANING))],
)
@pytest.mark.parametrize(
    ("ratio", "noise_px", "attitude_std_rad", "height_std_ratio"),
    [
        (1.0, 0.3, 0.01, 0.02),
        (1.0, 0.05, 0.01, 0.01),
        (1.0, 0.3, 0.1, 0.02),
        (1.0, 3.0, 0.01, 0.01),
        (1.0, 0.3, 0.001, 0.005),
        (0.4, 0.3, 0.02, 0.02),
        (1.6, 0.3, 0.005, 0.02),
    ],
)
def test_covariance_predicts_the_errors(
    camera: Camera, ratio: float, noise_px: float, attitude_std_rad: float, height_std_ratio: float
) -> None:
    """Means of chi² with 6 and 2 degrees of freedom and of a standard normal, +- 4 standard errors."""
    count = 300
    rng = np.random.default_rng(int(1000 * noise_px + 1e5 * attitude_std_rad + 7 * ratio))
    drawn = noisy(rng, camera, count, ratio, noise_px, attitude_std_rad, height_std_ratio)
    assert drawn.lifted.usable.all()
    nees = np.einsum(
        "ma,ma->m", drawn.error, np.linalg.solve(drawn.covariance, drawn.error[..., None])[..., 0]
    )
    assert 6 - 4 * np.sqrt(12 / count) < nees.mean() < 6 + 4 * np.sqrt(12 / count)
    misfit = drawn.lifted.misfit.mean()
    assert 2 - 4 * np.sqrt(4 / count) < misfit < 2 + 4 * np.sqrt(4 / count)
    if camera is not LEVER:
        whitened = (np.log(drawn.lifted.height_ratio) - np.log(ratio)) / drawn.lifted.log_ratio_std
        assert 1 - 4 * np.sqrt(0.5 / count) < whitened.std() < 1 + 4 * np.sqrt(0.5 / count)


def test_each_axis_has_its_own_share_of_the_noise() -> None:
    """NEES alone could hide an axis that is too sure behind one that is too timid."""
    drawn = noisy(np.random.default_rng(3), CAMERA, 600, 1.0, 0.3, 0.01, 0.02)
    whitened = drawn.error / np.sqrt(np.einsum("maa->ma", drawn.covariance))
    np.testing.assert_allclose((whitened**2).mean(axis=0), 1.0, atol=4 * np.sqrt(2 / 600))
    np.testing.assert_allclose(whitened.mean(axis=0), 0.0, atol=4 / np.sqrt(600))


@pytest.mark.parametrize("camera", [CAMERA, LEANING, LEVER])
def test_swapping_the_pictures_gives_the_inverse_pose(camera: Camera) -> None:
    m = 15
    forth = true_pairs(np.random.default_rng(4), camera, m, 1.3, 0.05)
    level_T_i = level_T_body(forth.roll_pitch_rad)
    level_T_i[:, 2, 3] = forth.height_m
    level_T_j = level_T_i @ forth.i_T_j
    angles_j = Rotation.from_matrix(level_T_j[:, :3, :3]).as_euler("ZYX")[:, [2, 1]]
    std = np.full((m, 2), 0.01)
    a = lift(forth.i_H_j, tight(m), camera, forth.roll_pitch_rad, std)
    b = lift(np.linalg.inv(forth.i_H_j), tight(m), camera, angles_j, std)
    i_T_j, _ = a.scale(forth.height_m, np.zeros(m))
    j_T_i, _ = b.scale(level_T_j[:, 2, 3], np.zeros(m))
    np.testing.assert_allclose(i_T_j @ j_T_i, np.tile(np.eye(4), (m, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(a.height_ratio * b.height_ratio, 1.0, atol=1e-6)


def test_attitude_counts_about_the_axes_that_roll_and_pitch_turn_about() -> None:
    """Where the sensor is much surer than the homography, its two axes add their outer products."""
    m, std_rad, step = 10, 2e-4, 1e-5
    pairs = true_pairs(np.random.default_rng(9), CAMERA, m, 1.0, 0.3)
    covariances = np.tile(np.eye(8), (m, 1, 1))

    def lifted(angles: Array, std: float) -> LiftedPoses:
        return lift(pairs.i_H_j, covariances, CAMERA, angles, np.full((m, 2), std))

    expected = np.zeros((m, 6, 6))
    for axis in np.eye(2):
        moved = lifted(pairs.roll_pitch_rad + step * axis, 1e-6)
        direction = difference(lifted(pairs.roll_pitch_rad, 1e-6).i_T_j, moved.i_T_j) / step
        expected += std_rad**2 * np.einsum("ma,mb->mab", direction, direction)
    found = lifted(pairs.roll_pitch_rad, std_rad).covariance - lifted(pairs.roll_pitch_rad, 1e-6).covariance
    np.testing.assert_allclose(found, expected, atol=0.03 * np.abs(expected).max())


def test_scale_carries_the_uncertainty_of_the_height_along_the_step() -> None:
    pairs = true_pairs(np.random.default_rng(5), LEVER, 10, 1.2, 0.05)
    lifted = lift(pairs.i_H_j, tight(10), LEVER, pairs.roll_pitch_rad, np.full((10, 2), 0.01))
    sure_T, sure = lifted.scale(pairs.height_m, np.zeros(10))
    step = 1e-5
    higher_T, unsure = lifted.scale(pairs.height_m + step, np.full(10, 0.03))
    direction = difference(sure_T, higher_T) / step
    _, at_same_height = lifted.scale(pairs.height_m, np.full(10, 0.03))
    np.testing.assert_allclose(
        at_same_height - sure, 0.03**2 * np.einsum("ma,mb->mab", direction, direction), atol=1e-8
    )
    np.testing.assert_allclose(unsure, at_same_height, rtol=1e-3, atol=1e-7)


def test_attitude_is_corrected_where_the_pictures_know_better() -> None:
    """A step of a third of the height shows the tilt: six degrees of error in the attitude hardly matter."""
    rng = np.random.default_rng(6)
    pairs = true_pairs(rng, CAMERA, 200, 1.0, 0.05)
    angles = pairs.roll_pitch_rad + rng.normal(0, 0.1, (200, 2))
    far = np.linalg.norm(pairs.i_T_j[:, :2, 3], axis=1) > 0.1
    std = np.full((200, 2), 0.1)
    believed = lift(pairs.i_H_j, tight(200), CAMERA, angles, np.full((200, 2), 1e-6))
    doubted = lift(pairs.i_H_j, tight(200), CAMERA, angles, std)
    error = [
        np.linalg.norm(difference(x.scale(pairs.height_m, np.zeros(200))[0], pairs.i_T_j)[far], axis=1)
        for x in (believed, doubted)
    ]
    assert np.median(error[1]) < 0.2 * np.median(error[0])


def test_usable_names_the_bad_ones_and_they_do_not_disturb_the_others() -> None:
    pairs = true_pairs(np.random.default_rng(7), CAMERA, 6, 1.0, 0.05)
    H, C = pairs.i_H_j.copy(), tight(6)
    std = np.full((6, 2), 0.01)
    alone = lift(H, C, CAMERA, pairs.roll_pitch_rad, std)
    H[1] = [[-3.0, 7, 100], [0.1, 1e-3, -50], [1e-2, -3e-2, 1]]  # wild
    H[3] = H[3] @ np.diag([-1.0, 1, 1])  # mirrored: no camera that looks down sees it so
    lifted = lift(H, C, CAMERA, pairs.roll_pitch_rad, std)
    good = [0, 2, 4, 5]
    assert lifted.usable[good].all()
    np.testing.assert_allclose(lifted.i_T_j[good], alone.i_T_j[good], atol=1e-9)
    np.testing.assert_allclose(lifted.covariance[good], alone.covariance[good], rtol=1e-6, atol=1e-15)
    assert not lifted.usable[3]


def test_usable_asks_for_height_and_a_definite_finite_covariance() -> None:
    pairs = true_pairs(np.random.default_rng(8), CAMERA, 6, 1.0, 0.05)
    lifted = lift(pairs.i_H_j, tight(6), CAMERA, pairs.roll_pitch_rad, np.full((6, 2), 0.01))
    covariance, ratio, log_std = (
        lifted.covariance.copy(),
        lifted.height_ratio.copy(),
        lifted.log_ratio_std.copy(),
    )
    covariance[1, 2, 2] = np.nan
    covariance[2] = -covariance[2]
    ratio[3] = -0.1
    log_std[4] = np.nan
    broken = LiftedPoses(
        lifted.i_T_j, covariance, ratio, log_std, lifted.misfit, lifted.b_p_c_m, lifted.camera_above_body_m
    )
    assert broken.usable.tolist() == [True, False, False, False, False, True]


def test_no_pairs_give_no_poses() -> None:
    nothing = lift(np.empty((0, 3, 3)), np.empty((0, 8, 8)), CAMERA, np.empty((0, 2)), np.empty((0, 2)))
    assert nothing.usable.shape == (0,)
    i_T_j, covariance = nothing.scale(np.empty(0), np.empty(0))
    assert i_T_j.shape == (0, 4, 4)
    assert covariance.shape == (0, 6, 6)


def test_covariance_contains_the_uncertainty_of_roll_and_pitch_separately() -> None:
    """Sample and reported covariance agree where the uncertainty of one tilt angle dominates."""
    count, noise_px = 2000, 0.1
    rng = np.random.default_rng(11)
    one = true_pairs(rng, CAMERA, 1, 1.0, 0.1)
    corners = transfer(one.i_H_j[0], CAMERA.corners_px)
    stds = np.where(np.arange(count)[:, None] % 2 == 0, [0.05, 0.0005], [0.0005, 0.05])
    H = np.array(
        [homography_of(CAMERA.corners_px, corners + rng.normal(0, noise_px, (4, 2))) for _ in range(count)]
    )
    lifted = lift(
        H,
        np.tile(noise_px**2 * np.eye(8), (count, 1, 1)),
        CAMERA,
        one.roll_pitch_rad + rng.normal(0, stds),
        stds,
    )
    certain = lift(
        one.i_H_j, noise_px**2 * np.eye(8)[None], CAMERA, one.roll_pitch_rad, np.full((1, 2), 1e-6)
    )
    i_T_j, covariance = lifted.scale(np.repeat(one.height_m, count), np.zeros(count))
    _, without_tilt = certain.scale(one.height_m, np.zeros(1))
    error = difference(i_T_j, np.repeat(one.i_T_j, count, axis=0))
    for chosen in (slice(0, None, 2), slice(1, None, 2)):
        sample = error[chosen].T @ error[chosen] / len(error[chosen])
        ratios = eigh(sample, covariance[chosen].mean(axis=0), eigvals_only=True)
        assert ratios[0] > 0.8
        assert ratios[-1] < 1.25
        assert eigh(sample, without_tilt[0], eigvals_only=True)[-1] > 2


def test_pairs_are_lifted_in_blocks_without_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = true_pairs(np.random.default_rng(12), CAMERA, 9, 1.0, 0.05)
    whole = lift(pairs.i_H_j, tight(9), CAMERA, pairs.roll_pitch_rad, np.full((9, 2), 0.01))
    monkeypatch.setattr("frontend.lift._AT_ONCE", 4)
    blocks = lift(pairs.i_H_j, tight(9), CAMERA, pairs.roll_pitch_rad, np.full((9, 2), 0.01))
    np.testing.assert_allclose(blocks.i_T_j, whole.i_T_j, atol=1e-12)
    np.testing.assert_allclose(blocks.covariance, whole.covariance, rtol=1e-6, atol=1e-15)
