"""The vertical datum of altitudes: that which ``gps0/sensor.yaml`` states; whether one is an ellipsoid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slam.core.height_systems import ELLIPSOID, SEA_LEVEL, UNKNOWN, height_system
from slam.io.files import brief
from slam.io.sensor_yaml import YamlFile
from slam.io.survey_system import counts_depths, has_three_axes


def stated_height_system(sensor: YamlFile) -> str:
    """Return the code under ``height_system``; empty without it. Raises ``InputError`` for no such system."""
    if not sensor.has("height_system"):
        return UNKNOWN
    written = sensor.text("height_system", "")
    system = height_system(written)
    if system is None or not _holds_heights(system):
        do = "write ellipsoid, sea level, or EPSG: and the number of a system of heights"
        raise sensor.refuse("height_system", f"is {brief(written, 40)!r}", do)
    return system


def _holds_heights(code: str) -> bool:
    """Return whether the registry has a system of heights, or of degrees and heights, of this code."""
    if code in (ELLIPSOID, SEA_LEVEL):
        return True
    system = _registered(code)
    if system is None or counts_depths(system):
        return False
    return system["type"] == "VerticalCRS" or _is_geographic_3d(system)


def is_ellipsoidal(code: str) -> bool:
    """Return whether the heights of a system count from an ellipsoid, and not from a model of sea level."""
    if code in (ELLIPSOID, SEA_LEVEL):
        return code == ELLIPSOID
    system = _registered(code)
    return system is not None and _is_geographic_3d(system)


def _registered(code: str) -> dict[str, Any] | None:
    """Return a system of the registry as PROJ describes it in JSON; None for an unknown code."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return dict(CRS.from_string(code).to_dict(projjson=True))
    except CRSError:
        return None


def _is_geographic_3d(system: Mapping[str, Any]) -> bool:
    return system["type"] == "GeographicCRS" and has_three_axes(system)
