import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend import se3
from backend.gauge import gauge_prior
from backend.measurements import Attitude, Position, SlantRange
from backend.pose_graph.solve import solve
from backend.pose_graph.unary_factors import aligned, attitude, position, slant_range
from tests.backend.synthetic import flight


def _sigmas(factor: gtsam.NonlinearFactor, w_T: np.ndarray) -> float:
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(w_T))
    return float(np.sqrt(2 * factor.error(values)))


def _pose(angles: list[float] | np.ndarray, place: tuple[float, float, float] = (0, 0, 1)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    T[:3, 3] = place
    return T


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_sigma_of_each_angle_is_one_sigma_at_any_tilt(axis: int):
    angles, std = np.array([0.5, -0.6, 2.0]), np.array([1e-4, 3e-4, 7e-4])
    single = attitude(Attitude(0, angles, std))
    assert single is not None
    off = angles.copy()
    off[axis] += std[axis]
    assert _sigmas(single.factor, _pose(angles)) == pytest.approx(0, abs=1e-6)
    assert _sigmas(single.factor, _pose(off)) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("heading", [-3.0, 0.0, 1.0, 2.5])
def test_an_unknown_heading_is_free_all_around(heading: float):
    single = attitude(Attitude(0, np.array([0.3, -0.2, np.nan]), np.array([0.01, 0.01, np.inf])))
    assert single is not None
    assert _sigmas(single.factor, _pose([0.3, -0.2, heading])) == pytest.approx(0, abs=1e-6)
    assert _sigmas(single.factor, _pose([0.31, -0.2, heading])) == pytest.approx(1, rel=0.05)


def test_an_unmeasured_angle_has_no_weight():
    single = attitude(Attitude(0, np.array([np.nan, 0.1, 0.2]), np.array([0.01, 0.01, 0.01])))
    assert single is not None
    assert _sigmas(single.factor, _pose([0.4, 0.1, 0.2])) < 0.1 * _sigmas(
        single.factor, _pose([0.0, 0.5, 0.2])
    )
    assert attitude(Attitude(0, np.full(3, np.nan), np.ones(3))) is None
    assert position(Position(0, np.full(3, np.nan), np.ones(3))) is None


def test_a_range_does_not_depend_on_the_horizontal_position():
    single = slant_range(SlantRange(0, 1.0, 0.01))
    for place in ((0, 0, 1), (50, -20, 1)):
        assert _sigmas(single.gaussian, _pose([0, 0, 0.7], place)) == pytest.approx(0, abs=1e-9)


def test_a_range_begins_at_its_sensor_and_goes_along_its_beam():
    b_T_s = _pose([0.1, -0.2, 0.5], (0.1, -0.05, -0.06))
    w_T_b = _pose([0.05, 0.1, 1.0], (3, 4, 1.2))
    w_T_s = w_T_b @ b_T_s
    single = slant_range(SlantRange(0, w_T_s[2, 3] / w_T_s[2, 2], 0.01, b_T_s))
    assert _sigmas(single.gaussian, w_T_b) == pytest.approx(0, abs=1e-9)
    assert aligned(w_T_b[None], (single,))[0] == pytest.approx(w_T_b)


def test_a_gauge_prior_fixes_only_its_direction():
    """Held along the world's x at a pose that looks along y: only a step along x is told."""
    T = _pose([0.2, -0.3, np.pi / 2])
    factor = gauge_prior(0, T, np.array([[0, 0, 0, 1.0, 0, 0]]))
    for step, told in (((1, 0, 0), True), ((0, 1, 0), False), ((0, 0, 1), False)):
        moved = T.copy()
        moved[:3, 3] += 1e-6 * np.array(step)
        assert _sigmas(factor, moved) == pytest.approx(1.0 if told else 0.0, abs=1e-3)


def test_fixed_directions_have_no_variance_and_others_have():
    s = solve(flight(1, attitude_std=(0.01, 0.01, 0.02)).measurements)
    assert s.covariances is not None
    R = s.w_T_b[0, :3, :3]
    in_world = R @ s.covariances[0, 3:, 3:] @ R.T
    assert in_world[0, 0] < 1e-7
    assert in_world[1, 1] < 1e-7
    assert 1e-6 < in_world[2, 2] < 1e-3


@pytest.mark.parametrize("known", ["attitude", "positions"])
def test_a_trajectory_is_moved_to_its_measurements(known: str):
    made = flight(3, attitude_std=(1e-6, 1e-6, 1e-6), position_std=1e-6)
    m = made.measurements
    singles = [position(p) for p in m.positions]
    singles += [attitude(a) for a in m.attitudes] if known == "attitude" else []
    move = se3.exp(np.array([[0.3, -0.4, 2.0, 5, 6, 7.0]]))[0]
    moved = aligned(move @ made.truth, tuple(s for s in singles if s is not None))
    np.testing.assert_allclose(moved, made.truth, atol=1e-3)


def test_a_fixed_heading_is_about_the_vertical_of_the_world():
    T = _pose([0.4, -0.3, 1.0])
    factor = gauge_prior(0, T, np.array([[0, 0, 1.0, 0, 0, 0]]))
    for axis, told in ((2, 1.0), (0, 0.0), (1, 0.0)):
        turned = T.copy()
        turned[:3, :3] = Rotation.from_rotvec(1e-6 * np.eye(3)[axis]).as_matrix() @ T[:3, :3]
        assert _sigmas(factor, turned) == pytest.approx(told, abs=1e-3)


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.0])
def test_one_sigma_of_a_range_is_one_sigma_at_any_tilt(tilt: float):
    range_m, std_m = 2.0, 0.03
    w_T = np.eye(4)
    w_T[:3, :3] = Rotation.from_euler("x", tilt).as_matrix()
    w_T[2, 3] = range_m * np.cos(tilt)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(w_T))
    unary = slant_range(SlantRange(0, range_m + std_m, std_m), float(np.cos(tilt)))
    assert unary.gaussian.error(values) == pytest.approx(0.5)


@pytest.mark.parametrize("std", [(0.01, 0.02), (0.02, 0.01)])
def test_the_larger_tilt_deviation_holds_without_a_heading(std: tuple[float, float]):
    level = attitude(Attitude(0, np.array([0.0, 0.0, np.nan]), np.array([*std, np.inf])))
    assert level is not None
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3.Rx(0.02), np.zeros(3)))
    assert level.gaussian.error(values) == pytest.approx(0.5, rel=1e-3)
