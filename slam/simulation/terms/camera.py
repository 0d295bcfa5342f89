"""Terms of the camera: lens, mount, shutter and automatic exposure.

Symbols: f the focal length in px, h the height above the floor, r the distance from the image centre over
half the image's diagonal, omega the body rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import radians

import numpy as np

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.streams import Image
from slam.simulation.camera.effects import CameraEffects, true_camera
from slam.simulation.camera.photometry import Light, falloff
from slam.simulation.terms.term import BODY_AXES, Array, Parameter, Term, signed, size

LEAST_LIGHT = 0.1
"""Least vignetting that is corrected, relative to the centre; darker pixels hold no information."""


def _with_focal_length(flight: Flight, values: Array, std: float | None) -> Flight:
    camera = _camera(flight)
    true = true_camera(camera, CameraEffects(focal_eps=float(values[0])))
    known = camera.focal_std_ratio if std is None else std
    return replace(flight, camera=replace(true, focal_std_ratio=known))


def _with_distortion(flight: Flight, values: Array, std: float | None) -> Flight:
    camera = _camera(flight)
    true = true_camera(camera, CameraEffects(radial_k1=float(values[0])))
    return replace(flight, camera=replace(true, radial_std=camera.radial_std if std is None else std))


def _with_tilt(flight: Flight, values: Array, std: float | None) -> Flight:
    camera, (x, y) = _camera(flight), values.tolist()
    true = true_camera(camera, CameraEffects(tilt_x_rad=x, tilt_y_rad=y))
    return replace(flight, camera=replace(true, mount_std_rad=camera.mount_std_rad if std is None else std))


def _without_offset(flight: Flight, values: Array, std: float | None) -> Flight:
    """Move stamps: a picture stamped t shows the scene at t - offset."""
    return flight.restamped(("frames",), lambda stamps_s: stamps_s - values[0])


def _with_readout(flight: Flight, values: Array, std: float | None) -> Flight:
    """Set the readout time, which the front end compensates."""
    return replace(flight, camera=replace(_camera(flight), readout_s=float(values[0])))


def _without_vignetting(flight: Flight, values: Array, std: float | None) -> Flight:
    """Correct the vignetting of pictures when they are read."""
    camera, frames = _camera(flight), flight.frames
    assert frames is not None
    correct = vignetting_correction(falloff(camera.size_px, camera.center_px, float(values[0])))

    def load(k: int) -> Image | None:
        picture = frames.load(k)
        return None if picture is None else correct(picture)

    return replace(flight, frames=replace(frames, load=load))


def vignetting_correction(light: Light) -> Callable[[Image], Image]:
    """Return a function that divides pictures (h, w) or (h, w, 3) by the vignetting ``light`` (h, w).

    Pictures of another size stay unchanged.
    """
    gain = 1.0 / np.maximum(light, LEAST_LIGHT)

    def correct(picture: Image) -> Image:
        if picture.shape[:2] != gain.shape[:2]:
            return picture
        lit = np.rint(picture * gain.reshape(*gain.shape[:2], *[1] * (picture.ndim - 2)))
        return np.minimum(lit, np.iinfo(picture.dtype).max).astype(picture.dtype)

    return correct


def _camera(flight: Flight) -> Camera:
    assert flight.camera is not None
    return flight.camera


CAMERA = (
    Term(
        name="focal_length",
        title="a wrong focal length",
        meaning="the focal length differs from the calibration",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(signed("eps", "1", 0.03, 0.5, step=0.0001, quantity="error of the focal length"),),
        equation="the focal length is (1 + eps) times that of sensor.yaml",
        confounders=("flow_scale", "sonar_scale"),
        excitation=(
            "rotations (px = f omega), or a target of known size; translation alone cannot distinguish it "
            "from the height"
        ),
        tolerance=0.003,
        stream="camera",
        undo=_with_focal_length,
    ),
    Term(
        name="radial_distortion",
        title="a lens that bends lines",
        meaning="the lens bends straight lines",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(signed("k1", "1", 0.3, 0.6, step=0.0001, quantity="first coefficient of the bend"),),
        equation="x -> x (1 + k1 |x|^2), x in units of the focal length",
        confounders=("focal_length",),
        excitation="features at the centre and at the edge",
        tolerance=0.005,
        stream="camera",
        undo=_with_distortion,
    ),
    Term(
        name="camera_tilt",
        title="a camera mounted at an angle",
        meaning="the camera is mounted at an angle",
        family="camera",
        acts_on="image",
        instrument="mounting of the camera",
        parameters=(
            signed("x", "rad", radians(5), 0.5, step=1e-05, quantity=BODY_AXES["x"]),
            signed("y", "rad", radians(5), 0.5, step=1e-05, quantity=BODY_AXES["y"]),
        ),
        equation="the camera is rotated about the body's x and y by these angles against its T_BS",
        confounders=("trim_offset",),
        excitation="climbs, and yaw on the spot",
        tolerance=0.002,
        stream="camera",
        undo=_with_tilt,
    ),
    Term(
        name="camera_time_offset",
        title="wrong times of the pictures",
        meaning="the pictures have wrong times",
        family="camera",
        acts_on="clock",
        instrument="clock of the camera",
        parameters=(
            signed("offset", "s", 0.08, 2.0, step=0.0001, quantity="time by which pictures are stamped late"),
        ),
        equation="a picture stamped t was taken at t - offset",
        confounders=("clock_drift", "rolling_shutter"),
        excitation="fast tilts, over some minutes",
        tolerance=0.001,
        stream="frames",
        undo=_without_offset,
    ),
    Term(
        name="rolling_shutter",
        title="picture rows exposed in turn",
        meaning="the picture's rows are exposed one after the other",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(
            size(
                "readout", "s", 0.01, 0.05, 0.2, step=0.0001, quantity="time from the first row to the last"
            ),
        ),
        equation="row i of n is exposed readout i / (n - 1) after the stamp",
        confounders=("camera_time_offset",),
        excitation="fast tilts and yaw: the offset grows with the row",
        tolerance=0.001,
        stream="camera",
        undo=_with_readout,
    ),
    Term(
        name="motion_blur",
        title="pictures blurred by motion",
        meaning="pictures are blurred when it moves",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(
            size("exposure", "s", 0.002, 0.03, 0.2, step=1e-06, squared=True, quantity="exposure time"),
        ),
        equation="the picture is the mean over the exposure time: a blur of f v exposure / h px",
        confounders=("exposure_variation",),
        excitation="the same speed at two light levels",
        tolerance=1e-05,
        stream="frames",
    ),
    Term(
        name="exposure_variation",
        title="a brightness that varies",
        meaning="brightness and contrast vary from picture to picture",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(
            size("gain", "1", 0.02, 0.2, 1.0, step=1e-05, squared=True, quantity="variation of the contrast"),
            size(
                "gamma", "1", 0.05, 0.4, 1.0, step=1e-05, squared=True, quantity="variation of the brightness"
            ),
            Parameter(
                name="tau",
                unit="s",
                neutral=0.5,
                low=0.2,
                high=2.0,
                least=0.0,
                most=60.0,
                quantity="duration of a variation",
            ),
        ),
        equation=(
            "I' = g_c I^gamma: log g of each colour and log gamma are Ornstein-Uhlenbeck processes of these"
            " standard deviations and this correlation time; with 0 they are independent between pictures"
        ),
        confounders=("motion_blur", "specular_highlights"),
        excitation="the same speed at two light levels",
        tolerance=1e-05,
        stream="frames",
    ),
    Term(
        name="vignetting",
        title="dark corners of the pictures",
        meaning="pictures are darker towards their corners",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(size("a", "1", 0.05, 0.5, 1.0, step=0.001, quantity="darkening in the corners"),),
        equation="I' = I (1 - a r^2)",
        confounders=(),
        excitation="yaw and translation: shading of the floor moves with the floor",
        tolerance=0.02,
        stream="frames",
        undo=_without_vignetting,
    ),
    Term(
        name="specular_highlights",
        title="lamps mirrored in the floor",
        meaning="lamps are mirrored in the floor",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(size("strength", "1", 0.1, 1.0, 5.0, quantity="strength of the mirror images"),),
        equation=(
            "a bright spot in the mirror direction of a lamp overhead, strength times white at its centre"
        ),
        confounders=("moving_objects", "exposure_variation"),
        excitation="yaw on the spot",
        in_single_readings=True,
    ),
    Term(
        name="dropped_frames",
        title="lost pictures",
        meaning="pictures are lost",
        family="camera",
        acts_on="image",
        instrument="camera",
        parameters=(size("share", "1", 0.005, 0.1, 0.9, quantity="share of lost pictures"),),
        equation="each picture is lost with this probability",
        confounders=("timestamp_jitter",),
        excitation="any flight: displacements are integer multiples",
        in_single_readings=True,
    ),
)
