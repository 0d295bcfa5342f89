import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.measurements import RelativePose
from frontend.camera import NADIR_B_T_C, Camera
from frontend.registration import Registration
from slam.mapping.homography_chain import chain

MOUNT = NADIR_B_T_C.copy()
MOUNT[:3, :3] = Rotation.from_euler("y", -8, degrees=True).as_matrix() @ NADIR_B_T_C[:3, :3]
CAMERAS = {
    "down-looking": Camera((256.0, 250.0), (160.0, 118.0), (320, 240)),
    "tilted mount": Camera((256.0, 250.0), (160.0, 118.0), (320, 240), b_T_c=MOUNT),
}


def poses(seed: int, n: int = 12) -> np.ndarray:
    """(n, 4, 4), the first one over the origin with heading 0."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (n, 1, 1))
    angles = rng.normal(0, [0.2, 0.04, 0.04], (n, 3))
    angles[0, 0] = 0.0
    T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    T[:, :3, 3] = np.column_stack([0.1 * np.arange(n), 0.05 * rng.normal(size=n), rng.uniform(0.7, 0.9, n)])
    T[0, :2, 3] = 0.0
    return T


def link(j: int, i_H_j: np.ndarray) -> Registration:
    nothing = np.empty((0, 2), np.int64)
    return Registration(j - 1, j, None, nothing, i_H_j / i_H_j[2, 2], 0.01 * np.eye(8), 0.1, 0.8)


def links(w_T_b: np.ndarray, camera: Camera) -> list[Registration | None]:
    """Exact homographies of neighbours."""
    floor_H = [camera.floor_H_image(T) for T in w_T_b]
    return [None] + [link(k, np.linalg.inv(floor_H[k - 1]) @ floor_H[k]) for k in range(1, len(w_T_b))]


def angles_of(w_T_b: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")[:, [2, 1]]


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("seed", range(3))
def test_exact_homographies_give_exact_poses(name, seed):
    """From the first keyframe's attitude and height alone: nobody else's is looked at."""
    truth = poses(seed)
    roll_pitch, height = angles_of(truth), truth[:, 2, 3].copy()
    roll_pitch[1:], height[1:] = np.nan, np.nan
    found = chain(links(truth, CAMERAS[name]), CAMERAS[name], roll_pitch, height)
    assert found == pytest.approx(truth, abs=1e-6)


def test_a_bridge_across_a_broken_link_continues_it():
    """The bridge gives heading and place; tilt and height behind it are those of the keyframe itself."""
    truth, camera = poses(4), CAMERAS["tilted mount"]
    broken = links(truth, camera)
    broken[5] = broken[9] = None
    across = np.linalg.inv(truth[4]) @ truth[5]
    tilted = across.copy()
    tilted[:3, :3] = across[:3, :3] @ Rotation.from_euler("x", 1, degrees=True).as_matrix()
    bridge = RelativePose(4, 5, tilted, np.eye(6), "inertial")
    found = chain(broken, camera, angles_of(truth), truth[:, 2, 3], (bridge,))
    assert found[:9] == pytest.approx(truth[:9], abs=2e-3)
    assert found[5, 2, 3] == pytest.approx(truth[5, 2, 3], abs=1e-9)
    assert angles_of(found[5:6]) == pytest.approx(angles_of(truth[5:6]), abs=1e-9)
    assert np.isnan(found[9:]).all(), "no bridge leads there"


def test_a_broken_link_ends_it():
    truth, camera = poses(4), CAMERAS["down-looking"]
    broken = links(truth, camera)
    broken[5] = None
    found = chain(broken, camera, angles_of(truth), truth[:, 2, 3])
    assert found[:5] == pytest.approx(truth[:5], abs=1e-6)
    assert np.isnan(found[5:]).all()


def test_the_chain_drifts_as_its_links_err():
    """One link off by 1 %: all behind it are, none before."""
    truth, camera = poses(5), CAMERAS["down-looking"]
    some = links(truth, camera)
    some[6] = link(6, some[6].i_H_j @ np.diag([1.01, 1.01, 1.0]))
    found = chain(some, camera, angles_of(truth), truth[:, 2, 3])
    assert found[:6] == pytest.approx(truth[:6], abs=1e-6)
    off = np.linalg.norm(found[6:, :3, 3] - truth[6:, :3, 3], axis=1)
    assert (off > 0.003).all()
    assert (off < 0.05).all()


def test_nothing_and_one_keyframe():
    camera = CAMERAS["down-looking"]
    assert chain([], camera, np.empty((0, 2)), np.empty(0)).shape == (0, 4, 4)
    alone = chain([None], camera, np.array([[0.02, -0.03]]), np.array([0.8]))
    assert alone[0, :3, 3] == pytest.approx([0, 0, 0.8])
    assert alone[0, 2, 0] == pytest.approx(np.sin(0.03), rel=1e-6)
