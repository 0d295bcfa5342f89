"""The lens of a video by the camera's make, model and mode, where the file names them.

GoPro's cameras (since the HERO8) write the diagonal view (``ZFOV``) and the mode (``VFOV``) into the header.
Other makers write the model only; its focal length on 35 mm film is that of their specifications.
Source: GoPro, gpmf-parser; DJI and Parrot, specifications of the models.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass

import numpy as np

from slam.io.lens_fit import fitted_radial, viewing_angles
from slam.io.recordings.video.gpmf import blocks
from slam.io.recordings.video.mp4 import boxes

FILM_WIDTH_MM = 36.0
_MODEL_BOXES = (b"\xa9mdl", b"\xa9mod", b"model")
_FILM_MM = {
    "FC1102": (25.0, "DJI Spark"),
    "FC2103": (24.0, "DJI Mavic Air"),
    "FC220": (26.0, "DJI Mavic Pro"),
    "FC300X": (20.0, "DJI Phantom 3 Professional"),
    "FC3170": (24.0, "DJI Mavic Air 2"),
    "FC330": (20.0, "DJI Phantom 4"),
    "FC3411": (22.0, "DJI Air 2S"),
    "FC350": (20.0, "DJI Zenmuse X3"),
    "FC3582": (24.0, "DJI Mini 3 Pro"),
    "FC6310": (24.0, "DJI Phantom 4 Pro"),
    "FC6310R": (24.0, "DJI Phantom 4 RTK"),
    "FC6310S": (24.0, "DJI Phantom 4 Pro V2.0"),
    "FC7203": (24.0, "DJI Mavic Mini"),
    "FC7303": (24.0, "DJI Mini 2"),
    "FC8482": (24.0, "DJI Mini 4 Pro"),
    "L1D-20c": (28.0, "DJI Mavic 2 Pro"),
    "L2D-20c": (24.0, "DJI Mavic 3"),
    "Anafi": (26.0, "Parrot Anafi"),
}
"""Model as files name it -> focal length on 35 mm film, and its name. Zooms are left out."""
_FISHEYE_MODES, _LINEAR_MODE = "WMN", "L"
"""GoPro's modes of view: parts of the lens's own picture, and a picture without distortion. Others (S, H) are
stretched unevenly."""


@dataclass(frozen=True)
class ModelLens:
    """A lens that follows from the model and the mode of a camera."""

    focal_px: float
    distortion: tuple[float, ...]
    """OpenCV's k1, k2, p1, p2[, k3]."""
    remark: str
    """Origin of the lens, for the warnings."""


def lens_of_model(user_data: bytes, size_px: tuple[int, int]) -> ModelLens | None:
    """Return the lens by the user data (``udta``) of a video's header; None where the model is unknown."""
    try:
        contents = list(boxes(user_data))
    except (ValueError, struct.error):
        return None
    by_camera = next((body for kind, body in contents if kind == b"GPMF"), None)
    if by_camera is not None:
        return _of_gopro(by_camera, size_px)
    text = b" ".join(body for kind, body in contents if kind in _MODEL_BOXES).decode("latin-1")
    if (found := film_focal(text)) is None:
        return None
    film_mm, name = found
    return ModelLens(
        focal_px=film_mm / FILM_WIDTH_MM * size_px[0],
        distortion=(0.0,) * 4,
        remark=f"from {film_mm:g} mm on 35 mm film by the specification of the {name}; no distortion assumed",
    )


def film_focal(text: str) -> tuple[float, str] | None:
    """Return the focal length on 35 mm film of the model that a text names, and its name; None for others.

    The name of one model may begin that of another: FC2204 and FC350Z are zooms.
    """
    found = (of for model, of in _FILM_MM.items() if re.search(rf"{model}(?![0-9A-Z])", text, re.IGNORECASE))
    return next(found, None)


def _of_gopro(metadata: bytes, size_px: tuple[int, int]) -> ModelLens | None:
    """Return the lens by the diagonal view, of a mode that is not stretched; the fisheye is equidistant."""
    stated: dict[str, bytes] = {}
    try:
        for key, _, _, device in blocks(metadata):
            if key == "DEVC":
                stated |= {inner: body for inner, _, _, body in blocks(device)}
    except ValueError:
        return None
    if len(stated.get("ZFOV", b"")) != 4 or not stated.get("VFOV"):
        return None
    view_deg, mode = struct.unpack(">f", stated["ZFOV"])[0], stated["VFOV"].decode("latin-1")[0]
    radius_px = 0.5 * math.hypot(*size_px)
    half = math.radians(view_deg) / 2
    if not 0.1 < half < math.pi / 2 or mode not in (*_FISHEYE_MODES, _LINEAR_MODE):
        return None
    name = stated.get("MINF", b"").decode("latin-1").strip("\0 ") or "GoPro"
    by = f"by the {view_deg:.0f} degrees of view of the {name}'s own record (mode {mode})"
    if mode == _LINEAR_MODE:
        return ModelLens(radius_px / math.tan(half), (0.0,) * 4, by)
    angle = viewing_angles()
    found = fitted_radial(angle, np.asarray(angle), half)
    if found is None:
        return None
    return ModelLens(radius_px / half * found.ratio, found.distortion, f"{by}, an equidistant lens assumed")
