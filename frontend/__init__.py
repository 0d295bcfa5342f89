"""Front end: from pixels to relative poses with covariance, loops and mosaics."""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frontend.camera import Camera
    from frontend.features import Extractor, FeatureConfig, Features
    from frontend.gates import GateConfig
    from frontend.homography import HomographyConfig, HomographyFit, fit_homography, transfer
    from frontend.keyframes import KeyframeConfig, Tracker
    from frontend.mosaic.canvas import MosaicError
    from frontend.mosaic.plan import MosaicPlan, plan_mosaic
    from frontend.mosaic.render import render_tiles
    from frontend.opencv_features import FeatureUnavailableError
    from frontend.picture_pair import register_pictures
    from frontend.registration import Registration, register

logging.getLogger(__name__).addHandler(logging.NullHandler())

_MODULES = {
    "Camera": "frontend.camera",
    "Extractor": "frontend.features",
    "FeatureConfig": "frontend.features",
    "FeatureUnavailableError": "frontend.opencv_features",
    "Features": "frontend.features",
    "GateConfig": "frontend.gates",
    "HomographyConfig": "frontend.homography",
    "HomographyFit": "frontend.homography",
    "KeyframeConfig": "frontend.keyframes",
    "MosaicError": "frontend.mosaic.canvas",
    "MosaicPlan": "frontend.mosaic.plan",
    "Registration": "frontend.registration",
    "Tracker": "frontend.keyframes",
    "fit_homography": "frontend.homography",
    "plan_mosaic": "frontend.mosaic.plan",
    "register": "frontend.registration",
    "register_pictures": "frontend.picture_pair",
    "render_tiles": "frontend.mosaic.render",
    "transfer": "frontend.homography",
}
"""Public name -> the module that defines it."""

__all__ = [
    "Camera",
    "Extractor",
    "FeatureConfig",
    "FeatureUnavailableError",
    "Features",
    "GateConfig",
    "HomographyConfig",
    "HomographyFit",
    "KeyframeConfig",
    "MosaicError",
    "MosaicPlan",
    "Registration",
    "Tracker",
    "fit_homography",
    "plan_mosaic",
    "register",
    "register_pictures",
    "render_tiles",
    "transfer",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``import frontend`` loads nothing else."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'frontend' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
