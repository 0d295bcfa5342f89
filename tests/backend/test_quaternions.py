import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend import quaternions


def test_products_inverses_and_vectors_are_those_of_scipy():
    v = np.random.default_rng(1).normal(size=(2, 200, 3)) * np.geomspace(1e-12, 3, 200)[:, None]
    p, q = (Rotation.from_rotvec(turns) for turns in v)
    ours = quaternions.product(p.as_quat(), quaternions.inverse(q.as_quat()))
    np.testing.assert_allclose(quaternions.rotation_vectors(ours), (p * q.inv()).as_rotvec(), atol=1e-14)


def test_vectors_of_no_turn_and_of_turns_beyond_half():
    v = np.array([[0, 0, 0], [0, 0, np.pi - 1e-9], [0, 1e-200, 0]])
    q = Rotation.from_rotvec(v).as_quat()
    for sign in (1, -1):
        np.testing.assert_allclose(quaternions.rotation_vectors(sign * q), v, rtol=1e-7)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_composed_turns_are_those_taken_one_after_the_other(count):
    turns = Rotation.from_rotvec(0.1 * np.random.default_rng(2).normal(size=(count, 3)))
    attitude = [Rotation.identity()]
    for k in range(count):
        attitude.append(attitude[-1] * turns[k])
    expected = np.array([each.as_quat() for each in attitude])
    np.testing.assert_allclose(quaternions.composed(turns.as_quat().reshape(-1, 4)), expected, atol=1e-14)
