"""Made cameras over a made floor with surveyed points, seen by a camera code of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backend.bundle.refinement import Bundle, refine
from backend.measurements import ControlPoint, PinholeModel
from tests.backend.bundle.made_scenes import SURVEY
from tests.backend.made_floor import NADIR, Made, make

CAMERA = PinholeModel((1024.0, 1024.0), (639.5, 479.5), NADIR)
SCENE = replace(SURVEY, camera=CAMERA, size_px=(1280.0, 960.0), keyframes=12, height_swing=0.15)
"""A pixel is 5 cm on the ground."""
SURVEYED = replace(SCENE, position_std_m=(3.0, 4.0), tilt_std_rad=0.1)
STD_M, STD_PX = 0.02, 0.5
DATUM_M = np.array([0.8, -0.5, 47.0])
"""Positions above those of the control points: heights over the ellipsoid, and another datum."""


def surveyed(made: Made, seed: int, count: int = 8) -> tuple[list[ControlPoint], np.ndarray]:
    """Points with noise of survey and views, by a camera of this test's own; true places (count, 3)."""
    rng = np.random.default_rng(seed + 1000)
    fx, fy, cx, cy, k1, *_ = made.lens
    lo, hi = made.w_T_b[:, :2, 3].min(axis=0) - 8.0, made.w_T_b[:, :2, 3].max(axis=0) + 8.0
    places, points = [], []
    while len(points) < count:
        place = np.array([*rng.uniform(lo, hi), made.floor_z_m + rng.uniform(0.0, 4.0)])
        views = []
        for k, w_T_b in enumerate(made.w_T_b):
            right, down, ahead = np.linalg.inv(w_T_b @ NADIR)[:3] @ [*place, 1.0]
            x, y = right / ahead, down / ahead
            bent = 1.0 + k1 * (x**2 + y**2)
            u, v = fx * bent * x + cx, fy * bent * y + cy
            if 0 < u < 1280 and 0 < v < 960:
                views.append((k, u + rng.normal(0, STD_PX), v + rng.normal(0, STD_PX)))
        if len(views) < 3:
            continue
        rows = np.array(views)
        places.append(place)
        points.append(
            ControlPoint(
                f"P{len(points)}", place + rng.normal(0, STD_M, 3), np.full(3, STD_M),
                rows[:, 0].astype(int), rows[:, 1:], STD_PX,
            )
        )  # fmt: skip
    return points, np.array(places)


def refined(
    seed: int, wrong_m: float = 0.0, scene=SURVEYED, datum_m=DATUM_M
) -> tuple[Made, Bundle, list, np.ndarray]:
    """A map with six control points, the other two held out."""
    made = make(scene, seed)
    points, places = surveyed(made, seed)
    points[0] = replace(points[0], w_p_m=points[0].w_p_m + [wrong_m, 0, 0])
    shifted = [replace(p, w_p_antenna_m=p.w_p_antenna_m + datum_m) for p in made.measurements.positions]
    measured = replace(made.measurements, positions=tuple(shifted), control=tuple(points[:6]))
    return made, refine(measured, made.start, made.floor_z_m), points, places
