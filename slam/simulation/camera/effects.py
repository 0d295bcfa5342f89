"""Unreported effects of a camera: the camera terms of the catalogue as plain numbers.

The flight contains the nominal camera. The pictures are taken by the one that ``true_camera`` derives from
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import Camera

_FIELDS = {
    ("focal_length", "eps"): "focal_eps",
    ("radial_distortion", "k1"): "radial_k1",
    ("camera_tilt", "x"): "tilt_x_rad",
    ("camera_tilt", "y"): "tilt_y_rad",
    ("camera_time_offset", "offset"): "time_offset_s",
    ("rolling_shutter", "readout"): "readout_s",
    ("motion_blur", "exposure"): "exposure_s",
    ("exposure_variation", "gain"): "gain_std",
    ("exposure_variation", "gamma"): "gamma_std",
    ("exposure_variation", "tau"): "tone_time_s",
    ("vignetting", "a"): "vignetting",
    ("specular_highlights", "strength"): "highlight",
    ("dropped_frames", "share"): "dropped_share",
    ("moving_objects", "count"): "moving_objects",
}
"""Term and parameter -> field of ``CameraEffects``."""


@dataclass(frozen=True)
class CameraEffects:
    """All effects on pictures; the defaults change nothing."""

    focal_eps: float = 0.0
    """``focal_length``: the focal length is (1 + eps) times the nominal one."""
    radial_k1: float = 0.0
    """``radial_distortion``: added to the first nominal coefficient."""
    tilt_x_rad: float = 0.0
    """``camera_tilt``: rotation of the camera against its mount about the body's x."""
    tilt_y_rad: float = 0.0
    """``camera_tilt``: rotation about the body's y."""
    time_offset_s: float = 0.0
    """``camera_time_offset``: a picture stamped t shows the scene at t - offset."""
    readout_s: float = 0.0
    """``rolling_shutter``: row i of n is exposed readout i / (n - 1) after the stamp."""
    exposure_s: float = 0.0
    """``motion_blur``: each row is the mean over this time, centred on its moment."""
    gain_std: float = 0.0
    """``exposure_variation``: standard deviation of the log gain of each colour."""
    gamma_std: float = 0.0
    """``exposure_variation``: standard deviation of the log gamma."""
    tone_time_s: float = 0.0
    """``exposure_variation``: correlation time; with 0 pictures are independent, as in the paper."""
    vignetting: float = 0.0
    """``vignetting``: I (1 - a r^2), r = 1 in the corner."""
    highlight: float = 0.0
    """``specular_highlights``: brightness of a lamp's reflection, 1 is white."""
    dropped_share: float = 0.0
    """``dropped_frames``: probability that a picture is lost."""
    moving_objects: int = 0
    """``moving_objects``: number of objects that move over the floor."""

    @property
    def window_s(self) -> float:
        """Time from the first opening of any row to the last closing."""
        return self.readout_s + self.exposure_s


def camera_effects(terms: Mapping[str, Mapping[str, float]]) -> CameraEffects:
    """Return the effects on pictures of a model's terms (term -> parameter -> value)."""
    effects = {
        _FIELDS[name, parameter]: value
        for name, values in terms.items()
        for parameter, value in values.items()
        if (name, parameter) in _FIELDS
    }
    count = round(effects.pop("moving_objects", 0))
    return CameraEffects(**effects, moving_objects=count)


def true_camera(nominal: Camera, effects: CameraEffects) -> Camera:
    """Return the camera that takes the pictures, given the ``nominal`` one of the flight's files."""
    distortion = list(nominal.distortion)
    distortion[0] += effects.radial_k1
    b_R_b = np.eye(4)
    b_R_b[:3, :3] = Rotation.from_rotvec([effects.tilt_x_rad, effects.tilt_y_rad, 0.0]).as_matrix()
    fu, fv = nominal.focal_px
    scale = 1.0 + effects.focal_eps
    return replace(
        nominal, focal_px=(fu * scale, fv * scale), distortion=tuple(distortion), b_T_c=b_R_b @ nominal.b_T_c
    )
