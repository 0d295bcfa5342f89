"""First picture of the README: the demo's flight as a chain of pictures, without loops, and as one map.

``python -m tests.benchmarks.figure_eight_picture`` writes docs/figure_eight.jpg.

All three are drawn in the world frame of the truth, aligned at their first keyframes. The square through the
marks is the true one, placed on mark A; it leaves out the marks, and each letter is beside its mark.
"""

from __future__ import annotations

import io
import tempfile
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from slam.cli.demo import DEMO_RECIPE
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.aligned_maps import AlignedMap, AlignedMaps, aligned_maps
from slam.evaluation.association import associate
from slam.evaluation.landmarks import landmark_places
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from slam.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

PICTURE = Path(__file__).parents[2] / "docs" / "figure_eight.jpg"
CORNERS = ("B", "C", "G", "F")
CLEAR_M = 0.1
"""Gap between the square and the centre of a mark, which is 12 cm in diameter."""
BESIDE_M = 0.17
GSD_M = 0.005


@dataclass(frozen=True)
class Drawn:
    """One map as a picture in the world frame of the truth."""

    title: str
    rgb: NDArray[np.uint8]
    extent_m: tuple[float, float, float, float]
    """Bounds: west, east, south, north."""
    marks: dict[str, Array]
    """Landmark -> (2,) its position in the map."""


def main() -> None:
    """Simulate, map, and draw."""
    flight = simulate(DEMO_RECIPE, 0)
    estimate = optimize(flight)
    maps = aligned_maps(estimate, associate(estimate, flight))
    panels = (
        drawn("Chain: each picture laid on the one before it", estimate, flight, maps, maps.chain),
        drawn("Neighbours placed together, no loops", estimate, flight, maps, maps.odometry),
        drawn("Map: loops closed", estimate, flight, maps, maps.loops),
    )
    Image.open(io.BytesIO(page(flight, panels))).convert("RGB").save(PICTURE, quality=82, optimize=True)


def drawn(title: str, estimate: Estimate, flight: Flight, maps: AlignedMaps, made: AlignedMap) -> Drawn:
    """Return the mosaic of one map, and its landmarks."""
    level = {"floor_z_m": made.floor_z_m, "floor_slope_rad": (0.0, 0.0)}
    there = replace(estimate, w_T_b=made.w_T_b, **level)
    with tempfile.TemporaryDirectory() as folder:
        files = write_mosaic(there, flight, folder, GSD_M)
        step, _, _, _, west, north = (float(line) for line in files.world_file.read_text().split())
        rgba = np.asarray(Image.open(files.png).convert("RGBA"))
    seen = rgba[..., 3:] > 0
    height, width = rgba.shape[:2]
    west, north = west - step / 2, north + step / 2
    extent_m = (west, west + width * step, north - height * step, north)
    places = landmark_places(estimate, flight, associate(estimate, flight), replace(maps, loops=made))
    marks = {name: place[:2] for name, place in places.items()}
    return Drawn(title, np.where(seen, rgba[..., :3], 255).astype(np.uint8), extent_m, marks)


def page(flight: Flight, maps: tuple[Drawn, ...]) -> bytes:
    """Return the maps side by side at one scale, as PNG."""
    figure = Figure(figsize=(16.0, 6.2), dpi=100, layout="constrained")
    panels = figure.subplots(1, len(maps), sharex=True, sharey=True)
    for axes, made in zip(panels, maps, strict=True):
        axes.imshow(made.rgb, extent=made.extent_m, interpolation="antialiased")
        axes.set_title(made.title, fontsize=16, loc="left")
        _square(axes, flight, made)
        _letters(axes, made)
        axes.axis("off")
    west, east, south, north = np.array([made.extent_m for made in maps]).T
    panels[0].set(xlim=(west.min(), east.max()), ylim=(south.min(), north.max()))
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def _square(axes: Axes, flight: Flight, made: Drawn) -> None:
    shift = made.marks["A"] - flight.landmarks["A"][:2]
    corners = np.array([flight.landmarks[name][:2] for name in (*CORNERS, CORNERS[0])]) + shift
    sides = [np.linspace(a, b, 1000) for a, b in pairwise(corners)]
    line = np.concatenate(sides)
    near = np.linalg.norm(line[:, None] - np.array(list(made.marks.values())), axis=2).min(axis=1) < CLEAR_M
    line[near] = np.nan
    axes.plot(*line.T, color="black", lw=3.4, solid_capstyle="butt")
    axes.plot(*line.T, color="white", lw=1.8, solid_capstyle="butt")


def _letters(axes: Axes, made: Drawn) -> None:
    middle = np.mean(list(made.marks.values()), axis=0)
    for name, mark in made.marks.items():
        outwards = float(np.sign(mark[0] - middle[0]))
        text = axes.text(
            mark[0] + outwards * BESIDE_M, mark[1], name, color="white", fontsize=15, weight="bold",
            ha="right" if outwards < 0 else "left", va="center",
        )  # fmt: skip
        text.set_path_effects([withStroke(linewidth=4, foreground="black")])


if __name__ == "__main__":
    main()
