from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.simulation.camera.effects import CameraEffects, camera_effects, true_camera
from slam.simulation.camera.film import film_flight
from slam.simulation.camera.optics import CameraModel, expose
from slam.simulation.place.moving_objects import MovingObjects
from slam.simulation.place.obstacles import HALF_LENGTH, X, Y
from slam.simulation.place.reflections import LAMP_HEIGHT_M, LAMP_SPACING_M
from slam.simulation.place.scene import build_scene
from slam.simulation.place.world import World
from slam.simulation.terms import CATALOGUE

MODEL = CameraModel(noise_std=0.0)
PLAIN = World("plain", (0.0, 0.0, 3.0, 3.0), 0.6, 0.004)
PUZZLE = World(extent_m=(0.0, 0.0, 3.0, 3.0), margin_m=0.6)
STAMPS_S = np.arange(0.2, 9.9, 0.1)
MARKS = tuple(
    (name, 1.5 + dx, 1.5 + dy) for name, dx, dy in (("A", -0.19, 0.19), ("B", 0.17, -0.2), ("C", 0, 0))
)


def pose_at(times_s):
    w_T_b = np.tile(np.eye(4), (len(times_s), 1, 1))
    angles = np.column_stack([0.3 + 0 * times_s, 0.03 * np.sin(times_s), 0.02 * np.cos(times_s)])
    w_T_b[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    w_T_b[:, :3, 3] = np.column_stack([1.5 + 0.01 * times_s, 1.5 + 0 * times_s, 0.8 + 0 * times_s])
    return w_T_b


def film_of(effects=CameraEffects(), world=PUZZLE, marks=(), model=MODEL, seed=0):
    return film_flight(world, marks, model, effects, STAMPS_S, pose_at, 10.0, seed)


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(CameraEffects(focal_eps=0.29), marks=pytest.mark.slow),
        pytest.param(CameraEffects(focal_eps=-0.2), marks=pytest.mark.slow),
        pytest.param(CameraEffects(radial_k1=0.3), marks=pytest.mark.slow),
        pytest.param(CameraEffects(radial_k1=-0.2), marks=pytest.mark.slow),
        pytest.param(CameraEffects(tilt_x_rad=0.08, tilt_y_rad=-0.05), marks=pytest.mark.slow),
        CameraEffects(focal_eps=0.1, radial_k1=-0.1, tilt_y_rad=0.05),
    ],
)
def test_marks_are_seen_where_the_true_camera_projects_them(effects):
    """To a tenth of a pixel; the nominal camera would have them elsewhere."""
    model = CameraModel((704, 576), noise_std=0.0, distortion=(0.02, -0.01, 0.001, 0.002))
    film = film_of(effects, PLAIN, MARKS, model)
    assert film.nominal_camera.distortion == model.distortion
    picture, camera = film(0).astype(float).mean(2), true_camera(film.nominal_camera, effects)
    off_stated = []
    for _, x, y in MARKS:
        turn = np.linspace(0, 2 * np.pi, 360)
        rim = np.column_stack([x + 0.06 * np.cos(turn), y + 0.06 * np.sin(turn), 0 * turn])
        seen = [
            cam.project((rim - w_T_c[:3, 3]) @ w_T_c[:3, :3])
            for cam in (camera, film.nominal_camera)
            for w_T_c in (film.w_T_b[0, 0] @ cam.b_T_c,)
        ]
        if seen[0].min() < 3 or (seen[0] > np.array(camera.size_px) - 4).any():
            continue
        mask = np.zeros(picture.shape, np.uint8)
        cv2.fillPoly(mask, [np.int32(np.rint(seen[0] * 16))], 255, shift=4)
        near = cv2.dilate(mask, np.ones((7, 7), np.uint8)) > 0
        outer = (np.abs(picture - 128) > 40) & near
        # The outline of what is not floor, against the projected rim.
        contours, _ = cv2.findContours(outer.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        disc = cv2.moments(max(contours, key=cv2.contourArea).astype(np.float32))
        rim_moments = cv2.moments(seen[0].astype(np.float32)[:, None])
        centers = [np.array([m["m10"], m["m01"]]) / m["m00"] for m in (disc, rim_moments)]
        assert np.hypot(*(centers[0] - centers[1])) < 0.35
        off_stated.append(np.hypot(*(centers[0] - seen[1].mean(0))))
    assert len(off_stated) >= 2
    assert max(off_stated) > 3


def test_the_catalogue_s_camera_terms_all_have_their_effect():
    def reached(name, parameter):
        one = camera_effects({name: {parameter: 1.0}})
        return one != CameraEffects(), one

    seen = set()
    for term in CATALOGUE.values():
        on_pictures = (term.family == "camera" or term.name == "moving_objects") and term.acts_on != "sensor"
        for parameter in term.parameters:
            acts, effects = reached(term.name, parameter.name)
            assert acts == on_pictures, (term.name, parameter.name)
            if acts:
                seen |= {f.name for f in fields(CameraEffects) if getattr(effects, f.name) != f.default}
    assert seen == {f.name for f in fields(CameraEffects)}


def test_tilt_turns_about_the_body_s_axes():
    """About x it looks to the left, what is straight below moves right; about y back, and that moves up."""
    camera = MODEL.camera()
    below = np.array([[0.0, 0.0, -1.0]])
    for effects, axis, sign in (
        (CameraEffects(tilt_x_rad=0.05), 0, 1),
        (CameraEffects(tilt_y_rad=0.05), 1, -1),
    ):
        true = true_camera(camera, effects)
        pixel = true.project(below @ true.b_T_c[:3, :3])[0] - camera.center_px
        assert pixel[axis] * sign == pytest.approx(camera.focal_px[0] * np.tan(0.05))
        assert pixel[1 - axis] == pytest.approx(0, abs=1e-9)


def test_beyond_the_fold_of_a_lens_it_is_dark():
    picture = film_of(CameraEffects(radial_k1=-0.3))(0)
    x, y = np.meshgrid(np.arange(176) - 87.5, np.arange(144) - 71.5)
    r = np.hypot(x, y) / MODEL.camera().focal_px[0]
    # x (1 + k1 x^2) grows up to x = 1 / sqrt(3 |k1|), where it is two thirds of that.
    edge = 2 / 3 / np.sqrt(0.9)
    assert (picture[r > edge + 0.02] == 0).all()
    assert picture[r < edge - 0.02].min() > 0
    assert film_of(CameraEffects(radial_k1=-0.2))(0).min() > 0


def test_dropped_pictures_leave_the_others_as_they_were():
    whole = film_of(CameraEffects(gain_std=0.1, tone_time_s=0.5), model=CameraModel())
    thinned = film_of(CameraEffects(gain_std=0.1, tone_time_s=0.5, dropped_share=0.3), model=CameraModel())
    assert 0.15 < 1 - len(thinned.stamps_s) / len(whole.stamps_s) < 0.45
    assert set(thinned.stamps_s) < set(whole.stamps_s)
    for k in (0, 11, 30):
        at = int(np.flatnonzero(whole.stamps_s == thinned.stamps_s[k])[0])
        assert np.array_equal(thinned(k), whole(at))
    assert len(film_of(CameraEffects(dropped_share=1.0)).stamps_s) == 1
    shares = [
        len(
            film_flight(
                PLAIN, (), MODEL, CameraEffects(dropped_share=0.1), STAMPS_S, pose_at, 10.0, s
            ).stamps_s
        )
        for s in range(100)
    ]
    assert 1 - np.mean(shares) / len(STAMPS_S) == pytest.approx(0.1, abs=0.01)


ALL = CameraEffects(
    0.02, -0.1, 0.01, 0.02, 0.01, 0.02, 0.01, 0.1, 0.1, 0.5, 0.2, 0.5, 0.1, moving_objects=5
)  # fmt: skip


def test_all_at_once_is_the_same_in_any_order_and_in_threads():
    assert all(getattr(ALL, f.name) != f.default for f in fields(ALL))
    film, again = film_of(ALL, model=CameraModel()), film_of(ALL, model=CameraModel())
    forward = [film(k) for k in range(12)]
    assert all(np.array_equal(again(k), forward[k]) for k in (7, 0, 11, 3))
    with ThreadPoolExecutor(2) as pool:
        assert all(np.array_equal(*pair) for pair in zip(pool.map(again, range(12)), forward, strict=True))
    assert not np.array_equal(film_of(ALL, model=CameraModel(), seed=1)(0), forward[0])


def test_tone_and_vignetting_act_on_the_picture():
    film = film_of(CameraEffects(gain_std=0.1, gamma_std=0.2))
    plain = film_of()
    for k in (0, 5):
        expected = 255 * film.tones[k, :3] * (plain(k) / 255.0) ** film.tones[k, 3]
        assert film(k) == pytest.approx(np.clip(expected, 0, 255), abs=0.51)
    even = film_of(CameraEffects(vignetting=0.4), PLAIN)(0).astype(float)
    assert even[0, 0] == pytest.approx(0.6 * 128, abs=0.6)
    assert even[71, 87] == pytest.approx(128, abs=0.6)


def test_down_sampling_loses_detail_but_not_place():
    sharp = film_of()(0)
    soft = film_of(model=replace(MODEL, down_sampling=2.5))(0)
    details = [np.abs(cv2.Laplacian(p.astype(np.float32), cv2.CV_32F)).mean() for p in (sharp, soft)]
    assert details[1] < 0.4 * details[0]
    shift, _ = cv2.phaseCorrelate(*(p[..., 1].astype(np.float64) for p in (sharp, soft)))
    assert np.hypot(*shift) < 0.1


def test_a_reflection_travels_with_the_camera():
    """The spot on the floor moves h / (h + z) of the camera's way, whatever the floor."""
    camera, spots = MODEL.camera(), []
    for dx in (0.0, 0.1):

        def still(times_s, at=1.6 + dx):
            w_T_b = np.tile(np.eye(4), (len(times_s), 1, 1))
            w_T_b[:, :3, 3] = at, 1.9, 0.8
            return w_T_b

        film = film_flight(PLAIN, (), MODEL, CameraEffects(highlight=0.45), STAMPS_S[:1], still, 10.0, 0)
        light = film(0)[..., 0].astype(float) - 128
        here, lamp = np.array([1.6 + dx, 1.9]), np.array([LAMP_SPACING_M, LAMP_SPACING_M])
        expected = here + 0.8 / (0.8 + LAMP_HEIGHT_M) * (lamp - here)
        # Other lamps are seen too.
        grid = np.stack(np.meshgrid(np.arange(176.0), np.arange(144.0)), -1).reshape(-1, 2)
        on_floor = camera.floor_points(still(np.zeros(1))[0], grid)
        near = np.hypot(*(on_floor - expected).T) < 0.14
        weight = light.ravel()[near]
        spots.append((on_floor[near] * weight[:, None]).sum(0) / weight.sum())
        assert spots[-1] == pytest.approx(expected, abs=0.01)
        assert light.max() == pytest.approx(0.45 * 255, abs=3)
    assert (spots[1] - spots[0])[0] == pytest.approx(0.1 * LAMP_HEIGHT_M / (LAMP_HEIGHT_M + 0.8), abs=0.004)


def test_things_move_straight_and_stay_on_the_floor():
    extent = (-1.0, 0.0, 2.0, 4.0)
    moving = MovingObjects(20, extent, np.random.default_rng(0))
    times = np.linspace(0, 120, 4001)
    tracks = np.array([moving.at(t)[:, [X, Y]] for t in times])
    assert (tracks >= extent[:2]).all()
    assert (tracks <= extent[2:]).all()
    speed = np.linalg.norm(np.diff(tracks, axis=0), axis=2) / 0.03
    usual = np.median(speed, axis=0)
    assert ((usual > 0.1) & (usual < 0.6)).all()
    assert (np.abs(speed - usual) > 1e-9).mean() < 0.02
    # Each covers more than a tenth of the picture from 0.8 m.
    footprint = (176 * 144) * (0.8 / MODEL.camera().focal_px[0]) ** 2
    assert (np.pi * moving.prisms[:, HALF_LENGTH] ** 2 / footprint).min() > 0.09


def test_things_that_move_are_seen_to():
    world = replace(PLAIN, extent_m=(1.2, 1.2, 1.8, 1.8))
    film, empty = film_of(CameraEffects(moving_objects=3), world), film_of(world=world)
    changed = [(film(k) != empty(k)).any(2).mean() for k in (0, 20, 40)]
    assert min(changed) > 0.05
    assert not np.array_equal(film(0), film(20))
    scene = build_scene(world, (), 3, 0)
    later = expose(scene, film.nominal_camera, film.w_T_b[20, 0], float(film.stamps_s[20]))
    assert np.array_equal(film(20), later)
