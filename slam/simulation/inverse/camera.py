"""Corrections of the camera: lens, mount, shutter and vignetting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from slam.core.flight import Flight, Image
from slam.simulation.camera.effects import CameraEffects, true_camera
from slam.simulation.camera.photometry import Light, falloff
from slam.simulation.model import Model

LEAST_LIGHT = 0.1
"""Least vignetting that is corrected, relative to the centre; darker pixels hold no information."""


def focal_length(flight: Flight, model: Model) -> Flight:
    """Correct the nominal focal length."""
    camera = _camera(flight)
    true = true_camera(camera, CameraEffects(focal_eps=model.value("focal_length", "eps")))
    return replace(
        flight, camera=replace(true, focal_std_ratio=model.known_to("focal_length", camera.focal_std_ratio))
    )


def radial_distortion(flight: Flight, model: Model) -> Flight:
    """Correct the nominal radial distortion."""
    camera = _camera(flight)
    true = true_camera(camera, CameraEffects(radial_k1=model.value("radial_distortion", "k1")))
    return replace(
        flight, camera=replace(true, radial_std=model.known_to("radial_distortion", camera.radial_std))
    )


def camera_tilt(flight: Flight, model: Model) -> Flight:
    """Correct the rotation of the camera against its mount."""
    camera, (x, y) = _camera(flight), model.vector("camera_tilt")
    true = true_camera(camera, CameraEffects(tilt_x_rad=float(x), tilt_y_rad=float(y)))
    return replace(
        flight, camera=replace(true, mount_std_rad=model.known_to("camera_tilt", camera.mount_std_rad))
    )


def rolling_shutter(flight: Flight, model: Model) -> Flight:
    """Set the readout time, which the front end compensates."""
    return replace(
        flight, camera=replace(_camera(flight), readout_s=model.value("rolling_shutter", "readout"))
    )


def vignetting(flight: Flight, model: Model) -> Flight:
    """Correct the vignetting of pictures when they are read."""
    camera, frames = _camera(flight), flight.frames
    assert frames is not None
    correct = vignetting_correction(falloff(camera.size_px, camera.center_px, model.value("vignetting", "a")))

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
