"""Plain names of the quantities of effects."""

from __future__ import annotations

from collections.abc import Mapping

from slam.simulation.terms import CATALOGUE

_BODY = {"x": "axis ahead, x", "y": "axis to the left, y", "z": "axis up, z"}
_WORLD = {"x": "along x of the world", "y": "along y of the world"}
_QUANTITIES: Mapping[str, str] = {
    "focal_length.eps": "error of the focal length",
    "radial_distortion.k1": "first coefficient of the bend",
    "camera_time_offset.offset": "time by which pictures are stamped late",
    "rolling_shutter.readout": "time from the first row to the last",
    "motion_blur.exposure": "exposure time",
    "exposure_variation.gain": "variation of the contrast",
    "exposure_variation.gamma": "variation of the brightness",
    "exposure_variation.tau": "duration of a variation",
    "vignetting.a": "darkening in the corners",
    "specular_highlights.strength": "strength of the mirror images",
    "dropped_frames.share": "share of lost pictures",
    "flow_derotation.kappa": "share of the rotation that is left",
    "flow_scale.eps": "error of the speed",
    "gyro_scale.eps": "error of the rates",
    "accel_scale.eps": "error of the accelerations",
    "control_latency.T": "delay",
    "attitude_lag.tau": "time in which the tilt follows",
    "active_braking.k_b": "rate of braking",
    "active_braking.lean": "rate of braking by leaning back",
    "asymmetric_drag.alpha": "additional drag",
    "quadratic_drag.c": "drag over the square of the speed",
    "command_nonlinearity.eps": "cubic part",
    "command_nonlinearity.dead_band": "dead band of the stick",
    "tilt_limit.limit": "greatest tilt",
    "battery_sag.loss": "loss of the sticks' effect at the end",
    "trim_offset.roll": "roll",
    "trim_offset.pitch": "pitch",
    "canted_thrust.ahead": "cant ahead",
    "canted_thrust.left": "cant to the left",
    "gusts.sigma": "speed of the gusts",
    "gusts.tau": "duration of a gust",
    "ground_effect.radius": "radius of the rotors",
    "climb_asymmetry.eps": "difference of the descent",
    "yaw_drag.eps": "error of the rate of turn",
    "position_hold.stiffness": "stiffness",
    "position_hold.damping": "damping",
    "position_hold.capture_speed": "speed below which it holds",
    "floor_steps.height": "height of the steps",
    "floor_steps.share": "share of the floor",
    "moving_objects.count": "number",
    "sonar_slant.c": "share of the tilt's effect",
    "sonar_temperature.rise": "warming",
    "sonar_scale.eps": "error of the range",
    "sonar_bias.b": "error of the range",
    "sonar_spikes.share": "share of the readings",
    "sonar_quantisation.step": "step",
    "sonar_dead_zone.limit": "height at which it sticks",
    "sonar_lag.T": "delay",
    "clock_drift.ppm": "error of the rate",
    "timestamp_jitter.sigma": "scatter of the stamps",
}
"""``effect.parameter`` -> the quantity, beside the name of the effect."""


def quantity(effect: str, parameter: str) -> str:
    """Return the plain name of a parameter of an effect, beside the effect's own name."""
    name = f"{effect}.{parameter}"
    if name in _QUANTITIES:
        return _QUANTITIES[name]
    if effect in CATALOGUE and CATALOGUE[effect].family in ("imu", "sonar", "camera"):
        return _BODY.get(parameter, parameter)
    return _WORLD.get(parameter, parameter)
