"""Cameras over a made floor: tracks with known pixel noise, sensors with known errors, and the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from backend import se3
from backend.bundle.refinement import Bundle
from backend.measurements import (
    Attitude,
    BarometerHeight,
    FloorTracks,
    Measurements,
    PinholeModel,
    Position,
    SlantRange,
)
from frontend.mosaic.quality import ground_jacobian
from slam.core.estimate import over_floor

NADIR = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
SIZE_PX = np.array([320.0, 240.0])
_WAVES = 20
"""Number of waves of rolling ground, whose sum is nearly normal."""
CAMERA = PinholeModel((256.0, 256.0), (159.5, 119.5), NADIR)


@dataclass(frozen=True)
class Scene:
    """What is put in."""

    keyframes: int = 16
    points_in_view: int = 30
    height_m: float = 0.8
    pixel_std: float = 0.3
    told_pixel_std: float = 0.3
    pixel_colour: float = 0.0
    """Correlation of a point's pixel errors in keyframes that follow each other."""
    relief: float = 0.0
    """Standard deviation over the height."""
    walls: float = 0.0
    """Share of points that stand a quarter of the height above the floor."""
    box: tuple[float, float, float, float] | None = None
    """Least and largest x, and y, of a box of a quarter of the height, over the height."""
    rolling: float = 0.0
    """Standard deviation over the height of ground that rises and falls: the sum of many waves."""
    wavelengths: tuple[float, float] = (1.0, 2.0)
    """Shortest and longest of these waves, over the height."""
    moving: float = 0.0
    """Share of points that move along the floor, by a twentieth of the height between two keyframes."""
    slope_rad: tuple[float, float] = (0.0, 0.0)
    tilt_std_rad: float = 0.03
    attitude_std_rad: float | None = 0.01
    range_std_m: float | None = 0.01
    range_gain: float = 1.0
    range_gain_std: float = 0.0
    range_datum_m: float = 0.0
    range_datum_std_m: float = 0.0
    height_swing: float = 0.08
    """Amplitude over the mean height."""
    position_std_m: tuple[float, float] | None = None
    """Horizontal, vertical."""
    barometer_std_m: float | None = None
    barometer_gain: float = 1.0
    focal_ratio: float = 1.0
    """True focal length over the one that is told."""
    radial: float = 0.0
    """True k1."""
    fisheye: tuple[float, float, float, float] | None = None
    """True k1 to k4 of an equidistant fisheye; None for Brown's model."""
    tangential: tuple[float, float] = (0.0, 0.0)
    """True p1 and p2."""
    center_off_px: tuple[float, float] = (0.0, 0.0)
    """True principal point from the one that is told."""
    readout_s: float = 0.0
    """Time from the exposure of the first row of a picture to that of the last. A picture is taken each
    second."""
    turn_std_rad_s: float = 0.0
    """Angular velocity of the camera about each axis meanwhile, by another draw for each picture."""
    stops: tuple[int, ...] = ()
    """Keyframes at which the vehicle is at rest."""
    camera: PinholeModel = CAMERA
    size_px: tuple[float, float] = (float(SIZE_PX[0]), float(SIZE_PX[1]))


@dataclass(frozen=True)
class Made:
    """Measurements, a start near the truth, and the truth."""

    measurements: Measurements
    start: np.ndarray
    w_T_b: np.ndarray
    floor_z_m: float
    slope_rad: tuple[float, float]
    lens: np.ndarray
    """True fx, fy, cx, cy, and k1, k2, p1, p2, k3 or the k1, k2, k3, k4 of a fisheye."""
    point: np.ndarray
    """(t, 3) true points of the tracks, over the floor; of those that move, where they were at first."""
    is_moving: np.ndarray
    """(t,)."""
    point: np.ndarray
    """(t, 3) true points of the tracks, over the floor."""


