"""A made set of photographs over painted ground: rendered and projected by a camera code of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.control_points import PictureView, SurveyedPoint
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.rotations import roll_pitch_yaw_of
from slam.core.streams import AttitudeSeries, Frames, Gps

ORIGIN = GeoOrigin(47.0, 8.0, 400.0)
SIZE_PX, FOCAL_PX, HEIGHT_M = (480, 360), 480.0, 30.0
CENTER_PX = (239.5, 179.5)
CELL_M = 0.05
"""Size of a cell of the ground: smaller than a pixel, which is 6 cm."""
WEST_M, NORTH_M = -40.0, 60.0
"""Corner of the ground."""


@dataclass(frozen=True)
class Survey:
    """Photographs with GPS, and what they show."""

    flight: Flight
    w_T_c: np.ndarray
    """(n, 4, 4) true poses of the camera: x to the right of the picture, y down in it, z ahead."""
    places: np.ndarray
    """(p, 3) true places of the surveyed points."""


@lru_cache
def ground() -> np.ndarray:
    """Blots of several sizes, brown and grey."""
    rng = np.random.default_rng(7)
    total = np.zeros((2000, 2000))
    for cells in (20, 60, 200, 600, 1500):
        blots = rng.normal(0, 1, (cells, cells)).astype(np.float32)
        total += cv2.resize(blots, (2000, 2000), interpolation=cv2.INTER_CUBIC)
    level = np.clip(128 + 28 * total, 0, 255)
    return np.dstack([0.8 * level, 0.9 * level, level]).astype(np.uint8)


def seen_in(w_T_c: np.ndarray, place: np.ndarray) -> np.ndarray | None:
    """Pixel (2,) of a place, by similar triangles; None outside of the picture."""
    x, y, z = w_T_c[:3, :3].T @ (place - w_T_c[:3, 3])
    pixel = FOCAL_PX * np.array([x, y]) / z + CENTER_PX
    return pixel if ((pixel > 5) & (pixel < np.array(SIZE_PX) - 5)).all() else None


def with_water(west: float, east: float, south: float, north: float, number: int) -> np.ndarray:
    """The ground with waves in a rectangle, which are others for each number."""
    floor, rng = ground().copy(), np.random.default_rng(100 + number)
    rows = slice(round((NORTH_M - north) / CELL_M), round((NORTH_M - south) / CELL_M))
    columns = slice(round((west - WEST_M) / CELL_M), round((east - WEST_M) / CELL_M))
    size = columns.stop - columns.start, rows.stop - rows.start
    waves = np.zeros(size[::-1], np.float32)
    for cells in (20, 60, 150):
        blots = rng.normal(0, 1, (cells, cells)).astype(np.float32)
        waves += cv2.resize(blots, size, interpolation=cv2.INTER_CUBIC)
    level = np.clip(110 + 25 * waves, 0, 255)
    floor[rows, columns] = np.dstack([level, 0.8 * level, 0.6 * level]).astype(np.uint8)
    return floor


@lru_cache
def clouds() -> np.ndarray:
    """The sky by direction: rows of a tenth of a degree from the horizon up, columns once around."""
    rng = np.random.default_rng(11)
    total = np.zeros((900, 3600), np.float32)
    for cells in (20, 60, 150):
        blots = rng.normal(0, 1, (cells, 4 * cells)).astype(np.float32)
        total += cv2.resize(blots, (3600, 900), interpolation=cv2.INTER_CUBIC)
    return np.dstack([np.clip(200 + 25 * total, 0, 255).astype(np.uint8)] * 3)


def picture(
    w_T_c: np.ndarray,
    focal_px: float = FOCAL_PX,
    floor: np.ndarray | None = None,
    moved_m: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """The ground, mirrored beyond its border, and clouds above the horizon.

    ``moved_m``: how far the camera moves, east, north and up, from the first row to the last.
    """
    columns, rows = SIZE_PX
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    x, y = (u - CENTER_PX[0]) / focal_px, (v - CENTER_PX[1]) / focal_px
    east, north, up = (row[0] * x + row[1] * y + row[2] for row in w_T_c[:3, :3])
    late = v / (rows - 1) - 0.5
    at_east, at_north, at_up = (w_T_c[axis, 3] + late * moved_m[axis] for axis in range(3))
    there = at_up / np.where(up < 0, -up, np.inf)
    cells = (at_east + there * east - WEST_M, NORTH_M - at_north - there * north)
    at = [(distance / CELL_M - 0.5).astype(np.float32) for distance in cells]
    floor = ground() if floor is None else floor
    shown = cv2.remap(floor, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    above = up >= 0
    if above.any():
        around = (np.degrees(np.arctan2(east, north)) % 360)[above] / 0.1
        shown[above] = clouds()[
            (np.degrees(np.arctan2(up, np.hypot(east, north)))[above] / 0.1).astype(int),
            around.astype(int) % 3600,
        ]
    return shown


def poses(
    rows: int, columns: int, rng: np.random.Generator, forward_rad: float = 0.0, tilt_std_rad: float = 0.05
) -> np.ndarray:
    """Strips to the north and back, 60 % overlap along and across, tilts of some degrees.

    A camera that looks forward, and not down, is not turned at the end of a strip: it looks to the north.
    """
    out = []
    for column in range(columns):
        for row in range(rows) if column % 2 == 0 else reversed(range(rows)):
            T = np.eye(4)
            heading = 0.0 if column % 2 == 0 or forward_rad else np.pi
            lean = Rotation.from_euler("zyx", [heading, *rng.normal(0, tilt_std_rad, 2)])
            lean *= Rotation.from_euler("x", forward_rad)
            # North is up in the picture of a camera that flies north.
            T[:3, :3] = (lean * Rotation.from_euler("x", np.pi)).as_matrix()
            T[:3, 3] = [12.0 * column, 9.0 * row, HEIGHT_M + rng.normal(0, 1.0)]
            out.append(T)
    return np.array(out)


def photographed(
    w_T_c: np.ndarray,
    rng: np.random.Generator,
    gps_std_m: float,
    datum_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    focal_px: float = FOCAL_PX,
    every_s: float = 2.0,
    readout_s: float = 0.0,
) -> Flight:
    """Photographs from true poses (n, 4, 4), with GPS that has noise and lies off by ``datum_m``.

    The poses are those of the middle row. ``readout_s``: time from the exposure of the first to the last.
    """
    n = len(w_T_c)
    names = tuple(f"photo_{k:02}.jpg" for k in range(n))
    camera = Camera((focal_px, focal_px), CENTER_PX, SIZE_PX, b_T_c=NADIR_B_T_C)
    fixes = w_T_c[:, :3, 3] + rng.normal(0, gps_std_m, (n, 3)) + datum_m
    stamps_s = every_s * np.arange(n)
    gps = Gps(stamps_s, *geodetic_from_enu(fixes, ORIGIN), noise_std_m=(gps_std_m,) * 3)
    moved_m = readout_s * np.gradient(w_T_c[:, :3, 3], every_s, axis=0)
    frames = Frames(stamps_s, names, lambda k: picture(w_T_c[k], focal_px, moved_m=moved_m[k]))
    return Flight("survey", camera=camera, frames=frames, gps=gps, all_keyframes=True)


def with_gimbal(flight: Flight, w_T_c: np.ndarray, rng: np.random.Generator) -> Flight:
    """The flight with the angles of a gimbal: heading good to 5 degrees, tilt and turn of the picture to 2.

    They turn about the world's up, about the level axis across the view, and about the optical axis.
    """
    angles, squares = [], []
    for R in w_T_c[:, :3, :3]:
        across = np.cross(R[:, 2], [0, 0, 1.0])
        across = R[:, 0] if np.linalg.norm(across) < 0.1 else across / np.linalg.norm(across)
        turns = np.radians([5.0, 2.0, 2.0]) * rng.normal(0, 1, 3)
        off = np.eye(3)
        for axis, turn in zip((np.array([0, 0, 1.0]), across, R[:, 2]), turns, strict=True):
            off = off @ Rotation.from_rotvec(turn * axis).as_matrix()
        angles.append(roll_pitch_yaw_of(off @ R @ NADIR_B_T_C[:3, :3].T))
        squares.append(R[2, 2] ** -2)
    # A turn about the axis is a roll times the tangent of the tilt, and a heading over its cosine.
    roll, yaw = max(2.0, 2 * np.sqrt(np.mean(squares) - 1)), max(5.0, 2 * np.sqrt(np.mean(squares)))
    std_rad = tuple(np.radians([roll, 2.0, yaw]).tolist())
    return replace(flight, attitude=AttitudeSeries(flight.frames.stamps_s, np.array(angles), std_rad))


def survey(
    rows: int = 5,
    columns: int = 3,
    points: int = 8,
    gps_std_m: float = 3.0,
    datum_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    std_m: float = 0.02,
    std_px: float = 0.3,
    seed: int = 0,
) -> Survey:
    """Photographs whose GPS has noise and lies off by ``datum_m``, and points P0.. with noise of survey."""
    rng = np.random.default_rng(seed)
    w_T_c = poses(rows, columns, rng)
    flight = photographed(w_T_c, rng, gps_std_m, datum_m)
    names = flight.frames.names
    places, surveyed = [], []
    while len(places) < points:
        east, north = rng.uniform(-6, 12 * (columns - 1) + 6), rng.uniform(-6, 9 * (rows - 1) + 6)
        place = np.array([east, north, 0.0])
        views = [(name, seen_in(T, place)) for name, T in zip(names, w_T_c, strict=True)]
        marked = [(name, uv + rng.normal(0, std_px, 2)) for name, uv in views if uv is not None]
        if len(marked) < 3:
            continue
        lat, lon, alt = (float(x[0]) for x in geodetic_from_enu(place + rng.normal(0, std_m, 3), ORIGIN))
        shown = tuple(PictureView(name, *uv.tolist()) for name, uv in marked)
        surveyed.append(SurveyedPoint(f"P{len(places)}", lat, lon, alt, shown))
        places.append(place)
    return Survey(replace(flight, surveyed=tuple(surveyed)), w_T_c, np.array(places))


def moved(point: SurveyedPoint, east_m: float) -> SurveyedPoint:
    """The point with wrong coordinates."""
    lat, lon, alt = geodetic_from_enu([east_m, 0.0, 0.0], point.origin)
    return replace(point, latitude_deg=float(lat[0]), longitude_deg=float(lon[0]), altitude_m=float(alt[0]))
