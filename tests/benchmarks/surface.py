"""Ground that is not flat: misregistration of the demo, and surface and orthophoto of a simulated village.

The village is mapped with true poses, so that only the surface is judged. Its orthophoto is compared with one
taken from very far away.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.surface import HeightSource
from slam.core.estimate import Estimate, GroundFacts
from slam.core.flight import Flight
from slam.evaluation.association import poses_at
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import MosaicFiles, write_mosaic
from slam.simulation import simulate
from slam.simulation.camera.optics import expose
from slam.simulation.place.obstacles import ROUND, TAPER_WIDTH, TOP, corners
from slam.simulation.place.scene import build_scene
from slam.simulation.place.terrain import elevation
from slam.simulation.place.world import World
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_least, at_most, reported

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GSD_M = 0.005
"""Pixel of the village's mosaic, that of its pictures."""
FAR_M = 5000.0
"""Height of the true picture: a roof of half a metre is displaced by less than a tenth of a pixel."""
WINDOW_PX = 48
"""Side of the window around a roof's corner in which two pictures are compared."""
EDGE_CELLS = 2
"""Cells beside a wall, which show roof and ground in one cell."""


def measure() -> list[Metric]:
    """Return the figures of the demo and of the village."""
    return [*flat_floor(), *village()]


def flat_floor() -> list[Metric]:
    """Return the misregistration of the demo, and the measure's own: that with true poses and lens."""
    recipe = load_recipe("figure_eight")
    flight = simulate(recipe, seed=0)
    clean = simulate(replace(recipe, camera=replace(recipe.camera, noise_std=0.0)), seed=0)
    estimate = optimize(flight)
    assert flight.truth is not None
    poses = poses_at(flight.truth, estimate.stamps_s)
    true = replace(estimate, w_T_b=poses, camera=flight.camera, floor_z_m=0.0, floor_slope_rad=(0.0, 0.0))
    facts, least, without_noise = (
        ground_facts(*of) for of in ((estimate, flight), (true, flight), (true, clean))
    )
    return [
        at_most("demo: misregistration, median", facts.misregistration_px[0], "px", 0.2),
        at_most("demo: misregistration, 95 %", facts.misregistration_px[1], "px", 0.5),
        reported("demo: the same median with true poses and lens", least.misregistration_px[0], "px"),
        reported("demo: the same and without noise", without_noise.misregistration_px[0], "px"),
        at_most("demo: share of the floor that is taken for relief", facts.relief_share, "", 0.0),
    ]


def ground_facts(estimate: Estimate, flight: Flight) -> GroundFacts:
    """Return the facts about the ground of an estimate's mosaic."""
    with tempfile.TemporaryDirectory() as out:
        return write_mosaic(estimate, flight, out).ground.facts


def village() -> list[Metric]:
    """Return the errors of the surface and of the orthophoto of the simulated village."""
    recipe = load_recipe("village")
    flight = simulate(recipe, seed=0)
    with tempfile.TemporaryDirectory() as out:
        made = write_mosaic(true_estimate(flight), flight, out, gsd_m=GSD_M)
        with rasterio.open(made.geotiff) as raster:
            rgb = np.moveaxis(raster.read([1, 2, 3]), 0, 2)
            west_m, north_m = raster.transform.c, raster.transform.f
    off_px = corner_displacements(rgb, recipe.world, west_m, north_m)
    facts = made.ground.facts
    return [
        *surface_errors(made, recipe.world),
        at_least(
            "village: roof corners displaced by at most 1.5 px", 100 * np.mean(off_px <= 1.5), "%", 90.0,
            f"{len(off_px)} corners, median {np.median(off_px):.2g} px",
        ),
        reported("village: misregistration, 95 %, over a floor", facts.over_floor_px[1], "px"),
        reported("village: misregistration, 95 %, over the surface", facts.misregistration_px[1], "px"),
    ]  # fmt: skip


def true_estimate(flight: Flight) -> Estimate:
    """Return the estimate of every second picture of a flight with its true poses."""
    assert flight.truth is not None
    assert flight.frames is not None
    index = np.arange(0, len(flight.frames), 2)
    stamps_s = flight.frames.stamps_s[index]
    poses = poses_at(flight.truth, stamps_s)
    none = np.zeros((len(index), 6, 6))
    return Estimate(
        name=flight.name, epoch_ns=flight.epoch_ns, stamps_s=stamps_s,
        frame_names=tuple(flight.frames.names[k] for k in index), frame_index=index, w_T_b=poses,
        covariances=none, over_floor_covariances=none, component=np.zeros(len(index), np.int64),
        camera=flight.camera, floor_z_m=0.0, origin=None, relative_poses=(), loops=(), chain_w_T_b=poses,
        odometry_w_T_b=poses,
    )  # fmt: skip


