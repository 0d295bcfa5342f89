"""The camera as criticism found it: lens, mount and shading."""

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
"""Of the middle's: what is darker than that holds nothing that could be lit."""


def focal_length(flight: Flight, model: Model) -> Flight:
    """The focal length that was told is off."""
    camera = _camera(flight)
    seen = true_camera(camera, CameraEffects(focal_eps=model.value("focal_length", "eps")))
    return replace(
        flight, camera=replace(seen, focal_std_ratio=model.known_to("focal_length", camera.focal_std_ratio))
    )


def radial_distortion(flight: Flight, model: Model) -> Flight:
    """The lens bends more than was told."""
    camera = _camera(flight)
    seen = true_camera(camera, CameraEffects(radial_k1=model.value("radial_distortion", "k1")))
    return replace(
        flight, camera=replace(seen, radial_std=model.known_to("radial_distortion", camera.radial_std))
    )


def camera_tilt(flight: Flight, model: Model) -> Flight:
    """The camera turned against its mount."""
    camera, (x, y) = _camera(flight), model.vector("camera_tilt")
    seen = true_camera(camera, CameraEffects(tilt_x_rad=float(x), tilt_y_rad=float(y)))
    return replace(
        flight, camera=replace(seen, mount_std_rad=model.known_to("camera_tilt", camera.mount_std_rad))
    )


def rolling_shutter(flight: Flight, model: Model) -> Flight:
    """Rows exposed one after the other: the front end is told how long it takes to read them."""
    return replace(
        flight, camera=replace(_camera(flight), readout_s=model.value("rolling_shutter", "readout"))
    )


def vignetting(flight: Flight, model: Model) -> Flight:
    """Corners darker than the middle: pictures are lit evenly when they are read."""
    camera, frames = _camera(flight), flight.frames
    assert frames is not None
    even = vignetting_correction(falloff(camera.size_px, camera.center_px, model.value("vignetting", "a")))

    def load(k: int) -> Image | None:
        picture = frames.load(k)
        return None if picture is None else even(picture)

    return replace(flight, frames=replace(frames, load=load))


def vignetting_correction(light: Light) -> Callable[[Image], Image]:
    """What divides pictures (h, w) or (h, w, 3) by the share of ``light`` (h, w) that reaches them; those of
    another size stay as they are."""
    gain = 1.0 / np.maximum(light, LEAST_LIGHT)

    def even(picture: Image) -> Image:
        if picture.shape[:2] != gain.shape[:2]:
            return picture
        lit = np.rint(picture * gain.reshape(*gain.shape[:2], *[1] * (picture.ndim - 2)))
        return np.minimum(lit, np.iinfo(picture.dtype).max).astype(picture.dtype)

    return even


def _camera(flight: Flight) -> Camera:
    assert flight.camera is not None
    return flight.camera
