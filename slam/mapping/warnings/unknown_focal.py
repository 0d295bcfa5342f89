"""A focal length that is not stated, and which the flight does not tell well either."""

from __future__ import annotations

from backend.bundle.lens import FOCAL
from slam.core.flight import Flight
from slam.core.lens_priors import NOMINAL_FOCAL_STD_RATIO, UNKNOWN_FOCAL_STD_RATIO
from slam.core.messages import Message, warning
from slam.core.units import percent
from slam.mapping.map import Map


def unknown_focal_warning(flight: Flight, map_: Map) -> Message | None:
    """Return a reason to doubt heights where the focal length is known worse than that of a common tag.

    An estimate from pictures of ground that is nearly flat is weak, and relief displaces it. The result is
    empty where a focal length is stated, if only by a tag.
    """
    camera = flight.camera
    if camera is None or camera.focal_std_ratio < UNKNOWN_FOCAL_STD_RATIO:
        return None
    lens = None if map_.bundle is None else map_.bundle.lens
    if lens is None:
        std = percent(camera.focal_std_ratio)
        found = f"these pictures do not either: it is assumed, and may be off by {std}"
    else:
        known = float((lens.std[FOCAL] / lens.calibration[FOCAL]).max())
        if known <= NOMINAL_FOCAL_STD_RATIO:
            return None
        found = f"these pictures tell it to {percent(known)} only"
    return warning(
        f"the focal length is not known, and {found}: heights over the ground are doubted, and lengths too "
        "where a height sensor gives them",
        "copy the originals with their tags, or write the calibrated focal length into cam0/sensor.yaml",
    )
