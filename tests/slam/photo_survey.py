"""A made set of photographs over painted ground: rendered and projected by a camera code of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.control_points import PictureView, SurveyedPoint
from slam.core.flight import Flight, Frames, GeoOrigin, Gps
from slam.core.geodesy import geodetic_from_enu

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


def picture(w_T_c: np.ndarray) -> np.ndarray:
    corners = np.array([(0, 0), (SIZE_PX[0], 0), SIZE_PX, (0, SIZE_PX[1])], np.float32)
    cells = []
    for u, v in corners:
        ray = w_T_c[:3, :3] @ [(u - CENTER_PX[0]) / FOCAL_PX, (v - CENTER_PX[1]) / FOCAL_PX, 1.0]
        east, north, _ = w_T_c[:3, 3] - ray * w_T_c[2, 3] / ray[2]
        cells.append(((east - WEST_M) / CELL_M - 0.5, (NORTH_M - north) / CELL_M - 0.5))
    turn = cv2.getPerspectiveTransform(np.array(cells, np.float32), corners)
    return cv2.warpPerspective(ground(), turn, SIZE_PX, flags=cv2.INTER_AREA)


def poses(rows: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Strips to the north and back, 60 % overlap along and across, tilts of some degrees."""
    out = []
    for column in range(columns):
        for row in range(rows) if column % 2 == 0 else reversed(range(rows)):
            T = np.eye(4)
            heading = 0.0 if column % 2 == 0 else np.pi
            lean = Rotation.from_euler("zyx", [heading, *rng.normal(0, 0.05, 2)])
            # North is up in the picture of a camera that flies north.
            T[:3, :3] = (lean * Rotation.from_euler("x", np.pi)).as_matrix()
            T[:3, 3] = [12.0 * column, 9.0 * row, HEIGHT_M + rng.normal(0, 1.0)]
            out.append(T)
    return np.array(out)


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
    n = len(w_T_c)
    names = tuple(f"photo_{k:02}.jpg" for k in range(n))
    camera = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, b_T_c=NADIR_B_T_C)
    fixes = w_T_c[:, :3, 3] + rng.normal(0, gps_std_m, (n, 3)) + datum_m
    stamps_s = 2.0 * np.arange(n)
    gps = Gps(stamps_s, *geodetic_from_enu(fixes, ORIGIN), noise_std_m=(gps_std_m,) * 3)
    frames = Frames(stamps_s, names, lambda k: picture(w_T_c[k]))
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
    flight = Flight("survey", camera=camera, frames=frames, gps=gps, all_keyframes=True)
    return Survey(replace(flight, surveyed=tuple(surveyed)), w_T_c, np.array(places))


def moved(point: SurveyedPoint, east_m: float) -> SurveyedPoint:
    """The point with wrong coordinates."""
    lat, lon, alt = geodetic_from_enu([east_m, 0.0, 0.0], point.origin)
    return replace(point, latitude_deg=float(lat[0]), longitude_deg=float(lon[0]), altitude_m=float(alt[0]))