def make(scene: Scene, seed: int) -> Made:
    """Two parallel legs over the floor and back; the first keyframe stands over the origin."""
    rng = np.random.default_rng(seed)
    f_T_b = _poses(scene, rng)
    floor = np.eye(4)
    placed = scene.position_std_m is not None
    floor[:3, :3] = Rotation.from_rotvec([*scene.slope_rad, 0.0]).as_matrix()
    floor[2, 3] = 7.0 * scene.height_m if placed else 0.0
    w_T_b = floor @ f_T_b
    n = scene.keyframes
    instruments = {
        "attitudes": _attitudes(scene, w_T_b, rng),
        "ranges": _ranges(scene, f_T_b, rng),
        "positions": _positions(scene, w_T_b, rng),
        "heights": _heights(scene, w_T_b, rng),
    }
    tracks, point, is_moving = _tracked(scene, f_T_b, rng)
    measurements = Measurements(
        np.arange(n) * 1.0,
        **instruments,
        tracks=tracks,
        camera=scene.camera,
        range_gain_std=scene.range_gain_std,
        range_datum_std_m=scene.range_datum_std_m,
    )
    # A pose graph's map: a little off everywhere, a few percent in scale, first keyframe over the origin.
    off = np.concatenate([rng.normal(0, 0.01, (n, 3)), rng.normal(0, 0.02 * scene.height_m, (n, 3))], axis=1)
    off[0] *= 0 if placed else [1, 1, 0, 0, 0, 1]
    start = w_T_b @ se3.exp(off)
    if not placed:
        start[0, :2, 3] = 0.0
        start[:, :3, 3] *= 1.03
    floor_z_m, lens = float(floor[2, 3]), _lens(scene)
    return Made(measurements, start, w_T_b, floor_z_m, scene.slope_rad, lens, point, is_moving)


def _heights(scene: Scene, w_T_b: np.ndarray, rng: np.random.Generator) -> tuple[BarometerHeight, ...]:
    """Over a level far below."""
    std_m = scene.barometer_std_m
    if std_m is None:
        return ()
    read = 431.0 + scene.barometer_gain * w_T_b[:, 2, 3] + rng.normal(0, std_m, len(w_T_b))
    return tuple(BarometerHeight(k, float(height), std_m) for k, height in enumerate(read))


def _lens(scene: Scene) -> np.ndarray:
    focal_px = scene.focal_ratio * np.array(scene.camera.focal_px)
    center_px = np.array(scene.camera.center_px) + scene.center_off_px
    brown = scene.radial, 0.0, *scene.tangential, 0.0
    return np.array([*focal_px, *center_px, *(scene.fisheye or brown)])


