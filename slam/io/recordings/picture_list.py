"""Pictures in files that a list names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.lens_priors import UNKNOWN_FOCAL_STD_RATIO
from slam.core.messages import Message, warning
from slam.core.streams import Image
from slam.io.files import read_bytes, refusal
from slam.io.photos.camera import ASSUMED_VIEW, assumed_focal_px
from slam.io.picture_headers import MAX_BYTES, UnreadableImageError, image_size
from slam.io.recordings.recording import PictureChannel

MOUNT_NOTE = warning(
    "looking straight down with the nose at the top assumed", "run slam import to correct T_BS"
)


def listed_pictures(
    path: Path,
    stamps_ns: NDArray[np.int64],
    names: tuple[str, ...],
    camera_of: Callable[[tuple[int, int]], tuple[Camera, Message]],
    notes: tuple[Message, ...] = (),
) -> PictureChannel:
    """Return the pictures that the list at ``path`` names, relative to its folder.

    ``camera_of`` returns the camera of pictures of a size, and a note. Raises ``InputError`` where none of
    the files can be read.
    """
    folder = path.parent
    camera, note = camera_of(_size(path, names))

    def fetch(k: int) -> Image | bytes:
        file = folder / names[k]
        if not file.is_file():
            raise UnreadableImageError("missing")
        return read_bytes(file, folder, MAX_BYTES)

    return PictureChannel(
        stamps_ns=stamps_ns,
        names=tuple(Path(name).name for name in names),
        fetch=fetch,
        camera=camera,
        notes=(note, MOUNT_NOTE, *notes),
    )


def assumed_camera(size_px: tuple[int, int]) -> tuple[Camera, Message]:
    """Return a camera with the usual view, and a note that says so."""
    width, height = size_px
    focal_px = assumed_focal_px(size_px)
    camera = Camera(
        focal_px=(focal_px, focal_px),
        center_px=((width - 1) / 2, (height - 1) / 2),
        size_px=size_px,
        focal_std_ratio=UNKNOWN_FOCAL_STD_RATIO,
    )
    return camera, warning(f"focal length {focal_px:.0f} px assumed: {ASSUMED_VIEW}", "calibrate the camera")


def _size(path: Path, names: tuple[str, ...]) -> tuple[int, int]:
    for name in names:
        try:
            return image_size(path.parent / name)
        except UnreadableImageError:
            continue
    raise refusal(path, "lists no picture that can be read", "copy the pictures beside it")
