"""Rolling shutter and motion blur against a dense reference: a pose of its own for each row and instant."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from slam.simulation.camera import shutter
from slam.simulation.camera.effects import CameraEffects, camera_effects, true_camera
from slam.simulation.camera.film import film_flight
from slam.simulation.camera.optics import CameraModel, expose
from slam.simulation.place.obstacles import Box, Pylon
from slam.simulation.place.scene import build_scene
from slam.simulation.place.world import World

MODEL = CameraModel(noise_std=0.0)
PUZZLE = World(extent_m=(0.0, 0.0, 3.0, 3.0), margin_m=0.6)
GYM = replace(
    PUZZLE,
    boxes=(Box((1.15, 1.2), (0.3, 0.2, 0.3), 20), Box((1.4, 1.5), (0.2, 0.4, 0.15), -30)),
    pylons=(Pylon((1.3, 0.95), 0.06, 1.2),),
)
DURATION_S = 2.0
STRAIGHT, BENT = (0.0, 0.0, 0.0, 0.0), (-0.1, 0.02, 0.0, 0.0)


def restless(seed):
    """Flies, turns and jitters: the tilt's target wanders, thrice a healthy vehicle's, the tilt follows."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, DURATION_S + 1e-9, 0.002)
    target = lfilter([np.sqrt(2 * 0.002 / 0.25)], [1, 0.002 / 0.25 - 1], rng.standard_normal((2, len(times))))
    tilt = np.radians(1.5) * lfilter([0.02], [1, -0.98], target)

    def pose_at(t):
        jitter = [np.interp(t, times, axis) for axis in tilt]
        angles = np.column_stack(
            [0.9 * t, 0.08 * np.sin(5 * t) + jitter[0], 0.05 * np.cos(7 * t) + jitter[1]]
        )
        w_T_b = np.tile(np.eye(4), (len(t), 1, 1))
        w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
        w_T_b[:, :3, 3] = np.column_stack([0.8 + 0.6 * t, 1 + 0.3 * t, 0.8 + 0.1 * np.sin(3 * t)])
        return w_T_b

    return pose_at


def film_of(effects, pose_at, world=PUZZLE, marks=(), model=MODEL):
    return film_flight(world, marks, model, effects, np.arange(0.2, 1.8, 0.1), pose_at, DURATION_S, 0)


@pytest.mark.parametrize("readout_s", [0.01, 0.03, 0.05, 0.2])
def test_rows_are_seen_from_where_the_camera_is_in_their_time(readout_s):
    """In pixels, for all rows of several pictures."""
    effects, pose_at = CameraEffects(readout_s=readout_s), restless(0)
    film = film_of(effects, pose_at)
    camera = MODEL.camera()
    worst = 0.0
    for k in range(0, len(film.stamps_s), 3):
        w_R_c, w_t_c = shutter.row_poses(film.w_T_b[k] @ camera.b_T_c, 144, 0, 1, effects)
        exact = pose_at(film.stamps_s[k] + readout_s * np.arange(144) / 143) @ camera.b_T_c
        for row in range(144):
            pixel = np.array([[0.0, row], [87.5, row], [175.0, row]])
            true = floor(camera, exact[row], pixel)
            used = np.eye(4)
            used[:3, :3], used[:3, 3] = w_R_c[row], w_t_c[row]
            off_m = floor(camera, used, pixel) - true
            worst = max(worst, np.abs(off_m).max() * camera.focal_px[0] / 0.8)
    assert worst < 0.03


def floor(camera, w_T_c, pixel):
    ray = camera.rays(pixel) @ w_T_c[:3, :3].T
    return w_T_c[:2, 3] - w_T_c[2, 3] * ray[:, :2] / ray[:, 2:]


@pytest.mark.parametrize(
    ("distortion", "world"),
    [
        (BENT, GYM),
        pytest.param(BENT, PUZZLE, marks=pytest.mark.slow),
        pytest.param(STRAIGHT, PUZZLE, marks=pytest.mark.slow),
        pytest.param(STRAIGHT, GYM, marks=pytest.mark.slow),
    ],
)
def test_a_rolling_picture_is_made_of_the_rows_of_pictures_of_their_time(distortion, world):
    model = CameraModel(noise_std=0.0, distortion=distortion)
    effects, pose_at = CameraEffects(readout_s=0.04), restless(1)
    film, scene = film_of(effects, pose_at, world, model=model), build_scene(world, ())
    picture = film(5).astype(float)
    exact = pose_at(film.stamps_s[5] + 0.04 * np.arange(144) / 143)
    dense = np.stack([expose(scene, model.camera(), w_T_b)[row] for row, w_T_b in enumerate(exact)])
    still = expose(scene, model.camera(), exact[0]).astype(float)
    difference = np.abs(picture - dense)
    assert difference.mean() < 0.5
    assert np.quantile(difference, 0.999) < 8
    # And it is another picture than that of the first row's time.
    assert np.abs(still - dense)[100:].mean() > 10 * difference.mean()


