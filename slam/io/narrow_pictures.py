"""A flight with smaller pictures: they track at the pace of the camera, and take less disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slam.core.flight import Flight
from slam.core.messages import about
from slam.core.streams import Image


@dataclass(frozen=True)
class NarrowPictures:
    """Loader of another loader's pictures, reduced in size."""

    whole: Callable[[int], Image | None]
    size_px: tuple[int, int]
    """(width, height) of the whole pictures."""
    narrow_px: tuple[int, int]
    """(width, height) of the reduced ones."""

    def __call__(self, k: int) -> Image | None:
        """Return picture k reduced, as it is if it has another size than the whole ones, or None."""
        image = self.whole(k)
        return None if image is None else self.reduced(image)

    def reduced(self, image: Image) -> Image:
        """Return a whole picture reduced, as it is if it has another size."""
        if image.shape[1::-1] != self.size_px:
            return image  # the front end names a picture of another size
        return np.asarray(cv2.resize(image, self.narrow_px, interpolation=cv2.INTER_AREA))


def with_narrow_pictures(flight: Flight, width_px: int, why: str) -> Flight:
    """Return the flight with pictures of at most ``width_px``.

    Where they are reduced, a warning tells it, and ``why``.
    """
    camera, frames = flight.camera, flight.frames
    if camera is None or frames is None or camera.size_px[0] <= width_px:
        return flight
    narrow = camera.narrowed(width_px)
    load = NarrowPictures(frames.load, camera.size_px, narrow.size_px)
    before, after = (f"{c.size_px[0]} x {c.size_px[1]}" for c in (camera, narrow))
    return replace(flight, camera=narrow, frames=replace(frames, load=load)).with_warning(
        about("cam0", f"pictures reduced from {before} to {after} pixels{why}")
    )
