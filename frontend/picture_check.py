"""Why a picture is of no use, whatever it shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unusable_reason(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> str:
    """What is wrong with a picture of a camera of ``size_px`` (width, height); empty if nothing is."""
    if picture.dtype != np.uint8 or picture.shape[2:] not in ((), (3,)):
        return "neither 8-bit grey nor colour"
    if picture.shape[1::-1] != size_px:
        return "of another size than the camera's"
    return ""
