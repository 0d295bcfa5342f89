"""Velocities of the vehicle at the photographs, by DJI's tags where the positions do not contradict these."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.measurements.straight_flight import straight_velocities
from slam.core.geodesy import GeoOrigin, enu_from_geodetic
from slam.core.messages import Message, note
from slam.core.streams import Gps
from slam.io.photos.photo_set import Photo

Array = NDArray[np.float64]

_LARGEST_DIFFERENCE = 0.5
"""Median difference from the change of the positions over the median speed, from which on the tags are wrong.
Stamps of whole seconds, two seconds apart, make it 0.2. The tags of a DJI FC6360, of which ``FlightXSpeed``
is always 0, have 1.4."""


def photo_velocities(
    photos: Sequence[Photo], gps: Gps | None, stamps_s: Array
) -> tuple[Array | None, tuple[Message, ...]]:
    """Return velocities (n, 3) east, north and up of photographs at ``stamps_s`` (n,), NaN where a tag lacks,
    and remarks; None where no tag is usable. Where positions tell nothing, the tags are not used either.
    """
    told = [photo.tags.speed_ned_m_s for photo in photos]
    if gps is None or not any(told):
        return None, ()
    none = (np.nan,) * 3
    velocity = np.array([none if v is None else (v[1], v[0], -v[2]) for v in told])
    known = np.isin(stamps_s, gps.stamps_s)
    origin = GeoOrigin(gps.latitude_deg[0], gps.longitude_deg[0], 0.0)
    level = np.zeros(len(gps.stamps_s))
    place = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, level, origin)
    flown = straight_velocities(gps.stamps_s, place)[:, :2]
    apart = np.linalg.norm(velocity[known, :2] - flown, axis=1)
    compared = np.isfinite(apart)
    if not compared.any():
        return None, ()
    typical = float(np.median(np.linalg.norm(flown[compared], axis=1)))
    off = float(np.median(apart[compared]))
    if off <= _LARGEST_DIFFERENCE * typical:
        return velocity, ()
    line = (
        f"FlightXSpeed and FlightYSpeed contradict the positions by {off:.2g} m/s at {typical:.2g} m/s: the "
        "velocity comes from the positions"
    )
    return None, (note(line),)
