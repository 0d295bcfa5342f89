import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from backend.measurements import Position
from slam.mapping.gps.georeferencing import align_with_positions

STD = np.array([5.0, 5.0, 10.0])


def made_map(rng: np.random.Generator, n: int = 30) -> np.ndarray:
    """(n, 4, 4) tilted poses in mean heights over the floor z = 0."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("ZYX", rng.normal(0, [1.0, 0.1, 0.1], (n, 3))).as_matrix()
    T[:, :3, 3] = np.column_stack([rng.uniform(-3, 3, (n, 2)), rng.uniform(0.8, 1.2, n)])
    return T


def moved(w_T_b: np.ndarray, scale: float, yaw: float, shift: np.ndarray) -> np.ndarray:
    R = Rotation.from_euler("z", yaw).as_matrix()
    out = w_T_b.copy()
    out[:, :3, :3] = R @ w_T_b[:, :3, :3]
    out[:, :3, 3] = scale * w_T_b[:, :3, 3] @ R.T + shift
    return out


def positions(w_T_b: np.ndarray) -> list[Position]:
    return [Position(k, T[:3, 3], STD) for k, T in enumerate(w_T_b)]


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 500), st.floats(-3.1, 3.1), st.booleans())
@settings(max_examples=50, deadline=None, derandomize=True)
def test_the_similarity_is_recovered_although_some_positions_are_wild(seed, scale, yaw, metric):
    """Eight of thirty are far off; the map stays level and keeps its shape."""
    rng = np.random.default_rng(seed)
    here = made_map(rng)
    scale = 1.0 if metric else scale
    shift = rng.normal(0, 100, 3)
    truth = moved(here, scale, yaw, shift)
    told = positions(truth)
    for k in rng.choice(30, 8, replace=False):
        wrong = told[k].w_p_antenna_m + scale * rng.normal(0, 30, 3)
        told[k] = Position(int(k), wrong, STD)
    placed, floor_z = align_with_positions(here, told, metric)
    assert placed == pytest.approx(truth, abs=1e-3 * scale)
    assert floor_z == pytest.approx(shift[2], abs=1e-3 * scale)


def test_a_metric_map_keeps_its_size():
    here = made_map(np.random.default_rng(1))
    placed, _ = align_with_positions(here, positions(moved(here, 1.3, 0.5, np.zeros(3))), metric=True)
    assert np.ptp(placed[:, 2, 3]) == pytest.approx(np.ptp(here[:, 2, 3]))
    assert np.linalg.norm(placed[3, :3, 3] - placed[9, :3, 3]) == pytest.approx(
        np.linalg.norm(here[3, :3, 3] - here[9, :3, 3])
    )


def test_level_stays_level():
    """Noise in the positions' heights turns nothing but the heading."""
    rng = np.random.default_rng(2)
    here = made_map(rng)
    told = [Position(p.k, p.w_p_antenna_m + rng.normal(0, 0.5, 3), STD) for p in positions(here)]
    placed, floor_z = align_with_positions(here, told, metric=False)
    assert placed[:, 2, :3] == pytest.approx(here[:, 2, :3], abs=1e-12)
    height = (placed[:, 2, 3] - floor_z) / here[:, 2, 3]
    assert np.ptp(height) < 1e-9


def test_keyframes_without_a_pose_or_a_position_do_not_matter():
    rng = np.random.default_rng(3)
    here = made_map(rng)
    truth = moved(here, 40.0, 1.0, np.array([1.0, 2.0, 3.0]))
    here[4] = np.nan
    told = [p for p in positions(truth) if p.k % 3]
    placed, _ = align_with_positions(here, told, metric=False)
    rest = np.arange(30) != 4
    assert placed[rest] == pytest.approx(truth[rest], abs=1e-6)
    assert np.isnan(placed[4]).all()


def test_the_given_map_is_left_as_it_was():
    here = made_map(np.random.default_rng(4))
    before = here.copy()
    align_with_positions(here, positions(moved(here, 2.0, 1.0, np.ones(3))), metric=False)
    assert np.array_equal(here, before)


@pytest.mark.parametrize("metric", [True, False])
def test_fewer_than_two_places_place_nothing(metric):
    here = made_map(np.random.default_rng(5))
    assert align_with_positions(here, [], metric) is None
    assert align_with_positions(here, positions(here)[:1], metric) is None
    standing = [Position(k, np.array([5.0, 6.0, 7.0]), STD) for k in range(30)]
    assert align_with_positions(here, standing, metric) is None
    lost = np.full_like(here, np.nan)
    assert align_with_positions(lost, positions(here), metric) is None
