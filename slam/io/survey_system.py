"""The coordinate system of a list of surveyed points, as its first line names it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.height_systems import UNKNOWN
from slam.core.messages import Message, note, warning
from slam.io.datum_accuracy import datum_accuracy_m
from slam.io.files import brief, refusal

if TYPE_CHECKING:
    from rasterio.crs import CRS

Array = NDArray[np.float64]

NAME_IT = "write EPSG:32632 there, WGS84 UTM 32N, or a PROJ string"
_UTM = re.compile(r"(?:WGS\s?84)?\s*/?\s*UTM\s+(?:zone\s+)?(\d{1,2})\s*([NS])", re.IGNORECASE)
_CODES = re.compile(r"(?:EPSG\s*:?\s*)?(\d{4,6})(?:\s*\+\s*(?:EPSG\s*:\s*)?(\d{4,6}))?", re.IGNORECASE)
"""One EPSG code, or one of the plane and one of the heights."""
_WKT = re.compile(r"(PROJ|GEOG|GEOD|COMPOUND|COMPD_)(CS|CRS)\[", re.IGNORECASE)
_HEIGHT_UNIT = re.compile(r'VERT_CS\[.*?UNIT\["[^"]*",([-+.\deE]+)', re.DOTALL)

_SAME_UNIT = 1e-9
"""Largest relative difference by rounding: the two feet in use differ by 2e-6."""


@dataclass(frozen=True)
class SurveySystem:
    """Coordinates of surveyed points."""

    path: Path
    line: int
    header: str
    """Text that names it."""
    crs: CRS

    @staticmethod
    def named(path: Path, line: int, header: str) -> SurveySystem:
        """Return the system of a first line: EPSG codes, a zone of UTM, a PROJ string or WKT.

        Raises ``InputError`` for another name, and for a system that holds no places on Earth.
        """
        from rasterio.errors import CRSError

        what = f"names {brief(header, 60)!r}, no coordinate system that is known"
        try:
            crs = _crs(header)
        except CRSError:
            crs = None
        if crs is not None and not (crs.is_projected or crs.is_geographic):
            what = f"names {brief(header, 60)!r}, a system of heights, of space or of one site"
            crs = None
        if crs is not None and counts_depths(crs.to_dict(projjson=True)):
            what = f"names {brief(header, 60)!r}, whose heights are depths, positive downwards"
            crs = None
        if crs is None:
            raise refusal(path, what, NAME_IT, line)
        return SurveySystem(path, line, header, crs)

    @property
    def axes(self) -> tuple[str, str]:
        """Return the names of x and y."""
        return ("longitude", "latitude") if self.crs.is_geographic else ("easting", "northing")

    @property
    def height_unit_m(self) -> float:
        """Return the unit of heights, metres where the system has none."""
        return height_unit_m(self.crs)

    @property
    def height_system(self) -> str:
        """Return the code of its system of heights (`slam.core.height_systems`); empty if it names none."""
        system = self.crs.to_dict(projjson=True)
        for part in system.get("components", [system])[::-1]:
            code = part.get("id", {})
            if part.get("type") == "VerticalCRS" and code.get("authority") == "EPSG":
                return f"EPSG:{code['code']}"
        base = _base(system)
        is_named = has_three_axes(system) and base.get("authority") == "EPSG"
        return f"EPSG:{base['code']}" if is_named else UNKNOWN

    @property
    def unit_note(self) -> Message | None:
        """Return that heights are taken in metres where x and y are in another unit; None elsewhere."""
        if not self.crs.is_projected or _HEIGHT_UNIT.search(self.crs.to_wkt()):
            return None
        name, unit_m = self.crs.linear_units_factor
        if abs(unit_m - 1) < _SAME_UNIT:
            return None
        return warning(
            f"{brief(self.path.name, 80)}, line {self.line}: x and y are in another unit ({name}), and "
            "heights are taken in metres, because no system of heights is named",
            "name one with its unit after a plus sign, such as EPSG:2232+6360 for US survey feet, or "
            "EPSG:2232+5703 for metres",
        )

    def datum_std_m(self, longitude_deg: float, latitude_deg: float) -> float:
        """Return the accuracy of the transformation of the datum to WGS 84 at a place; NaN if not known."""
        return datum_accuracy_m(self.crs, longitude_deg, latitude_deg)

    def datum_note(self, std_m: float) -> Message | None:
        """Return a line about the accuracy of `datum_std_m`; None for 0."""
        if std_m == 0:
            return None
        good = "of unknown accuracy" if np.isnan(std_m) else f"good to {std_m:g} m"
        line = (
            f"{brief(self.path.name, 80)}, line {self.line}: coordinates are brought from the datum of "
            f"{brief(self.header, 60)!r} to WGS 84 by a transformation {good}: the map's place on Earth is "
            "no better, its coordinates in that system are"
        )
        unknown = warning(line, "compare it with a point known in WGS 84")
        return unknown if np.isnan(std_m) else note(line)

    def geodetic(self, xy: Array) -> Array:
        """Return longitude and latitude (n, 2) in degrees of x, y (n, 2); NaN for what the system lacks.

        Raises ``InputError`` where nothing leads to WGS 84.
        """
        from rasterio._err import CPLE_BaseError
        from rasterio.errors import RasterioError
        from rasterio.warp import transform

        try:
            degrees = np.array(transform(self.crs, "EPSG:4326", *xy.T.tolist())).T
        except (RasterioError, CPLE_BaseError) as error:
            raise self._no_way(error) from None
        degrees[~np.isfinite(degrees).all(axis=1)] = np.nan
        return degrees

    def _no_way(self, error: Exception) -> InputError:
        reason = brief(" ".join(str(error).split()), 120)
        what = f"names {brief(self.header, 60)!r}, which cannot be brought to WGS 84 ({reason})"
        return refusal(self.path, what, NAME_IT, self.line)


def _base(system: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return authority and code of the geographic system below one in PROJ's JSON; empty if not known."""
    plane = system["components"][0] if "components" in system else system
    return dict(plane.get("base_crs", plane).get("id", {}))


def has_three_axes(system: Mapping[str, Any]) -> bool:
    """Return whether a system, as PROJ describes it in JSON, has heights over its ellipsoid beside places."""
    return len(system.get("coordinate_system", {}).get("axis", ())) == 3


def counts_depths(system: Mapping[str, Any]) -> bool:
    """Return whether a system, as PROJ describes it in JSON, has depths, positive downwards, for heights."""
    axes = [
        axis
        for part in system.get("components", [system])
        for axis in part.get("coordinate_system", {}).get("axis", ())
    ]
    return any(axis["direction"] == "down" for axis in axes)


def height_unit_m(crs: CRS) -> float:
    """Return the unit of the heights of a system, metres where it has none."""
    found = _HEIGHT_UNIT.search(crs.to_wkt())
    return float(found[1]) if found else 1.0


def _crs(header: str) -> CRS | None:
    """Return the system; None for a kind of name that is not known. Raises ``CRSError`` for a wrong name."""
    from rasterio.crs import CRS

    utm = _UTM.fullmatch(header)
    if utm and 1 <= int(utm[1]) <= 60:
        return CRS.from_epsg((32600 if utm[2].upper() == "N" else 32700) + int(utm[1]))
    if codes := _CODES.fullmatch(header):
        return CRS.from_string("EPSG:" + "+".join(filter(None, codes.groups())))
    if header.startswith("+"):
        return CRS.from_string(header)
    return CRS.from_wkt(header) if _WKT.match(header) else None
