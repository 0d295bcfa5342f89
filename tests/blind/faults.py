"""Effects that can be hidden in flights: independent equations, sizes in the catalogue's units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Rng = np.random.Generator
Apply = Callable[[float, dict[str, float], Rng], dict[str, float]]


@dataclass(frozen=True)
class Fault:
    """One effect. ``apply(amplitude, healthy knobs, rng)`` gives the knobs to change."""

    name: str
    """Name in the catalogue; another name for effects outside it."""
    family: str
    low: float
    high: float
    """Range of amplitudes in the catalogue's unit."""
    unit: str
    apply: Apply
    scaled: bool = True
    """Whether its strength is proportional to its amplitude; otherwise amplitudes are drawn uniformly."""
    needs: tuple[str, ...] = ()
    """Plans of which one is needed for it to show."""
    known: bool = True
    """Whether it is in the catalogue."""
    channels: tuple[str, ...] = ()
    """Channels that show it, for effects outside the catalogue."""
    value: Callable[[float, dict[str, float]], float] | None = lambda a, base: abs(a)
    """Function from amplitude to the catalogue's parameter; None where they are not comparable."""


def plain(knob: str, signed: bool = False, per: float = 1.0) -> Apply:
    """The amplitude, with either sign if signed, in one knob."""
    return lambda a, base, rng: {knob: per * a * (rng.choice([-1.0, 1.0]) if signed else 1.0)}


