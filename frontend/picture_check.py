"""Check of picture type and size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unusable_reason(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> str:
    """Return why a picture is unusable for a camera of ``size_px`` (width, height); empty if it is usable."""
    if picture.dtype != np.uint8 or picture.shape[2:] not in ((), (3,)):
        return "neither 8-bit grey nor colour"
    if picture.shape[1::-1] != size_px:
        return "of another size than the camera's"
    return ""
