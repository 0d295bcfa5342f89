"""GPS fixes of a flight in its local east-north-up world, and the positions they give to keyframes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Position
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M

Array = NDArray[np.float64]

LONGEST_STEP_S = 2.0
"""Two fixes, or two keyframes, farther apart are not joined by a line."""
_SAME_TIME_S = 1e-6


@dataclass(frozen=True)
class Fixes:
    """Fixes in order of time."""

    stamps_s: Array
    """(n,)."""
    w_p_antenna_m: Array
    """(n, 3) east, north, up of the origin; up is NaN without a usable altitude."""
    std_m: tuple[float, float, float]
    """Nominal standard deviations east, north, up."""
    stated: bool
    """Whether the receiver states these deviations; else they are assumed."""
    names: tuple[str, ...]
    """Photograph or time of each fix, for messages."""
    suspect: NDArray[np.bool_]
    """(n,) whether the fix is out of reach of the other fixes (`slam.core.fix_check`)."""
    antenna_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) place of the antenna on the body."""
    antenna_std_m: float = 0.0
    """Its standard deviation along each axis."""
    antenna_assumed: bool = False
    """Whether it is at the body's origin because no place is stated."""
    stds_m: Array | None = None
    """(n, 3) standard deviations of each fix where they differ; ``std_m`` is their median then."""
    repeats_place: NDArray[np.bool_] | None = None
    """(n,) whether latitude and longitude are those of the fix before, to the last digit; None where no fix
    repeats them."""

    @property
    def each_std_m(self) -> Array:
        """(n, 3) nominal standard deviations of each fix."""
        return np.tile(self.std_m, (len(self), 1)) if self.stds_m is None else self.stds_m

    @property
    def assumes_antenna_place(self) -> bool:
        """Whether the antenna is held at a place that nobody stated."""
        return self.antenna_std_m == 0 and self.antenna_assumed

    @property
    def antenna_up_std_m(self) -> float:
        """Standard deviation of its height on the body.

        Along x and y an antenna without a stated place is held unless the pictures refute it. Its height
        moves all cameras and the ground together, which no residual shows; where fixes are exact, it is most
        of their error.
        """
        if self.assumes_antenna_place and self.std_m[2] < NOMINAL_ANTENNA_STD_M:
            return NOMINAL_ANTENNA_STD_M
        return self.antenna_std_m

    def __len__(self) -> int:
        return len(self.stamps_s)

    def only(self, used: NDArray[np.bool_], altitude_used: NDArray[np.bool_]) -> Fixes:
        """Return the fixes of the mask ``used`` (n,), without the altitudes outside ``altitude_used``."""
        w_p_antenna_m = self.w_p_antenna_m.copy()
        w_p_antenna_m[~altitude_used, 2] = np.nan
        names = tuple(name for name, keep in zip(self.names, used, strict=True) if keep)
        return replace(
            self,
            stamps_s=self.stamps_s[used],
            w_p_antenna_m=w_p_antenna_m[used],
            names=names,
            suspect=self.suspect[used],
            stds_m=None if self.stds_m is None else self.stds_m[used],
            repeats_place=None if self.repeats_place is None else self.repeats_place[used],
        )

    def at(self, at_s: Array) -> tuple[Position, ...]:
        """Return the position of each keyframe at the times ``at_s`` (k,) that lies on or between fixes."""
        where = _between(self.stamps_s, at_s)
        values, stds_m = _interpolated(self.w_p_antenna_m, where), _interpolated(self.each_std_m, where)
        positions = []
        for k in np.flatnonzero(np.isfinite(values[:, :2]).all(axis=1)):
            flat = bool(np.isnan(values[k, 2]))
            std = np.array([*stds_m[k, :2], np.inf if flat else stds_m[k, 2]])
            positions.append(Position(int(k), np.nan_to_num(values[k]), std))
        return tuple(positions)

    def on_map(self, at_s: Array, w_T_b: Array) -> Array:
        """Return the antenna's position (n, 3) on the map at each fix, NaN where the map lacks its time.

        ``w_T_b`` (k, 4, 4) are the keyframes at the times ``at_s`` (k,), in increasing order. Beyond the ends
        of a stretch of keyframes the map is extrapolated as far as a fix gives positions to a keyframe.
        """
        antenna = w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ self.antenna_m
        here = _interpolated(antenna, _between(at_s, self.stamps_s))
        if len(at_s) < 2:
            return here
        near = nearest(at_s, self.stamps_s)
        away_s = self.stamps_s - at_s[near]
        beyond = np.isnan(here[:, 0]) & (np.abs(away_s) < LONGEST_STEP_S)
        velocity_m_s = _velocity(at_s, antenna)[near]
        here[beyond] = (antenna[near] + velocity_m_s * away_s[:, None])[beyond]
        return here


