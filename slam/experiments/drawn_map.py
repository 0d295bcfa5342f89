"""The map drawn as in the paper: pictures warped onto a canvas, landmarks connected by red lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.aligned_maps import aligned_maps
from slam.evaluation.association import associate
from slam.experiments.stitching import LandmarkErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_SIDE_PX = 900
_MARGIN_M = 0.1
_FARTHEST = 3.0
"""A picture is left out if its ground is farther away than this many times the extent of the landmarks."""


@dataclass(frozen=True)
class DrawnMap:
    """A drawn map, as plain data that a worker process can return."""

    rgb: Image
    extent_m: tuple[float, float, float, float]
    """Left, right, bottom, top, as in matplotlib's ``imshow``."""
    places: dict[str, Array]
    """Landmark -> (x, y) on the map."""
    pairs: tuple[tuple[str, str], ...]


def paint(estimate: Estimate, flight: Flight, errors: LandmarkErrors) -> DrawnMap:
    """Draw all pictures of an estimate on a canvas in order of time, later over earlier (section 3.1)."""
    assert flight.camera is not None
    assert flight.frames is not None
    association = associate(estimate, flight)
    made = aligned_maps(estimate, association).loops
    camera = flight.camera
    shown = [
        (int(estimate.frame_index[association.keyframe[k]]), pose)
        for k, pose in enumerate(made.w_T_b)
        if np.isfinite(pose).all()
    ]
    prints = [camera.footprint(pose, made.floor_z_m) for _, pose in shown]
    middle = np.mean([place[:2] for place in flight.landmarks.values()], axis=0)
    reach = max(np.ptp([place[:2] for place in flight.landmarks.values()], axis=0))
    kept = [
        (frame, pose, ground)
        for (frame, pose), ground in zip(shown, prints, strict=True)
        if np.isfinite(ground).all() and np.abs(ground[:, :2] - middle).max() < _FARTHEST * reach
    ]
    ground = np.concatenate([corners[:, :2] for *_, corners in kept])
    west, south = ground.min(axis=0) - _MARGIN_M
    east, north = ground.max(axis=0) + _MARGIN_M
    gsd = max(east - west, north - south) / _SIDE_PX
    size = (int((east - west) / gsd) + 1, int((north - south) / gsd) + 1)
    canvas = np.full((size[1], size[0], 3), 255, np.uint8)
    canvas_H_floor = np.array([[1 / gsd, 0, -west / gsd - 0.5], [0, -1 / gsd, north / gsd - 0.5], [0, 0, 1]])
    for frame, pose, _ in kept:
        _put(canvas, flight.frames.load(frame), canvas_H_floor @ camera.floor_H_image(pose, made.floor_z_m))
    extent = (west, west + size[0] * gsd, north - size[1] * gsd, north)
    places = {name: place[:2] for name, place in errors.places.items() if np.isfinite(place).all()}
    return DrawnMap(canvas[..., ::-1].copy(), extent, places, flight.landmark_pairs)


def _put(canvas: Image, picture: Image | None, canvas_H_image: Array) -> None:
    if picture is None:
        return
    size = canvas.shape[1::-1]
    # The border is replicated: black would be mixed into the picture's last pixels.
    warped = cv2.warpPerspective(
        picture, canvas_H_image, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    cover = cv2.warpPerspective(
        np.full(picture.shape[:2], 255, np.uint8), canvas_H_image, size, flags=cv2.INTER_NEAREST
    )
    canvas[cover > 0] = warped[cover > 0]


def show(axes: Axes, canvas: DrawnMap, title: str) -> None:
    """Draw a canvas with its landmarks and the red lines between them."""
    axes.imshow(canvas.rgb, extent=canvas.extent_m, interpolation="antialiased")
    for a, b in canvas.pairs:
        if a in canvas.places and b in canvas.places:
            line = np.array([canvas.places[a], canvas.places[b]])
            axes.plot(*line.T, color="red", lw=1.4)
    for name, place in canvas.places.items():
        axes.annotate(
            name,
            (place[0], place[1]),
            xytext=(5, 5),
            textcoords="offset points",
            color="red",
            weight="bold",
            fontsize=11,
        )
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
