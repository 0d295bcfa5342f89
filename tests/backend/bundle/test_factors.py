import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from backend.bundle.factors import (
    ANTENNA,
    DATUM,
    FLOOR_Z,
    LOG_GAIN,
    LOG_SCALE,
    MOUNT,
    OFFSET,
    SLOPE,
    WORLD,
    WORLD_SIZE,
    body_up,
    level_factor,
    scaled_position_factor,
    scaled_range_factor,
)

POSE = 0
SEEDS = st.integers(0, 2**32 - 1)


def model(dimension: int) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Unit.Create(dimension)


def rigid(rotation: Rotation, place) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix()
    T[:3, 3] = place
    return T


def draw(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A camera over the floor, the world variable, and a mount: tilted, turned and off the centre."""
    rng = np.random.default_rng(seed)
    mount = Rotation.from_euler("xyz", [np.pi, 0, 0]) * Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    c_T_b = rigid(mount, rng.normal(0, 0.2, 3))
    w_R_b = Rotation.from_euler("ZYX", [rng.uniform(-3, 3), *rng.uniform(-0.5, 0.5, 2)])
    f_T_c = rigid(w_R_b * mount.inv(), [*rng.normal(0, 3, 2), rng.uniform(0.5, 2)])
    of_map = rng.uniform(-1, 5), *rng.normal(0, [100, 0.05, 0.1]), *rng.uniform(-0.3, 0.3, 4)
    of_positions = *rng.normal(0, 20.0, 3), *rng.normal(0, 0.3, 3)
    return f_T_c, np.array([*of_map, *of_positions]), c_T_b


def metric_world_pose(f_T_c: np.ndarray, world: np.ndarray, c_T_b: np.ndarray) -> np.ndarray:
    """The body in the measured world, by the words of the module: scale, then lean, then lift; the camera
    turned on its mount."""
    over_floor = f_T_c.copy()
    over_floor[:3, 3] *= np.exp(world[LOG_SCALE])
    lean = rigid(Rotation.from_rotvec([*world[SLOPE], 0.0]), [0, 0, world[FLOOR_Z]])
    turned = rigid(Rotation.from_rotvec([*world[MOUNT], 0.0]).inv(), np.zeros(3))
    return lean @ over_floor @ turned @ c_T_b


def values_of(f_T_c: np.ndarray, world: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(POSE, gtsam.Pose3(f_T_c))
    values.insert(WORLD, world)
    return values


def numeric(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> list[np.ndarray]:
    """Central differences of the unwhitened error along gtsam's own retraction of each variable."""
    out = []
    for key, size in ((POSE, 6), (WORLD, WORLD_SIZE)):
        columns = []
        for axis in range(size):
            ends = []
            for sign in (1.0, -1.0):
                moved = gtsam.Values(values)
                step = np.zeros(size)
                step[axis] = sign * 1e-6
                if key == POSE:
                    moved.update(key, values.atPose3(key).retract(step))
                else:
                    moved.update(key, values.atVector(key) + step)
                ends.append(factor.unwhitenedError(moved))
            columns.append((ends[0] - ends[1]) / 2e-6)
        out.append(np.array(columns).T)
    return out


def analytic(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> list[np.ndarray]:
    """What gtsam is given; unit noise leaves it unwhitened."""
    A, _ = factor.linearize(values).jacobian()
    return [A[:, :6], A[:, 6:]]


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_jacobians_are_those_of_central_differences(seed):
    f_T_c, world, c_T_b = draw(seed)
    values = values_of(f_T_c, world)
    c_up = c_T_b[:3, :3] @ body_up(np.array([0.1, -0.2, 1.0]))
    for factor in (
        scaled_range_factor(POSE, 1.3, model(1), c_T_b),
        scaled_position_factor(POSE, np.array([1.0, -2.0, 30.0]), model(3), c_T_b),
        level_factor(POSE, c_up, model(2)),
    ):
        for given_jacobian, expected in zip(analytic(factor, values), numeric(factor, values), strict=True):
            size = max(1.0, np.abs(expected).max())
            assert given_jacobian == pytest.approx(expected, abs=2e-7 * size)


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_a_range_is_where_the_ray_along_the_body_meets_the_floor(seed):
    """Walk the ray in the measured world until it meets the leaning floor."""
    f_T_c, world, c_T_b = draw(seed)
    w_T_b = metric_world_pose(f_T_c, world, c_T_b)
    normal = Rotation.from_rotvec([*world[SLOPE], 0.0]).apply([0.0, 0.0, 1.0])
    down = -w_T_b[:3, 2]
    distance = normal @ (np.array([0.0, 0.0, world[FLOOR_Z]]) - w_T_b[:3, 3]) / (normal @ down)
    factor = scaled_range_factor(POSE, 0.7, model(1), c_T_b)
    error = factor.unwhitenedError(values_of(f_T_c, world))
    assert error == pytest.approx([np.exp(world[LOG_GAIN]) * distance + world[DATUM] - 0.7], rel=1e-9)


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_a_position_is_that_of_the_antenna_in_the_world_of_positions(seed):
    f_T_c, world, c_T_b = draw(seed)
    nominal = np.array([3.0, -1.0, 12.0])
    factor = scaled_position_factor(POSE, nominal, model(3), c_T_b)
    w_T_b = metric_world_pose(f_T_c, world, c_T_b)
    expected = (w_T_b @ [*world[ANTENNA], 1.0])[:3] + world[OFFSET] - nominal
    assert factor.unwhitenedError(values_of(f_T_c, world)) == pytest.approx(expected, abs=1e-9)


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_up_is_the_world_s_and_not_the_floor_s(seed):
    """The right attitude leaves nothing, whatever the floor leans; one off by an angle leaves its sine."""
    f_T_c, world, c_T_b = draw(seed)
    w_R_b = metric_world_pose(f_T_c, world, c_T_b)[:3, :3]
    values = values_of(f_T_c, world)
    right = level_factor(POSE, c_T_b[:3, :3] @ w_R_b[2], model(2))
    assert right.unwhitenedError(values) == pytest.approx(np.zeros(2), abs=1e-12)
    axis = np.cross(w_R_b[2], [0.3, 0.5, -0.8])
    off = Rotation.from_rotvec(0.07 * axis / np.linalg.norm(axis)).apply(w_R_b[2])
    wrong = level_factor(POSE, c_T_b[:3, :3] @ off, model(2))
    assert np.linalg.norm(wrong.unwhitenedError(values)) == pytest.approx(np.sin(0.07), rel=1e-9)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_up_in_the_body_is_the_last_row_of_the_attitude(roll, pitch, yaw):
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()[2]
    assert body_up(np.array([roll, pitch, yaw])) == pytest.approx(expected, abs=1e-12)
