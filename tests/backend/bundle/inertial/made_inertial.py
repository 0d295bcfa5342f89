"""A vehicle that sways over a made floor: tracks, ranges and an IMU with known errors, and the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backend import se3
from backend.bundle.homography_factor import ImagePlane, transfer
from backend.measurements import (
    FloorTracks,
    Inertial,
    InertialNoise,
    InertialReadings,
    Measurements,
    SlantRange,
    TrackedFrame,
)
from tests.backend.made_floor import CAMERA, NADIR, SIZE_PX, Scene, _tracks
from tests.backend.made_motion import MadeFlight, fly

RATE_HZ = 200.0
NOISE = InertialNoise(gyro_density=1.5e-3, accel_density=5e-2, gyro_walk=1e-4, accel_walk=1e-3)
CORNERS = SIZE_PX * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
CORNER_STD_PX = 0.3


@dataclass(frozen=True)
class InertialScene:
    """What is put in."""

    seconds: float = 8.0
    spacing_s: float = 0.3
    noise: InertialNoise = NOISE
    range_std_m: float = 0.01
    gap_s: tuple[float, float] | None = (3.5, 5.0)
    """Times between which the pictures show nothing. Those behind share no point with those before."""


@dataclass(frozen=True)
class MadeInertial:
    """Measurements, a start near the truth, and the truth."""

    measurements: Measurements
    start: np.ndarray
    w_T_b: np.ndarray
    flight: MadeFlight


def make(scene: InertialScene, seed: int) -> MadeInertial:
    """Return a flight of sines with all constants of the IMU drawn from their priors."""
    rng = np.random.default_rng(seed)
    flight = fly(rng)
    # Two pictures between two keyframes.
    stamps_s = np.arange(0.0, scene.seconds, scene.spacing_s / 3)
    if scene.gap_s is not None:
        stamps_s = stamps_s[(stamps_s <= scene.gap_s[0]) | (stamps_s >= scene.gap_s[1])]
    delay = rng.normal(0, scene.noise.delay_s)
    every = flight.w_T_b(stamps_s - delay)
    every[:, :3, 3] -= every[0, :3, 3] * [1, 1, 0]
    keyframe_s, w_T_b = stamps_s[::3], every[::3]
    floor = Scene(points_in_view=40, height_m=1.2)
    tracks = _tracks(floor, w_T_b, rng)
    if scene.gap_s is not None:
        tracks = _apart(tracks, keyframe_s > scene.gap_s[0])
    n = len(keyframe_s)
    off = np.concatenate([rng.normal(0, 0.01, (n, 3)), rng.normal(0, 0.02, (n, 3))], axis=1)
    off[0] *= [1, 1, 0, 0, 0, 1]
    start = w_T_b @ se3.exp(off)
    start[0, :2, 3] = 0.0
    slant = w_T_b[:, 2, 3] / w_T_b[:, 2, 2] + rng.normal(0, scene.range_std_m, n)
    measurements = Measurements(
        keyframe_s,
        ranges=tuple(SlantRange(k, float(r), scene.range_std_m) for k, r in enumerate(slant)),
        tracks=tracks,
        range_gain_std=0.0,
        range_datum_std_m=0.0,
        camera=CAMERA,
        inertial=Inertial(_readings(scene, flight, rng), scene.noise),
        frames=_frames(stamps_s, every, rng),
    )
    return MadeInertial(measurements, start, w_T_b, flight)


def _apart(tracks: FloorTracks, behind: np.ndarray) -> FloorTracks:
    """Return the tracks cut at the gap: a point seen on both sides becomes two."""
    track = np.unique(2 * tracks.track + behind[tracks.keyframe], return_inverse=True)[1]
    keep = np.bincount(track)[track] >= 2
    return FloorTracks(
        tracks.keyframe[keep],
        np.unique(track[keep], return_inverse=True)[1],
        tracks.pixel[keep],
        tracks.std_px[keep],
    )


def _frames(stamps_s: np.ndarray, w_T_b: np.ndarray, rng: np.random.Generator) -> tuple[TrackedFrame, ...]:
    """Return the pictures that are no keyframes, registered to the keyframe before."""
    plane = ImagePlane(np.array(CAMERA.focal_px), np.array(CAMERA.center_px))
    j = np.flatnonzero(np.arange(len(stamps_s)) % 3)
    f_T_c = w_T_b @ NADIR
    f_T_c[:, :3, 3] /= np.median(f_T_c[::3, 2, 3])
    rays = np.tile(plane.rays(CORNERS), (len(j), 1, 1))
    pixel = transfer(f_T_c[j - j % 3], f_T_c[j], rays, plane).pixel
    pixel = pixel + rng.normal(0, CORNER_STD_PX, pixel.shape)
    P = CORNER_STD_PX**2 * np.eye(8)
    return tuple(
        TrackedFrame(int(m) // 3, float(stamps_s[m]), CORNERS, one.reshape(4, 2), P)
        for m, one in zip(j, pixel, strict=True)
    )


def _readings(scene: InertialScene, flight: MadeFlight, rng: np.random.Generator) -> InertialReadings:
    noise, step = scene.noise, 1e-4
    t = np.arange(-0.3, scene.seconds + 0.3, 1 / RATE_HZ)
    arm = rng.normal(0, noise.arm_m, 3)

    def place(at: np.ndarray) -> np.ndarray:
        T = flight.w_T_b(at)
        return T[:, :3, 3] + T[:, :3, :3] @ arm

    acceleration = (place(t + step) - 2 * place(t) + place(t - step)) / step**2 + [0, 0, 9.80665]
    force = np.einsum("nba,nb->na", flight.w_T_b(t)[:, :3, :3], acceleration)
    gain = noise.gain_ratio / np.sqrt(2) * (rng.normal() + rng.normal(0, 1, 3))
    walk = rng.normal(0, 1, (2, len(t), 3)).cumsum(axis=1) / np.sqrt(RATE_HZ)
    gyro_gain = np.exp(rng.normal(0, noise.gyro_gain_ratio, 3))
    gyro = gyro_gain * flight.body_rate(t) + rng.normal(0, noise.gyro_offset_rad_s, 3)
    gyro += noise.gyro_walk * walk[0]
    accel = np.exp(gain) * force + rng.normal(0, noise.accel_offset_m_s2, 3) + noise.accel_walk * walk[1]
    white = np.sqrt(RATE_HZ)
    return InertialReadings(
        t,
        gyro + rng.normal(0, white * noise.gyro_density, gyro.shape),
        accel + rng.normal(0, white * noise.accel_density, accel.shape),
    )


def altered(made: MadeInertial, readings: InertialReadings) -> Measurements:
    """Return the measurements with other readings."""
    assert made.measurements.inertial is not None
    return replace(made.measurements, inertial=replace(made.measurements.inertial, readings=readings))