def fixes_of(flight: Flight, origin: GeoOrigin | None) -> Fixes | None:
    """Return the fixes of a flight; None if it has none."""
    gps, check = flight.gps, flight.fix_check()
    if gps is None or check is None or origin is None:
        return None
    known = np.isfinite(gps.latitude_deg) & np.isfinite(gps.longitude_deg)
    w_p_antenna_m = enu_from_geodetic(
        gps.latitude_deg[known], gps.longitude_deg[known], gps.altitude_m[known], origin
    )
    stamps_s = gps.stamps_s[known]
    order = np.argsort(stamps_s, kind="stable")
    stamps_s = stamps_s[order]
    # In metres an altitude that goes on moves a repeated place a little.
    place_deg = np.column_stack([gps.latitude_deg, gps.longitude_deg])[known][order]
    repeats = np.append(False, (np.diff(place_deg, axis=0) == 0).all(axis=1))[: len(place_deg)]
    return Fixes(
        stamps_s=stamps_s,
        w_p_antenna_m=w_p_antenna_m[order],
        std_m=gps.noise_std_m,
        stated=not gps.noise_assumed,
        names=flight.picture_names(stamps_s),
        suspect=~check.consistent[known][order],
        antenna_m=gps.b_T_s[:3, 3],
        antenna_std_m=gps.antenna_std_m,
        antenna_assumed=gps.antenna_assumed,
        stds_m=None if gps.stds_m is None else gps.stds_m[known][order],
        repeats_place=repeats if repeats.any() else None,
    )


def nearest(stamps_s: Array, at_s: Array) -> NDArray[np.int64]:
    """Return the row of sorted stamps (n,) that is nearest to each time (k,)."""
    after = np.clip(np.searchsorted(stamps_s, at_s), 1, len(stamps_s) - 1)
    return after - (at_s - stamps_s[after - 1] <= stamps_s[after] - at_s)


def _velocity(at_s: Array, p_m: Array) -> Array:
    """Return the velocity (k, 3) of each keyframe by its neighbours that are near in time; 0 without any."""
    step_s = np.diff(at_s)
    near = (step_s > 0) & (step_s < LONGEST_STEP_S)
    step = np.where(near[:, None], np.diff(p_m, axis=0), 0.0)
    length_s = np.where(near, step_s, 0.0)
    moved = np.vstack([step, np.zeros(3)]) + np.vstack([np.zeros(3), step])
    lasted_s = np.append(length_s, 0.0) + np.insert(length_s, 0, 0.0)
    return np.asarray(moved / np.where(lasted_s > 0, lasted_s, 1.0)[:, None])


def _between(stamps_s: Array, at_s: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the rows before and after each time (k,) in sorted stamps (n,), and the share of the latter.

    The share is NaN where no stamp, or none within `LONGEST_STEP_S` on both sides, is near.
    """
    n = len(stamps_s)
    share = np.full(len(at_s), np.nan)
    if n == 0:
        none = np.zeros(len(at_s), np.int64)
        return none, none, share
    after = np.clip(np.searchsorted(stamps_s, at_s), 0, n - 1)
    before = np.maximum(after - 1, 0)
    step_s = stamps_s[after] - stamps_s[before]
    inside = (step_s > 0) & (step_s < LONGEST_STEP_S)
    inside &= (at_s >= stamps_s[before]) & (at_s <= stamps_s[after])
    share[inside] = ((at_s - stamps_s[before]) / np.where(step_s > 0, step_s, 1.0))[inside]
    for end, value in ((before, 0.0), (after, 1.0)):
        share[np.abs(stamps_s[end] - at_s) < _SAME_TIME_S] = value
    return before, after, share


def _interpolated(values: Array, where: tuple[NDArray[np.int64], NDArray[np.int64], Array]) -> Array:
    """Return rows (k, d) of values (n, d) at the places of `_between`."""
    before, after, share = where
    if not len(values):
        return np.full((len(share), values.shape[1]), np.nan)
    rows = (1 - share[:, None]) * values[before] + share[:, None] * values[after]
    # At an exact match the other row does not matter, even if its value is missing.
    rows[share == 0.0] = values[before][share == 0.0]
    rows[share == 1.0] = values[after][share == 1.0]
    return rows
