"""Scenes of made cameras over a made floor, and errors of their refinements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from backend.bundle.refinement import Bundle
from backend.measurements import PinholeModel
from tests.backend.made_floor import CAMERA, NADIR, Made, Scene, aligned, nees

SEEDS = range(20)


def tilted_mount() -> np.ndarray:
    """A camera that looks 20 degrees forward and sits off the body's origin."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", -20, degrees=True).as_matrix() @ NADIR[:3, :3]
    T[:3, 3] = [0.10, 0.02, -0.05]
    return T


SONAR = Scene()
SURVEY = Scene(height_m=50.0, relief=0.01, attitude_std_rad=None, range_std_m=None, position_std_m=(1.0, 2.0))
AT_ONE_HEIGHT = replace(
    SURVEY,
    position_std_m=(0.02, 0.03),
    height_swing=0.0,
    relief=0.002,
    pixel_std=0.1,
    tilt_std_rad=0.003,
    camera=replace(CAMERA, focal_std_ratio=0.02),
)
"""Positions of an RTK receiver at one height, and a focal length that is known to 2 %: nothing tells it, and
with it the height of the floor."""
HELD_BY_POSITIONS = replace(SURVEY, position_std_m=(0.02, 0.03), pixel_std=0.5, attitude_std_rad=0.03)
"""Positions of an RTK receiver hold the cameras: at 50 m a lean of 0.03 rad looks like 1.5 m."""
WRONG_LENS = replace(
    SURVEY,
    keyframes=32,
    height_swing=0.15,
    tilt_std_rad=0.1,
    position_std_m=(0.02, 0.03),
    size_px=(1280.0, 960.0),
    camera=PinholeModel(
        (1024.0, 1024.0),
        (639.5, 479.5),
        NADIR,
        focal_std_ratio=0.03,
        center_std_px=20.0,
        radial_std=0.1,
        tangential_std=0.002,
    ),
    focal_ratio=1.03,
    center_off_px=(20.0, -20.0),
    radial=0.1,
    tangential=(0.002, -0.001),
)
"""A lens whose told calibration is wrong by a deviation in each number, and positions of an RTK receiver."""
FISHEYE = replace(
    WRONG_LENS, radial=0.0, tangential=(0.0, 0.0), fisheye=(0.05, -0.02, 0.0, 0.0), keyframes=16
)
"""An equidistant fisheye of which nothing is told: a pinhole without distortion is."""
ROUGH = replace(SONAR, relief=0.03)
SCENES = {
    "sonar": SONAR,
    "sonar, no attitude": replace(SONAR, attitude_std_rad=None),
    "pixels three times as noisy as stated": replace(SONAR, pixel_std=0.9),
    "relief": replace(SONAR, relief=0.02),
    "relief and a coarse sonar": replace(SONAR, relief=0.03, range_std_m=0.05),
    "tilted mount": replace(SONAR, camera=replace(CAMERA, b_T_c=tilted_mount())),
    "gps": SURVEY,
    "gps and attitude": replace(SURVEY, attitude_std_rad=0.01),
    "gps over a slope": replace(SURVEY, slope_rad=(0.04, -0.03)),
    "gps and attitude over a slope": replace(SURVEY, attitude_std_rad=0.01, slope_rad=(0.04, -0.03)),
    "gps, camera unknown": replace(
        SURVEY,
        camera=replace(CAMERA, focal_std_ratio=0.03, radial_std=0.05),
        focal_ratio=1.02,
        radial=-0.03,
        tilt_std_rad=0.15,
    ),
    "rtk, lens wrong": WRONG_LENS,
}


def errors_squared(made: Made, bundle: Bundle) -> np.ndarray:
    """NEES of all poses, or of all but the first where that one is the origin."""
    if made.measurements.positions:
        return nees(bundle.w_T_b, made.w_T_b, bundle.covariances)
    hat = aligned(bundle.w_T_b, made.w_T_b)
    return nees(hat[1:], made.w_T_b[1:], bundle.covariances[1:])


def position_rms(made: Made, w_T_b: np.ndarray) -> float:
    hat = w_T_b if made.measurements.positions else aligned(w_T_b, made.w_T_b)
    return float(np.sqrt(np.mean(np.sum((hat - made.w_T_b)[:, :3, 3] ** 2, axis=1))))


def turned(made: Made, quarters: np.ndarray) -> Made:
    """Return the flight with each body turned by quarter turns: an error in body axes is then none of the
    world."""
    angle = 0.5 * np.pi * quarters
    turn = np.tile(np.eye(4), (len(quarters), 1, 1))
    turn[:, :3, :3] = Rotation.from_euler("z", angle[:, None]).as_matrix()
    tracks, center = made.measurements.tracks, np.array(CAMERA.center_px)
    # The camera looks along -z of the body, so its picture turns the other way.
    in_picture = Rotation.from_euler("z", angle[tracks.keyframe][:, None]).as_matrix()[:, :2, :2]
    pixel = center + np.einsum("mab,mb->ma", in_picture, tracks.pixel - center)
    measurements = replace(made.measurements, tracks=replace(tracks, pixel=pixel))
    return replace(made, measurements=measurements, start=made.start @ turn, w_T_b=made.w_T_b @ turn)
