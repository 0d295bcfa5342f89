"""Registration of two pictures in one call: features, matches, robust homography and gates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.registration import Registration, register

Image = NDArray[np.uint8]


def register_pictures(
    first: Image,
    second: Image,
    camera: Camera,
    features: FeatureConfig = FeatureConfig(),
    homography: HomographyConfig = HomographyConfig(),
    gates: GateConfig = GateConfig(),
) -> Registration:
    """Register the second picture to the first. ``i_H_j`` maps its pixels to those of the first.

    Both pictures are (h, w) grey or (h, w, 3) BGR uint8 of ``camera``. Limits in pixels scale with the width
    of the pictures. Raises ``TypeError`` or ``ValueError`` if an array is not a picture of the camera.
    """
    width, height = camera.size_px
    for name, picture in (("first", first), ("second", second)):
        if np.shape(picture)[:2] not in ((), (height, width)):
            raise ValueError(
                f"{name}: expected a picture of {height} rows and {width} columns as in camera.size_px, "
                f"got an array of shape {np.shape(picture)}"
            )
    extractor = Extractor(features.for_width(width))
    features_first, features_second = extractor(first, camera), extractor(second, camera)
    return register(0, 1, features_first, features_second, camera, homography.for_width(width), gates)