def test_blur_is_the_mean_over_the_exposure_centred_on_the_stamp():
    effects, pose_at = CameraEffects(exposure_s=0.02), restless(2)
    film, scene = film_of(effects, pose_at), build_scene(PUZZLE, ())
    for k in (2, 9):
        times = film.stamps_s[k] + 0.02 * ((np.arange(120) + 0.5) / 120 - 0.5)
        dense = np.mean([expose(scene, MODEL.camera(), w_T_b) for w_T_b in pose_at(times)], axis=0)
        difference = film(k) - dense
        sharp = expose(scene, MODEL.camera(), pose_at(film.stamps_s[k : k + 1])[0])
        assert difference.std() < 0.12 * (sharp - dense).std()
        assert abs(difference.mean()) < 0.6


def test_rolling_and_blur_together_are_both():
    effects, pose_at = CameraEffects(readout_s=0.03, exposure_s=0.015), restless(3)
    film, scene = film_of(effects, pose_at), build_scene(PUZZLE, ())
    picture = film(7)
    parts = (np.arange(60) + 0.5) / 60 - 0.5
    for row in (0, 71, 143):
        times = film.stamps_s[7] + 0.03 * row / 143 + 0.015 * parts
        dense = np.mean([expose(scene, MODEL.camera(), w_T_b)[row] for w_T_b in pose_at(times)], axis=0)
        assert np.abs(picture[row] - dense).mean() < 2.0


def test_a_smear_has_the_length_of_the_catalogue(tmp_path):
    """L = f v t / h: a step edge becomes a ramp of that length."""
    import cv2

    edge = np.zeros((600, 600, 3), np.uint8) + 40
    edge[:, 300:] = 200
    cv2.imwrite(str(tmp_path / "edge.png"), edge)
    world = World(str(tmp_path / "edge.png"), (0.0, 0.0, 3.0, 3.0), 0.0, 0.005)
    effects = CameraEffects(exposure_s=0.025)

    def pose_at(t):
        w_T_b = np.tile(np.eye(4), (len(t), 1, 1))
        w_T_b[:, 0, 3], w_T_b[:, 1, 3], w_T_b[:, 2, 3] = 0.9 + 1.2 * t, 1.5, 0.8
        return w_T_b

    film = film_flight(world, (), MODEL, effects, np.array([0.5]), pose_at, 1.0, 0)
    # Forward is up in the picture: the edge is a row, and columns run across it.
    column = film(0)[:, 88, 0].astype(float)
    share = np.clip((column - 40) / 160, 0, 1)
    # Variance of the step's derivative: L^2/12 of the smear, and about 1/6 px^2 of the pixels' own.
    weight = np.abs(np.diff(share))
    at = np.arange(len(weight))
    middle = (weight * at).sum() / weight.sum()
    variance = (weight * (at - middle) ** 2).sum() / weight.sum()
    smear_px = MODEL.camera().focal_px[0] * 1.2 * 0.025 / 0.8
    assert np.sqrt(12 * (variance - 1 / 6)) == pytest.approx(smear_px, rel=0.06)
    # 0.5 s after the start it looks down from x = 1.5, where the edge is: no bias.
    assert middle + 0.5 == pytest.approx(71.5, abs=0.15)


def test_a_time_offset_shows_what_was():
    pose_at, scene = restless(4), build_scene(PUZZLE, ())
    film = film_of(CameraEffects(time_offset_s=0.06), pose_at)
    past = expose(scene, MODEL.camera(), pose_at(film.stamps_s[3:4] - 0.06)[0])
    assert np.array_equal(film(3), past)
    # Before the first moment of the flight there is nothing to be seen but that moment.
    early = film_flight(
        PUZZLE, (), MODEL, CameraEffects(time_offset_s=0.5), np.array([0.1]), pose_at, DURATION_S, 0
    )
    assert np.array_equal(early(0), expose(scene, MODEL.camera(), pose_at(np.zeros(1))[0]))


def test_neutral_effects_leave_one_pose_and_the_bytes_alone():
    pose_at = restless(5)
    film = film_of(CameraEffects(), pose_at)
    assert film.w_T_b.shape == (len(film.stamps_s), 1, 4, 4)
    assert np.array_equal(film(0), expose(build_scene(PUZZLE, ()), MODEL.camera(), film.w_T_b[0, 0]))
    assert camera_effects({}) == CameraEffects()
    assert true_camera(MODEL.camera(), CameraEffects()).focal_px == MODEL.camera().focal_px
