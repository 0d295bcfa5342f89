"""The vertical datum of the altitudes of ``gps0``, as ``sensor.yaml`` states it."""

from __future__ import annotations

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
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        system = CRS.from_string(code).to_dict(projjson=True)
    except CRSError:
        return False
    kind = system["type"]
    if counts_depths(system):
        return False
    return kind == "VerticalCRS" or (kind == "GeographicCRS" and has_three_axes(system))
