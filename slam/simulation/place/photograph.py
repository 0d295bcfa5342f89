"""A floor from a photograph: any JPEG or PNG whose header is checked before it is decoded."""

from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError

Image = NDArray[np.uint8]

MAX_TEXELS = 64_000_000


def check_photograph(path: Path) -> None:
    """Check the header of the file before any of it is decoded. Raises ``InputError``."""
    from PIL import Image as Photograph

    if not path.is_file():
        raise InputError(
            f"world.texture: {str(path)!r}: no such file; "
            "give 'puzzle', 'gym', 'lines', 'plain' or a photograph"
        )
    too_large = InputError(f"world.texture: {str(path)!r}: more than {MAX_TEXELS} px; scale it down")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Photograph.DecompressionBombWarning)
            with Photograph.open(path) as photograph:
                width, height = photograph.size
    except (Photograph.DecompressionBombWarning, Photograph.DecompressionBombError):
        raise too_large from None
    except (OSError, ValueError):
        raise InputError(
            f"world.texture: {str(path)!r}: not a picture that can be read; give a JPEG or PNG"
        ) from None
    if width * height > MAX_TEXELS:
        raise too_large


def photographed_floor(path: Path, width: int, height: int) -> Image:
    """Return the photograph at the floor's lower left corner, mirrored beyond its edges to fill the
    texture."""
    photograph = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if photograph is None:
        raise InputError(f"world.texture: {str(path)!r}: damaged or not a picture; give a JPEG or PNG")
    photograph = photograph[-height:, :width]
    h, w = photograph.shape[:2]
    return np.asarray(cv2.copyMakeBorder(photograph, height - h, 0, 0, width - w, cv2.BORDER_REFLECT))
