"""Equations of ``docs/method/model.md`` that no test of a single factor covers, each computed as written."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.linalg import logm
from scipy.stats import norm

from backend import se3
from backend.bundle.exposure_motion import RowShift
from backend.bundle.factors import ANTENNA, FLOOR_Z, LOG_SCALE, MOUNT, SLOPE, WORLD_SIZE
from backend.bundle.lens_evidence import log_marginal_likelihood
from backend.bundle.projections import residual
from backend.bundle.world import WorldTransform

SEEDS = range(3)
UP = np.array([0.0, 0.0, 1.0])
GRAVITY_M_S2 = np.array([0.0, 0.0, -9.81])


def rotation(vector: np.ndarray) -> np.ndarray:
    return gtsam.Rot3.Expmap(np.asarray(vector, float)).matrix()


def pose(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = R, p
    return found


def looking_down(rng: np.random.Generator) -> np.ndarray:
    """A camera about one mean height over the floor."""
    return pose(rotation([np.pi, 0, 0]) @ rotation(0.1 * rng.normal(size=3)), 0.1 * rng.normal(size=3) + UP)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_pose_of_the_body_in_the_world(seed):
    rng = np.random.default_rng(seed)
    world, f_T_c = 0.1 * rng.normal(size=WORLD_SIZE), looking_down(rng)
    world[LOG_SCALE] += 1.0
    b_T_c = pose(rotation(rng.normal(size=3)), rng.normal(size=3))
    A, M = (rotation([*world[which], 0.0]) for which in (SLOPE, MOUNT))
    metric = pose(f_T_c[:3, :3], np.exp(world[LOG_SCALE]) * f_T_c[:3, 3])
    expected = pose(A, world[FLOOR_Z] * UP) @ metric @ se3.inverse(b_T_c @ pose(M, np.zeros(3)))
    found = WorldTransform(world, b_T_c).body_pose(gtsam.Pose3(f_T_c)).matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)
    world[ANTENNA] += 1.0
    np.testing.assert_array_equal(WorldTransform(world, b_T_c).body_pose(gtsam.Pose3(f_T_c)).matrix(), found)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_that_has_moved_on_sees_a_point_as_if_that_had_moved_back(seed):
    """To first order in the time: the second is too long by the square of it."""
    rng = np.random.default_rng(seed)
    lens, origin_px = np.array([300.0, 310, 160, 120, 0, 0, 0, 0, 0]), np.zeros(2)
    f_T_c, point, velocity, rate = looking_down(rng), 0.2 * rng.normal(size=3), *rng.normal(size=(2, 3))
    at_once = np.array(residual(f_T_c, point, lens, origin_px))
    for late_s in (1e-3, 1e-4):
        later = pose(rotation(late_s * rate) @ f_T_c[:3, :3], f_T_c[:3, 3] + late_s * velocity)
        seen = np.array(residual(later, point, lens, origin_px)) - at_once
        back = RowShift(late_s * velocity, late_s * rate).point_at_once(point, f_T_c[:3, 3])
        told = np.array(residual(f_T_c, back, lens, origin_px)) - at_once
        assert np.abs(seen).max() > 50 * late_s
        assert np.abs(told - seen).max() < 1e4 * late_s**2


@pytest.mark.parametrize("seed", SEEDS)
def test_an_inertial_residual_is_the_logarithm_between_the_predicted_state_and_that_of_the_map(seed):
    rng = np.random.default_rng(seed)
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    read = gtsam.PreintegratedCombinedMeasurements(parameters, gtsam.imuBias.ConstantBias())
    for accel, rate in zip(rng.normal(size=(10, 3)) - GRAVITY_M_S2, rng.normal(size=(10, 3)), strict=True):
        read.integrateMeasurement(accel, rate, 0.1)
    (R_i, R_j), (p_i, p_j) = map(rotation, 0.3 * rng.normal(size=(2, 3))), rng.normal(size=(2, 3))
    (v_i, v_j), (b_i, b_j), lasts_s = rng.normal(size=(2, 3)), (np.zeros(6), rng.normal(size=6)), 1.0
    values = gtsam.Values()
    for key, (R, p, v, b) in enumerate(((R_i, p_i, v_i, b_i), (R_j, p_j, v_j, b_j))):
        values.insert(2 * key, gtsam.Pose3(pose(R, p)))
        values.insert(2 * key + 1, v)
        values.insert(4 + key, gtsam.imuBias.ConstantBias(b[:3], b[3:]))
    predicted = (
        R_i @ read.deltaRij().matrix(),
        v_i + GRAVITY_M_S2 * lasts_s + R_i @ read.deltaVij(),
        p_i + v_i * lasts_s + GRAVITY_M_S2 * lasts_s**2 / 2 + R_i @ read.deltaPij(),
    )
    extended = np.eye(5)
    extended[:3] = R_j.T @ np.column_stack([predicted[0], predicted[1] - v_j, predicted[2] - p_j])
    log = logm(extended).real
    expected = np.r_[log[2, 1], log[0, 2], log[1, 0], log[:3, 4], log[:3, 3], b_i - b_j]
    found = gtsam.CombinedImuFactor(0, 1, 2, 3, 4, 5, read).unwhitenedError(values)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("gradient", "information", "std"), [(0.0, 4.0, 0.5), (3.0, 2.0, 1.5), (-8.0, 9.0, 0.1)]
)
def test_the_evidence_is_the_integral_of_likelihood_times_prior(gradient, information, std):
    x = np.linspace(-12 * std, 12 * std, 20_001)
    likelihood = np.exp(gradient * x - information * x**2 / 2)
    integral = np.trapezoid(likelihood * norm.pdf(x, scale=std), x)
    found = log_marginal_likelihood(np.array([gradient]), np.array([[information]]), np.array([[std**2]]))
    assert found == pytest.approx(np.log(integral), abs=1e-6)