def surface_errors(made: MosaicFiles, world: World) -> list[Metric]:
    """Return the error of the heights in ground pixels, beside walls and away from them."""
    surface = made.ground.surface
    assert surface is not None, "the village is not flat"
    rows, cols = surface.height_m.shape
    x = surface.west_m + (np.arange(cols) + 0.5) * surface.cell_m
    y = surface.north_m - (np.arange(rows) + 0.5) * surface.cell_m
    truth = elevation(world, *np.meshgrid(x, y)).astype(np.float32)
    x0, y0, x1, y1 = world.extent_m
    inside = ((x >= x0) & (x <= x1))[None] & ((y >= y0) & (y <= y1))[:, None]
    inside &= surface.source != HeightSource.UNSEEN
    kernel = np.ones((2 * EDGE_CELLS + 1,) * 2, np.uint8)
    # A cone or a roof of 60 degrees is no wall.
    steep = cv2.dilate(truth, kernel) - cv2.erode(truth, kernel) > 2 * len(kernel) * surface.cell_m
    off_px = (surface.height_m - truth) / GSD_M
    known = inside & (surface.source != HeightSource.FILLED)
    away = off_px[known & ~steep]
    with np.errstate(divide="ignore"):
        whitened = (off_px * GSD_M / surface.std_m)[known & ~steep]
    unmeasured = inside & ~surface.measured & (surface.source != HeightSource.FLOOR)
    over_std = (GSD_M * off_px / made.ground.height_std_m)[unmeasured]
    filled = 100 * float((surface.source == HeightSource.FILLED)[inside].mean())
    return [
        at_most(
            "village: height RMSE on roofs and ground", rms(away), "px", 1.5,
            f"without {EDGE_CELLS} cells beside walls; 99 % within {np.percentile(np.abs(away), 99):.2g} px",
        ),
        reported("village: height RMSE, walls too", rms(off_px[known]), "px"),
        reported(
            "village: height RMSE, walls and filled cells too", rms(off_px[inside]), "px",
            f"{filled:.1f} % were filled",
        ),
        reported(
            "village: height errors within one stated standard deviation",
            100 * float(np.mean(np.abs(whitened[np.isfinite(whitened)]) < 1)), "%", "68 % are expected",
        ),
        reported(
            "village: heights that nothing measured, within one stated standard deviation",
            100 * float(np.mean(np.abs(over_std) < 1)), "%", f"RMS {rms(over_std):.2g} of it",
        ),
    ]  # fmt: skip


def corner_displacements(rgb: Image, world: World, west_m: float, north_m: float) -> Array:
    """Return (n,) by how many pixels the orthophoto (h, w, 3) is displaced around the roofs' corners."""
    h, w = rgb.shape[:2]
    focal = FAR_M / GSD_M
    camera = Camera((focal, focal), ((w - 1) / 2, (h - 1) / 2), (w, h))
    w_T_b = np.array([[0, -1.0, 0, 0], [1, 0, 0, 0], [0, 0, 1, FAR_M], [0, 0, 0, 1]])  # the nose to the north
    w_T_b[:2, 3] = west_m + w / 2 * GSD_M, north_m - h / 2 * GSD_M
    truth = cv2.cvtColor(expose(build_scene(world, ()), camera, w_T_b), cv2.COLOR_BGR2GRAY).astype(np.float32)
    ours = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    window = cv2.createHanningWindow((WINDOW_PX, WINDOW_PX), cv2.CV_32F)
    off = []
    for prism in world.prisms:
        if prism[ROUND] or prism[TAPER_WIDTH] or prism[TOP] <= 0:
            continue
        for x, y, _ in corners(prism)[4:]:
            col, row = (round(a - WINDOW_PX / 2) for a in ((x - west_m) / GSD_M, (north_m - y) / GSD_M))
            part = slice(row, row + WINDOW_PX), slice(col, col + WINDOW_PX)
            off.append(np.hypot(*cv2.phaseCorrelate(truth[part], ours[part], window)[0]))
    return np.array(off)


def rms(off: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(off))))
