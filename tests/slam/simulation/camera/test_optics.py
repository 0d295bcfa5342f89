import math
import pickle

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.simulation.camera.effects import CameraEffects
from slam.simulation.camera.film import film_flight
from slam.simulation.camera.optics import CameraModel, expose
from slam.simulation.place.scene import build_scene
from slam.simulation.place.world import World, build_floor

MODEL = CameraModel((320, 240))
CAMERA = MODEL.camera()
PUZZLE = World(extent_m=(0.0, 0.0, 2.0, 2.0), margin_m=0.6)
MARKED = World("plain", (0.0, 0.0, 2.0, 2.0), 0.6)
MARKS = (("A", 0.9012, 1.0537), ("B", 1.3, 0.8), ("K9", 1.0, 1.27))


def pose(x, y, z, roll_deg, pitch_deg, yaw_deg):
    w_T_b = np.eye(4)
    w_T_b[:3, :3] = Rotation.from_euler("ZYX", np.radians([yaw_deg, pitch_deg, roll_deg])).as_matrix()
    w_T_b[:3, 3] = x, y, z
    return w_T_b


def drawn_pose(rng):
    tilt = rng.uniform(-2.5, 2.5, 2)
    return pose(*rng.uniform(0.95, 1.1, 2), rng.uniform(0.75, 0.9), *tilt, rng.uniform(-180, 180))


def film_of(world, marks, poses, noise_std, seed):
    """A film that sees one pose after the other, one a second."""
    model, stamps_s = CameraModel((320, 240), noise_std=noise_std), np.arange(float(len(poses)))

    def pose_at(times_s):
        return poses[np.rint(times_s).astype(int)]

    return film_flight(world, marks, model, CameraEffects(), stamps_s, pose_at, float(len(poses)), seed)


def seen(camera, w_T_b, w_p):
    c_T_w = np.linalg.inv(w_T_b @ camera.b_T_c)
    return camera.project(w_p @ c_T_w[:3, :3].T + c_T_w[:3, 3])


