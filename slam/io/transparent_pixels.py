"""Pictures with transparent pixels: masks of other programs, and edges of pictures that were undistorted."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from slam.core.messages import Message, warning
from slam.io.images import sample_of

_OPAQUE = 255


def transparent_pixels(paths: Sequence[Path]) -> list[Message]:
    """Return a line if a sample of the pictures has transparent pixels, whose colours are read nevertheless.

    Unreadable pictures are ignored, as they are counted when they are loaded.
    """
    sample = sample_of(len(paths))
    masked = sum(_is_masked(paths[k]) for k in sample)
    if not masked:
        return []
    return [
        warning(
            f"pictures have transparent pixels ({masked} of {len(sample)} that were looked at): the colour "
            "beneath, often black, is taken for ground, and the mosaic shows it",
            "give the whole pictures, or crop them",
        )
    ]


def _is_masked(path: Path) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of damaged tags
            with Pillow.open(path, formats=["PNG", "TIFF"]) as picture:
                if not picture.has_transparency_data:
                    return False
                return bool((np.asarray(picture.convert("RGBA"))[..., 3] < _OPAQUE).any())
    except Exception:  # noqa: BLE001  Pillow raises any exception for a damaged file
        return False