def _recorded(xy: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """Pixels (m, 2) of directions (m, 2) at depth 1 (Brown 1966; Kannala and Brandt 2006)."""
    x, y = xy.T
    if len(lens) == 8:
        angle = np.arctan(np.hypot(x, y))
        recorded = np.polyval([*lens[:3:-1], 1.0], angle**2) * angle
        return xy * (recorded / np.hypot(x, y))[:, None] * lens[:2] + lens[2:4]
    k1, k2, p1, p2, k3 = lens[4:]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    decentred = 2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return (xy * radial[:, None] + np.column_stack(decentred)) * lens[:2] + lens[2:4]


def _poses(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """(n, 4, 4) over the floor z = 0: there along one line, back along another, so that pictures overlap."""
    n, h = scene.keyframes, scene.height_m
    there = (n + 1) // 2
    x = np.concatenate([np.arange(there), np.arange(n - there)[::-1] + 0.5]) * 0.3 * h
    y = np.where(np.arange(n) < there, 0.0, 0.4 * h)
    angles = rng.normal(0, scene.tilt_std_rad, (n, 3))
    angles[0, 0] = 0.0
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    T[:, :3, 3] = np.column_stack([x, y, h * (1 + scene.height_swing * np.sin(np.arange(n)))])
    T[1:, :2, 3] += rng.normal(0, 0.02 * h, (n - 1, 2))
    return T


def _tracks(scene: Scene, f_T_b: np.ndarray, rng: np.random.Generator) -> FloorTracks:
    return _tracked(scene, f_T_b, rng)[0]


def _tracked(
    scene: Scene, f_T_b: np.ndarray, rng: np.random.Generator
) -> tuple[FloorTracks, np.ndarray, np.ndarray]:
    """Points spread evenly; as many in each view as asked for, on average. Beside the tracks: true points
    (t, 3) at the first keyframe, and which of them move."""
    camera, h, lens = scene.camera, scene.height_m, _lens(scene)
    f_T_c = f_T_b @ camera.b_T_c
    lo, hi = f_T_c[:, :2, 3].min(axis=0) - 1.5 * h, f_T_c[:, :2, 3].max(axis=0) + 1.5 * h
    view = np.prod(np.array(scene.size_px) * h / camera.focal_px)
    count = int(scene.points_in_view * np.prod(hi - lo) / view)
    z = rng.normal(0, scene.relief * h, count) + 0.25 * h * (rng.uniform(size=count) < scene.walls)
    point = np.column_stack([rng.uniform(lo, hi, (count, 2)), z])
    if scene.box is not None:
        x, y = point[:, :2].T / h
        inside = (x > scene.box[0]) & (x < scene.box[1]) & (y > scene.box[2]) & (y < scene.box[3])
        point[:, 2] += 0.25 * h * inside
    if scene.rolling:
        point[:, 2] += scene.rolling * h * _waves(point[:, :2] / h, scene.wavelengths, rng)
    noise = rng.normal(0, scene.pixel_std, (len(f_T_c), count, 2))
    for k in range(1, len(noise)):
        noise[k] = scene.pixel_colour * noise[k - 1] + np.sqrt(1 - scene.pixel_colour**2) * noise[k]
    draw = np.random.default_rng(count)  # beside the other draws, which stay without it
    is_moving, angle = draw.uniform(size=count) < scene.moving, draw.uniform(0, 2 * np.pi, count)
    speed = 0.05 * h * is_moving * np.array([np.cos(angle), np.sin(angle), 0 * angle])
    rows, velocity = [], np.gradient(f_T_c[:, :3, 3], axis=0)
    velocity[list(scene.stops)] = 0.0
    turn = camera_turns(scene)
    for k, pose in enumerate(f_T_c):
        c_p = (point + k * speed.T - pose[:3, 3]) @ pose[:3, :3]
        xy = c_p[:, :2] / c_p[:, 2:]
        pixel = _recorded(xy, lens)
        for _ in range(3 if scene.readout_s else 0):
            since_s = scene.readout_s * (pixel[:, 1:] / (scene.size_px[1] - 1) - 0.5)
            late = c_p - since_s * (velocity[k] @ pose[:3, :3] + np.cross(turn[k], c_p))
            xy = late[:, :2] / late[:, 2:]
            pixel = _recorded(xy, lens)
        # Beyond 45 degrees Brown's distortion folds points back into the picture: a lens does not see them.
        ahead = (c_p[:, 2] > 0) & (np.abs(xy) < (1.0 if scene.fisheye is None else 3.0)).all(axis=1)
        seen = np.flatnonzero(ahead & (pixel > 0).all(axis=1) & (pixel < scene.size_px).all(axis=1))
        pixel = pixel[seen] + noise[k, seen]
        rows += [(k, t, *p) for t, p in zip(seen, pixel, strict=True)]
    table = np.array(rows)
    track = table[:, 1].astype(int)
    table = table[np.bincount(track)[track] >= 2]
    number, track = np.unique(table[:, 1].astype(int), return_inverse=True)
    nominal = np.full(len(table), scene.told_pixel_std)
    tracks = FloorTracks(table[:, 0].astype(int), track, table[:, 2:], nominal)
    return tracks, point[number], is_moving[number]


def camera_turns(scene: Scene) -> np.ndarray:
    """Angular velocities (n, 3) in the axes of the camera, in rad/s."""
    rng = np.random.default_rng(scene.keyframes)
    return scene.turn_std_rad_s * rng.normal(size=(scene.keyframes, 3))


def _waves(xy: np.ndarray, wavelengths: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Heights (t,) of unit variance at places (t, 2): waves of any direction and phase."""
    angle, phase = rng.uniform(0, 2 * np.pi, (2, _WAVES))
    number = 2 * np.pi / rng.uniform(*wavelengths, _WAVES)
    along = xy @ (number * np.array([np.cos(angle), np.sin(angle)]))
    return np.sqrt(2.0 / _WAVES) * np.sin(along + phase).sum(axis=1)


def _attitudes(scene: Scene, w_T_b: np.ndarray, rng: np.random.Generator) -> tuple[Attitude, ...]:
    if scene.attitude_std_rad is None:
        return ()
    angles = Rotation.from_matrix(w_T_b[:, :3, :3]).as_euler("ZYX")[:, ::-1]
    angles = angles + rng.normal(0, scene.attitude_std_rad, angles.shape)
    return tuple(Attitude(k, a, np.full(3, scene.attitude_std_rad)) for k, a in enumerate(angles))


def _ranges(scene: Scene, f_T_b: np.ndarray, rng: np.random.Generator) -> tuple[SlantRange, ...]:
    if scene.range_std_m is None:
        return ()
    slant = scene.range_gain * f_T_b[:, 2, 3] / f_T_b[:, 2, 2] + scene.range_datum_m
    slant = slant + rng.normal(0, scene.range_std_m, len(slant))
    return tuple(SlantRange(k, float(r), scene.range_std_m) for k, r in enumerate(slant))


def _positions(scene: Scene, w_T_b: np.ndarray, rng: np.random.Generator) -> tuple[Position, ...]:
    if scene.position_std_m is None:
        return ()
    std = np.array([scene.position_std_m[0], *scene.position_std_m])
    return tuple(Position(k, w_T_b[k, :3, 3] + rng.normal(0, std), std) for k in range(len(w_T_b)))


def aligned(hat: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Poses with the first one's position and heading on the truth's."""
    yaw = [np.arctan2(T[1, 0], T[0, 0]) for T in (hat[0], truth[0])]
    rotation = Rotation.from_euler("z", yaw[1] - yaw[0]).as_matrix()
    out = hat.copy()
    out[:, :3, :3] = rotation @ hat[:, :3, :3]
    out[:, :3, 3] = (hat[:, :3, 3] - hat[0, :3, 3]) @ rotation.T + truth[0, :3, 3]
    return out


def nees(hat: np.ndarray, truth: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """(n,) squared whitened errors, 6 degrees of freedom each."""
    xi = se3.log(se3.inverse(hat) @ truth)
    return np.einsum("na,na->n", xi, np.linalg.solve(covariances, xi[..., None])[..., 0])


def mark_nees(made: Made, found: Bundle, k: int) -> float:
    """Squared whitened error, 2 degrees of freedom, of where a map over its floor has a mark half a height
    ahead of a keyframe, put where the refined picture shows it; the camera looks from the body's origin."""
    truth, floor_z_m = over_floor(made.w_T_b, made.slope_rad, made.floor_z_m)[k], made.floor_z_m
    over = over_floor(found.w_T_b, found.floor_slope_rad, found.floor_z_m)
    if not made.measurements.positions:
        # Heights are the floor's, not the first keyframe's.
        z = over[:, 2, 3].copy()
        over = aligned(over, made.w_T_b)
        over[:, 2, 3] = z
    hat = over[k]
    mark = np.array([*(truth[:2, 3] + 0.5 * truth[:2, 0] * (truth[2, 3] - floor_z_m)), floor_z_m])
    ray = hat[:3, :3] @ truth[:3, :3].T @ (mark - truth[:3, 3])
    place = hat[:3, 3] + ray * (found.floor_z_m - hat[2, 3]) / ray[2]
    J = ground_jacobian(place, hat[:3, 3], hat[:3, 3]) @ np.kron(np.eye(2), hat[:3, :3])
    off = (place - mark)[:2]
    return float(off @ np.linalg.solve(J @ found.over_floor_covariances[k] @ J.T, off))
