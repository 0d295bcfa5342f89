"""A flight with smaller pictures, which can be tracked at the pace of the camera."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from slam.core.flight import Flight, Image


def with_narrow_pictures(flight: Flight, width_px: int) -> Flight:
    """Return the flight with pictures of at most ``width_px``, and a warning where they are reduced."""
    camera, frames = flight.camera, flight.frames
    if camera is None or frames is None or camera.size_px[0] <= width_px:
        return flight
    narrow = camera.narrowed(width_px)

    def load(k: int) -> Image | None:
        image = frames.load(k)
        if image is None or image.shape[1::-1] != camera.size_px:
            return image  # the front end names a picture of another size
        return np.asarray(cv2.resize(image, narrow.size_px, interpolation=cv2.INTER_AREA))

    before, after = (f"{c.size_px[0]} x {c.size_px[1]}" for c in (camera, narrow))
    return replace(flight, camera=narrow, frames=replace(frames, load=load)).with_warning(
        f"cam0: pictures reduced from {before} to {after} pixels, so that tracking keeps pace; slam optimize "
        "uses the whole ones"
    )