def mark_center(picture, near):
    """Centroid of the disc nearest to ``near``: outline filled, the rim weighted by what it covers."""
    cover = np.clip((picture.astype(float).mean(2) - 128) / (245 - 128), 0, 1)
    outlines, _ = cv2.findContours((cover > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # The letter's holes are no outer outlines, so the nearest large one is the disc.
    discs = [c for c in outlines if cv2.contourArea(c) > 200]
    disc = min(discs, key=lambda c: np.hypot(*(c.reshape(-1, 2).mean(0) - near)))
    inside = cv2.drawContours(np.zeros(cover.shape, np.uint8), [disc], -1, 1, -1)
    core = cv2.erode(inside, np.ones((3, 3), np.uint8)) > 0
    around = cv2.dilate(inside, np.ones((5, 5), np.uint8)) > 0
    weight = np.where(core, 1.0, np.where(around, cover, 0.0))
    rows, cols = np.indices(weight.shape)
    return np.array([(weight * cols).sum(), (weight * rows).sum()]) / weight.sum()


def test_the_focal_length_is_that_of_the_horizontal_field_of_view():
    assert CAMERA.focal_px == pytest.approx((160 / math.tan(math.radians(32)),) * 2)
    assert CAMERA.center_px == (159.5, 119.5)


@pytest.mark.parametrize("seed", range(8))
def test_a_mark_appears_where_the_camera_projects_it(seed):
    w_T_b = drawn_pose(np.random.default_rng(seed))
    picture = expose(build_scene(MARKED, MARKS), CAMERA, w_T_b)
    checked = 0
    for _, x, y in MARKS:
        turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        rim = np.column_stack([x + 0.06 * np.cos(turn), y + 0.06 * np.sin(turn), 0 * turn])
        rim_px = seen(CAMERA, w_T_b, rim)
        if rim_px.min() < 4 or (rim_px > np.array(CAMERA.size_px) - 5).any():
            continue
        center = seen(CAMERA, w_T_b, np.array([[x, y, 0.0]]))[0]
        moments = cv2.moments(rim_px.astype(np.float32)[:, None])
        # A tilted disc is centred a little off its centre's picture: its projected rim knows where.
        expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        found = mark_center(picture, center)
        assert np.hypot(*(found - expected)) < 0.05
        assert np.hypot(*(found - center)) < 0.15
        checked += 1
    assert checked >= 1


@pytest.mark.parametrize("height_m", [0.8, *(pytest.param(h, marks=pytest.mark.slow) for h in (1.7, 3.4))])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_ramp_has_no_half_pixel_bias(tmp_path, height_m, axis):
    """Brightness linear in place: each pixel must show that of its own centre, at every mip level."""
    w_T_b = pose(2.4, 2.4, height_m, 1, -2, 25)
    grid = np.stack(np.meshgrid(np.arange(320), np.arange(240)), -1).reshape(-1, 2).astype(float)
    place = CAMERA.floor_points(w_T_b, grid)[:, axis]
    inside = np.abs(place - 2.4) < 0.18
    off_m = []
    # Rising and falling, a grey level a texel: a bias of rounding cancels, one of place does not.
    for first, slope in ((5, 1), (245, -1)):
        column = np.clip(first + slope * (np.arange(2400) - 1080), 5, 245).astype(np.uint8)
        texels = np.repeat(np.tile(column, (2400, 1))[..., None], 3, 2)
        texels = texels if axis == 0 else np.ascontiguousarray(texels.swapaxes(0, 1)[::-1])
        cv2.imwrite(str(tmp_path / f"{first}.png"), texels)
        scene = build_scene(World(str(tmp_path / f"{first}.png"), (0.0, 0.0, 4.8, 4.8), 0.0), ())
        picture = expose(scene, CAMERA, w_T_b)[..., 0].astype(float)
        shown = ((picture.ravel() - first) / slope + 1080.5) * 0.002
        off_m.append(np.mean((shown - place)[inside]))
    assert abs(np.mean(off_m)) < 0.02 * height_m / CAMERA.focal_px[0]


@pytest.mark.slow
@pytest.mark.parametrize(("height_m", "rms"), [(0.8, 1.0), (1.4, 1.7), (2.0, 2.2)])
def test_a_pixel_shows_the_mean_over_its_footprint(height_m, rms):
    """Against twelve times twelve samples a pixel from the finest texture."""
    floor, w_T_b, n = build_floor(PUZZLE, ()), pose(1, 1, height_m, 3, -2, 20), 12
    u, v = ((np.arange(size * n) + 0.5) / n - 0.5 for size in CAMERA.size_px)
    ray = np.stack([*np.meshgrid(u, v), np.ones((len(v), len(u)))])
    at = np.einsum("ij,jhw->ihw", floor.texel_H_world(0) @ CAMERA.floor_H_image(w_T_b), ray)
    at = (at[:2] / at[2]).astype(np.float32)
    texels = np.ascontiguousarray(floor.levels[0][..., :3])
    fine = cv2.remap(texels, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    mean = fine.astype(np.float32).reshape(240, n, 320, n, 3).mean((1, 3))
    difference = expose(build_scene(PUZZLE, ()), CAMERA, w_T_b) - mean
    assert difference.std() < rms
    assert abs(difference.mean()) < 0.4
    across, down = np.gradient(mean.mean(2), axis=1), np.gradient(mean.mean(2), axis=0)
    shift = np.linalg.lstsq(np.column_stack([across.ravel(), down.ravel()]), difference.mean(2).ravel())[0]
    assert np.abs(shift).max() < 0.005


@pytest.mark.parametrize("height_m", [2.4, 3.1, 5.0])
def test_detail_below_a_pixel_does_not_alias(tmp_path, height_m):
    """A chessboard of single texels, several of them to a pixel, is an even grey from high up."""
    board = (np.indices((1200, 1200)).sum(0) % 2 * 200 + 20).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "board.png"), np.repeat(board[..., None], 3, 2))
    scene = build_scene(World(str(tmp_path / "board.png"), (0.0, 0.0, 2.4, 2.4), 0.0), ())
    picture = expose(scene, CAMERA, pose(1.2, 1.2, height_m, 1, 2, 30))
    assert picture.std() < 2
    assert picture.mean() == pytest.approx(120, abs=1)


@pytest.mark.parametrize("seed", range(4))
def test_features_move_as_the_true_homography_says(seed):
    rng = np.random.default_rng(seed)
    a_T, b_T = pose(0.9, 1.0, 0.8, *rng.normal(0, 2, 2), 4), pose(1.15, 1.08, 0.83, *rng.normal(0, 2, 2), 9)
    film = film_of(PUZZLE, (), np.stack([a_T, b_T]), 2.0, seed)
    sift, found = cv2.SIFT_create(), []
    for k in (0, 1):
        points, descriptors = sift.detectAndCompute(cv2.cvtColor(film(k), cv2.COLOR_BGR2GRAY), None)
        found.append((np.array([p.pt for p in points]), descriptors))
    pairs = [
        m
        for m, n in cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
        if m.distance < 0.75 * n.distance
    ]
    a = found[0][0][[m.queryIdx for m in pairs]]
    b = found[1][0][[m.trainIdx for m in pairs]]
    estimated, _ = cv2.findHomography(a, b, cv2.USAC_MAGSAC, 1.0)
    b_H_a = np.linalg.inv(CAMERA.floor_H_image(b_T)) @ CAMERA.floor_H_image(a_T)
    grid = np.stack(np.meshgrid(np.linspace(90, 319, 12), np.linspace(0, 239, 9)), -1).reshape(1, -1, 2)
    apart = cv2.perspectiveTransform(grid, estimated) - cv2.perspectiveTransform(grid, b_H_a)
    assert len(pairs) > 100
    assert np.median(np.hypot(*apart[0].T)) < 0.15
    # The features themselves sit where SIFT's own accuracy puts them, centred: no half pixel anywhere.
    off = cv2.perspectiveTransform(a[None], b_H_a)[0] - b
    assert np.abs(np.median(off, axis=0)).max() < 0.05


def test_a_picture_is_the_same_whenever_it_is_read_and_by_whom():
    poses = np.stack([pose(1, 1 + 0.1 * k, 0.8, 0, 0, 0) for k in range(3)])
    film = film_of(PUZZLE, MARKS, poses, 2.0, 7)
    forward = [film(k) for k in range(3)]
    copy = pickle.loads(pickle.dumps(film))
    assert len(pickle.dumps(film)) < 5000
    assert all(np.array_equal(copy(k), forward[k]) for k in (2, 0, 1))
    other = film_of(PUZZLE, MARKS, poses, 2.0, 8)
    assert not np.array_equal(other(0), forward[0])


def test_noise_has_its_size_and_differs_between_pictures_and_channels():
    still = np.stack([pose(1, 1, 0.8, 0, 0, 0)] * 2)
    film = film_of(MARKED, (), still, 2.0, 0)
    noise = np.stack([film(0), film(1)]).astype(float) - 128
    # Rounding adds 1/12 of a grey level squared.
    assert noise.std() == pytest.approx(math.sqrt(4 + 1 / 12), rel=0.01)
    assert abs(noise.mean()) < 0.02
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(noise[0, ..., 0].ravel(), noise[0, ..., 1].ravel())[0, 1]) < 0.02