def directed(*knobs: str) -> Apply:
    """The amplitude as the length of a vector of random direction."""

    def apply(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
        way = rng.standard_normal(len(knobs))
        return dict(zip(knobs, a * way / np.linalg.norm(way), strict=True))

    return apply


def _late(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"late": a, "late_spread": 0.04 * a}


def _lag(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"lag": base["lag"] + a}


def _brake(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"brake_p": a, "brake_i": 0.1 * a, "brake_most": rng.uniform(0.15, 0.3)}


def _gusts(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"gust": a, "gust_tau": rng.uniform(0.8, 3.0)}


def _boxes(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"box": a, "box_share": 0.2, "box_seed": float(rng.integers(1, 10**6))}


def _hum(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"hum": a, "hum_hz": 17.0 + rng.uniform(-0.5, 0.5)}


def _iron(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"iron": a, "iron_x": rng.uniform(-1, 1), "iron_y": rng.uniform(-1, 1)}


def _load(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"load": a, "load_hz": rng.uniform(0.5, 0.9)}


def _exposure(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"adapt": a, "adapt_s": rng.uniform(0.3, 1.5)}


def _crowd(a: float, base: dict[str, float], rng: Rng) -> dict[str, float]:
    return {"crowd": float(round(a))}


MOVES = ("pulse_and_coast", "reversing_steps", "square")
CLIMBS = ("vertical_square", "two_heights", "touchdown")
SHARP = ("tilt_pulses", "reversing_steps", "pulse_and_coast")
_RHO_M = 0.5 * 1.2 / 0.42

FAULTS: tuple[Fault, ...] = (
    Fault("control_latency", "motion", 0.015, 0.15, "s", _late, scaled=False, needs=SHARP),
    Fault("attitude_lag", "motion", 0.012, 0.15, "s", _lag, needs=SHARP, value=lambda a,
        base: base["lag"] + a),
    Fault("active_braking", "motion", 0.01, 1.0, "1/s", _brake, needs=MOVES),
    Fault("asymmetric_drag", "motion", 0.03, 1.0, "1", plain("inflow"), needs=("reversing_steps",)),
    Fault("quadratic_drag", "motion", 0.01, 0.3, "1/m", plain("cd_area", per=1 / _RHO_M), needs=MOVES),
    Fault("command_nonlinearity", "motion", 0.1, 2.0, "1", plain("curve", signed=True), needs=MOVES),
    Fault("tilt_limit", "motion", 0.09, 0.16, "rad", plain("limit"), scaled=False, needs=("tilt_pulses",)),
    Fault("flow_scale", "motion", 0.005, 0.2, "1", plain("flow_eps", signed=True), needs=MOVES),
    Fault("battery_sag", "motion", 0.01, 0.25, "1", plain("sag"), needs=MOVES, value=None),
    Fault("trim_offset", "motion", 0.0005, 0.05, "rad", directed("lean_roll", "lean_pitch"),
        needs=("yaw_repeat",)),
    Fault("steady_wind", "motion", 0.02, 0.8, "m/s", directed("wind_x", "wind_y"), needs=("yaw_repeat",)),
    Fault("gusts", "motion", 0.12, 0.35, "m/s", _gusts, scaled=False),
    Fault("ground_effect", "motion", 0.02, 0.25, "m", plain("cushion", per=1 / 1.27), needs=("touchdown",)),
    Fault("climb_asymmetry", "motion", 0.01, 0.4, "1", plain("sink", signed=True), needs=CLIMBS),
    Fault("yaw_drag", "motion", 0.003, 0.3, "1", plain("spin_drag", signed=True), needs=("yaw_repeat",)),
    Fault("sonar_slant", "sonar", 0.1, 0.35, "1", plain("cone"), scaled=False, needs=("tilt_pulses",),
        value=None),
    Fault("sonar_tilt", "sonar", 0.005, 0.09, "rad", directed("echo_x", "echo_y"), needs=SHARP),
    Fault("sonar_scale", "sonar", 0.004, 0.06, "1", plain("echo_eps", signed=True), needs=CLIMBS),
    Fault(
        "sonar_bias", "sonar", 0.03, 0.08, "m", plain("echo_add", signed=True), scaled=False,
        needs=("touchdown",),
    ),
    Fault("sonar_temperature", "sonar", 1.0, 25.0, "K", plain("warm_k", signed=True), value=None),
    Fault("sonar_quantisation", "sonar", 0.03, 0.06, "m", plain("echo_step"), scaled=False),
    Fault("sonar_dead_zone", "sonar", 0.3, 0.4, "m", plain("echo_floor"), scaled=False, needs=("touchdown",)),
    Fault("sonar_lag", "sonar", 0.005, 0.15, "s", plain("echo_lag"), needs=CLIMBS),
    Fault("sonar_spikes", "sonar", 0.01, 0.05, "1", plain("echo_twice"), scaled=False),
    Fault("gyro_bias", "imu", 0.0003, 0.03, "rad/s", directed("gyro_x", "gyro_y", "gyro_z")),
    Fault("gyro_scale", "imu", 0.002, 0.05, "1", plain("gyro_eps", signed=True), needs=("yaw_repeat",)),
    Fault("accel_bias", "imu", 0.01, 0.3, "m/s^2", directed("accel_x", "accel_y", "accel_z")),
    Fault("accel_scale", "imu", 0.001, 0.03, "1", plain("accel_eps", signed=True)),
    Fault("imu_misalignment", "imu", 0.002, 0.05, "rad", directed("turn_x", "turn_y", "turn_z")),
    Fault("clock_drift", "timing", 20.0, 600.0, "ppm", plain("ppm", signed=True), needs=SHARP),
    Fault("timestamp_jitter", "timing", 0.004, 0.009, "s", plain("stamp_jitter"), scaled=False, needs=SHARP),
    Fault("floor_slope", "place", 0.003, 0.05, "1", directed("slope_x", "slope_y"), needs=MOVES),
    Fault("floor_steps", "place", 0.04, 0.3, "m", _boxes, scaled=False, needs=MOVES, value=None),
)  # fmt: skip

_TILTS = ("force roll", "force pitch", "roll", "pitch", "attitude", "gyro")
STRANGE: tuple[Fault, ...] = (
    Fault("rotor_hum", "none", 0.02, 3.0, "m/s^2", _hum, known=False, channels=("imu", "gyro", "accel")),
    Fault("iron_in_floor", "none", 0.01, 0.6, "rad", _iron, needs=MOVES, known=False, channels=("yaw",
        "attitude")),
    Fault(
        "swinging_load", "none", 0.005, 0.3, "1", _load, needs=MOVES, known=False,
        channels=("velocity", "accel", "imu", "flow", "force ahead", "force left"),
    ),
    Fault(
        "sticky_throttle", "none", 0.3, 0.55, "1", plain("sticky_up"), scaled=False, needs=CLIMBS,
        known=False,
        channels=("sonar", "range", "accel", "imu", "force up"),
    ),
    Fault(
        "false_level", "none", 0.005, 0.5, "1", plain("false_level"), needs=SHARP, known=False,
        channels=("attitude", "roll", "pitch"),
    ),
    Fault(
        "flow_saturation", "none", 0.7, 1.4, "m/s", plain("flow_top"), scaled=False, needs=MOVES, known=False,
        channels=("velocity", "flow"),
    ),
    Fault(
        "imu_off_centre", "none", 0.003, 0.5, "m", directed("arm_x", "arm_y", "arm_z"), needs=SHARP,
        known=False,
        channels=("accel", "imu"),
    ),
    Fault(
        "axes_askew", "none", 0.003, 0.3, "rad", plain("askew", signed=True), needs=SHARP, known=False,
        channels=("force roll", "force pitch", "roll", "pitch", "attitude", "gyro"),
    ),
    Fault(
        "climb_pitches", "none", 0.001, 0.2, "rad", plain("nose_up", signed=True), needs=CLIMBS, known=False,
        channels=("force pitch", "pitch", "attitude", "gyro"),
    ),
    Fault(
        "flow_askew", "none", 0.003, 0.3, "rad", plain("flow_askew", signed=True), needs=MOVES, known=False,
        channels=("velocity", "flow"),
    ),
)  # fmt: skip

STRANGER: tuple[Fault, ...] = (
    Fault(
        "attitude_swings_over", "none", 0.01, 1.0, "1", plain("swing_over"), needs=SHARP, known=False,
        channels=_TILTS,
    ),
    Fault("lazy_servo", "none", 0.8, 3.0, "rad/s", plain("lazy_servo"), scaled=False, needs=("tilt_pulses",),
        known=False, channels=_TILTS),
    Fault("attitude_late", "none", 0.001, 0.2, "s", plain("late_level"), needs=SHARP, known=False,
        channels=("attitude", "roll", "pitch", "yaw")),
    Fault("tilt_turns", "none", 0.003, 1.0, "1", plain("tilt_turns", signed=True), needs=SHARP, known=False,
        channels=("yaw", "gyro", "attitude", "force turn")),
    Fault("swirl", "none", 0.02, 0.8, "m/s", plain("swirl"), known=False,
        channels=("velocity", "accel", "force ahead", "force left", "force north", "force east", "wind")),
    Fault("knocked", "none", 0.0005, 0.06, "rad", directed("knock_roll", "knock_pitch"), known=False,
        channels=(*_TILTS, "velocity", "force ahead", "force left")),
    Fault("gyro_is_pulled", "none", 0.0005, 0.2, "rad/s per m/s^2", plain("pulled", signed=True),
        needs=SHARP, known=False, channels=("gyro", "imu")),
    Fault("echo_long_at_speed", "none", 0.01, 0.3, "s", plain("echo_fast", signed=True), needs=MOVES,
        known=False, channels=("sonar", "range")),
    Fault("flow_sticks", "none", 0.05, 0.15, "1", plain("flow_stuck"), scaled=False, needs=MOVES, known=False,
        channels=("velocity", "flow")),
)  # fmt: skip
"""Further effects outside the catalogue, in a separate pool, so that earlier suites keep their draws."""

SEEN: tuple[Fault, ...] = (
    Fault("focal_length", "camera", 0.007, 0.03, "1", plain("zoom", signed=True), scaled=False,
        needs=("tilt_pulses", "yaw_repeat", "two_heights")),
    Fault("radial_distortion", "camera", 0.02, 0.25, "1", plain("barrel", signed=True), scaled=False),
    Fault("camera_tilt", "camera", 0.009, 0.07, "rad", directed("mount_x", "mount_y"), scaled=False,
        needs=("yaw_repeat", "two_heights", "vertical_square")),
    Fault("camera_time_offset", "camera", 0.008, 0.08, "s", plain("stamp_late", signed=True), scaled=False,
        needs=SHARP),
    Fault("rolling_shutter", "camera", 0.012, 0.05, "s", plain("readout"), scaled=False, needs=SHARP),
    Fault("motion_blur", "camera", 0.012, 0.03, "s", plain("open_s"), scaled=False, needs=MOVES),
    Fault("exposure_variation", "camera", 0.5, 1.0, "1", _exposure, scaled=False, needs=MOVES, value=None),
    Fault("vignetting", "camera", 0.12, 0.5, "1", plain("dark_edge"), scaled=False),
    Fault("specular_highlights", "camera", 0.25, 0.9, "1", plain("shine"), scaled=False, needs=MOVES),
    Fault("dropped_frames", "camera", 0.015, 0.1, "1", plain("lost"), scaled=False),
    Fault("flow_derotation", "camera", 0.03, 0.1, "1", plain("flow_turn", signed=True), scaled=False,
        needs=("tilt_pulses",)),
    Fault("moving_objects", "place", 3.0, 7.0, "1", _crowd, scaled=False),
)  # fmt: skip
"""Effects that pictures show."""

FURTHER: tuple[Fault, ...] = (
    Fault("canted_thrust", "motion", 0.0005, 0.05, "rad", directed("cant_ahead", "cant_left"),
        needs=("yaw_repeat",)),
)  # fmt: skip
"""Further effects of the catalogue, in a separate pool, so that earlier suites keep their draws. They are
hidden by name: ``python -m tests.blind.run --kinds single --fault NAME``."""

SENSES: dict[str, dict[str, str]] = {
    "command_nonlinearity": {"eps": "curve"},
    "flow_scale": {"eps": "flow_eps"},
    "trim_offset": {"roll": "lean_roll", "pitch": "lean_pitch"},
    "steady_wind": {"x": "wind_x", "y": "wind_y"},
    "canted_thrust": {"ahead": "cant_ahead", "left": "cant_left"},
    "climb_asymmetry": {"eps": "sink"},
    "yaw_drag": {"eps": "spin_drag"},
    "sonar_tilt": {"x": "echo_x", "y": "echo_y"},
    "sonar_scale": {"eps": "echo_eps"},
    "sonar_bias": {"b": "echo_add"},
    "sonar_temperature": {"rise": "warm_k"},
    "gyro_bias": {"x": "gyro_x", "y": "gyro_y", "z": "gyro_z"},
    "gyro_scale": {"eps": "gyro_eps"},
    "accel_bias": {"x": "accel_x", "y": "accel_y", "z": "accel_z"},
    "accel_scale": {"eps": "accel_eps"},
    "imu_misalignment": {"x": "turn_x", "y": "turn_y", "z": "turn_z"},
    "clock_drift": {"ppm": "ppm"},
    "floor_slope": {"x": "slope_x", "y": "slope_y"},
    "focal_length": {"eps": "zoom"},
    "radial_distortion": {"k1": "barrel"},
    "camera_tilt": {"x": "mount_x", "y": "mount_y"},
    "camera_time_offset": {"offset": "stamp_late"},
    "flow_derotation": {"kappa": "flow_turn"},
}
"""Effect with a sign or a direction -> the catalogue's parameters and the knobs of the same sense."""

_PICTURES = ("picture", "camera", "image", "brightness", "contrast", "colour", "sharp", "column", "row")
SEEN_STRANGE: tuple[Fault, ...] = tuple(
    Fault(name, "none", low, high, unit, plain(knob), scaled=False, needs=needs, known=False,
        channels=_PICTURES)
    for name, knob, low, high, unit, needs in (
        ("lens_haze", "haze", 0.3, 0.6, "1", ()),
        ("lamp_flicker", "flicker", 0.08, 0.25, "1", ()),
        ("wide_columns", "squeeze", 0.015, 0.05, "1", MOVES),
        ("zoom_creep", "creep", 0.02, 0.06, "1", MOVES),
        ("dirt_on_lens", "dirt", 0.3, 0.8, "1", ()),
        ("torn_pictures", "torn", 0.03, 0.08, "s", SHARP),
        ("water_drop", "drop", 0.2, 0.4, "1", MOVES),
        ("hunting_focus", "hunting", 1.0, 2.0, "px", ()),
    )
)  # fmt: skip
"""Effects outside the catalogue that only pictures show."""

BY_NAME: dict[str, Fault] = {
    f.name: f for f in (*FAULTS, *FURTHER, *STRANGE, *STRANGER, *SEEN, *SEEN_STRANGE)
}


@dataclass(frozen=True)
class Blind:
    """A set-up in which some causes are indistinguishable, and the manoeuvre that distinguishes them."""

    fault: str
    plans: tuple[str, ...]
    streams: tuple[str, ...]
    equivalents: tuple[str, ...]
    strength: float | None
    """Strength d; None for the middle of its amplitudes, since it cannot be seen at all."""
    settled_by: str
    """A word of the manoeuvre that distinguishes them."""


_ALL = ("imu0", "attitude0", "velocity0", "sonar0", "battery0")
_FLOW = ("velocity0", "sonar0")
_ASIDE = ("steady_wind", "trim_offset", "canted_thrust")
UNTELLABLE: tuple[Blind, ...] = (
    Blind("asymmetric_drag", ("onward",), _FLOW, ("asymmetric_drag", "active_braking"), 6.0, "revers"),
    Blind("steady_wind", ("hover", "pulse_and_coast"), _FLOW, _ASIDE, 12.0, "turn"),
    Blind("trim_offset", ("hover", "square"), _FLOW, _ASIDE, 12.0, "turn"),
    Blind("control_latency", ("swell",), _FLOW, ("control_latency", "attitude_lag"), 7.0, "pulse"),
    Blind(
        "sonar_bias", ("hover", "square", "yaw_repeat"), _ALL, ("sonar_bias", "sonar_scale"), None, "touch"
    ),
    Blind("sonar_scale", ("hover", "yaw_repeat"), _ALL, ("sonar_bias", "sonar_scale"), None, "height"),
)
