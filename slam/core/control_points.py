"""Ground control: surveyed points that pictures show, and what a map makes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from slam.core.geodesy import GeoOrigin

Role = Literal["control", "check"]
STD_M = 0.02
"""Standard deviation of a survey that states none: that of RTK receivers for a single measurement."""


class PictureView(NamedTuple):
    """Pixel at which a picture shows a point."""

    picture: str
    u_px: float
    v_px: float


@dataclass(frozen=True)
class SurveyedPoint:
    """A point of the ground with coordinates on Earth (WGS 84), and the pictures that show it."""

    name: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """NaN where only the horizontal place is known."""
    views: tuple[PictureView, ...]
    std_m: float = STD_M
    """Standard deviation along each axis."""
    datum_std_m: float = 0.0
    """Standard deviation east and north of what all points of a list share: the error of the transformation
    from their datum to WGS 84."""
    height_system: str = ""
    """The level of altitudes, as `slam.core.height_systems` names it; empty if nobody states it."""
    role: Role = "control"
    """A check point is held out: the map is compared with it."""
    fault: str = ""
    """Why its coordinates cannot be used; empty if they can."""
    is_named: bool = True
    """Whether the survey names it; else its name is a number within one list."""

    @property
    def origin(self) -> GeoOrigin:
        """The point as the origin of a world; an unknown altitude is 0."""
        known = math.isfinite(self.altitude_m)
        altitude_m, system = (self.altitude_m, self.height_system) if known else (0.0, "")
        return GeoOrigin(self.latitude_deg, self.longitude_deg, altitude_m, known, system)


@dataclass(frozen=True, kw_only=True)
class PointResidual:
    """A surveyed point and its place on the map."""

    name: str
    role: Role
    used: bool
    """Whether the map follows it."""
    reason: str
    """Why it is not used; empty if it is, and for a check point that was compared."""
    views: int
    """Number of pictures on the map that show it."""
    surveyed_m: tuple[float, float, float] | None = None
    """East, north, up: its surveyed coordinates in the world of the map; up is NaN without an altitude. None
    where the coordinates cannot be used, or the map is not on Earth."""
    residual_m: tuple[float, float, float] | None = None
    """East, north, up: its place by the pictures minus its surveyed coordinates; up is NaN without an
    altitude. None where fewer than two pictures show it, or its coordinates cannot be used."""
    std_m: tuple[float, float, float] | None = None
    """Standard deviations of the residual by map, pictures and survey."""
    residual_px: float | None = None
    """Root mean square distance in its pictures between its place there and the pixels given."""

    @property
    def distance_m(self) -> float:
        """Length of the residual; NaN where there is none."""
        known = [x for x in self.residual_m or () if math.isfinite(x)]
        return math.hypot(*known) if known else math.nan


@dataclass(frozen=True, kw_only=True)
class ControlReport:
    """Surveyed points on a finished map."""

    points: tuple[PointResidual, ...]
    gps_offset_m: tuple[float, float, float] | None = None
    """East, north, up: by how much GPS positions lie off the control points' datum, or off the check points
    where no control point is used; None without either, NaN along an axis that one of both lacks."""
    gps_offset_std_m: tuple[float, float, float] | None = None
    gps_std_m: tuple[float, float, float] | None = None
    """Standard deviations of one fix."""
    gps_is_stated: bool = False
    """Whether the receiver states them; else they are assumed."""
    altitude_m: float | None = None
    """Mean altitude of the points that `gps_offset_m` is about, as surveyed; None without any."""
    survey_scale: float = 1.0
    """Factor on the stated deviations of the survey, where its residuals ask for more."""
    misread: str = ""
    """Why no pixel of the points is trusted; empty if they are."""
    height_system: str = ""
    """The level of the altitudes of the points that are used; empty if nobody states one for all."""

    @property
    def has_heights(self) -> bool:
        """Whether a point that the map follows has an altitude."""
        return any(p.used and math.isfinite((p.surveyed_m or (math.nan,))[-1]) for p in self.points)

    @property
    def is_followed(self) -> bool:
        """Whether control points place the map."""
        return any(point.used for point in self.points)

    @property
    def checks(self) -> tuple[PointResidual, ...]:
        """The check points that are compared with the map."""
        return tuple(p for p in self.of_role("check") if p.residual_m is not None and p.std_m is not None)

    def of_role(self, role: Role) -> tuple[PointResidual, ...]:
        """Return the points of a role."""
        return tuple(point for point in self.points if point.role == role)
