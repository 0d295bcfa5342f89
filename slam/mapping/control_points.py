"""Control points of one part of the map: which are used, which are wrong, and what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.locate import LocatedPoint, locate
from backend.bundle.refinement import Bundle
from backend.measurements import ControlPoint
from backend.quantiles import chi_square_limit
from backend.triple import triple
from frontend.camera import Camera
from slam.core.control_points import ControlReport, PointResidual, SurveyedPoint
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic
from slam.mapping.gps.consensus import FALSE_ALARM, rough_agreement
from slam.mapping.gps.fixes import Fixes

Array = NDArray[np.float64]

LEAST_POINTS = 3
"""Two points leave a turn about the line through them open, and cannot contradict each other."""
LEAST_VIEWS = 2
"""Two rays that meet give a place."""
VIEW_STD_PX = 1.0
"""Standard deviation of pixels that a person has marked."""


@dataclass(frozen=True)
class Surveyed:
    """A surveyed point in the world of the map."""

    survey: SurveyedPoint
    point: ControlPoint
    """Its coordinates in the world, and its views in keyframes."""

    @property
    def may_be_used(self) -> bool:
        """Whether the map may follow it."""
        return self.survey.role == "control" and self.can_be_compared

    @property
    def can_be_compared(self) -> bool:
        """Whether pictures give its place, and its coordinates have no fault."""
        return len(self.point.keyframe) >= LEAST_VIEWS and not self.survey.fault


def surveyed_in_world(
    flight: Flight, origin: GeoOrigin | None, frame_index: NDArray[np.int64]
) -> tuple[Surveyed, ...]:
    """Return the flight's surveyed points, with the views in keyframes of the frames ``frame_index`` (n,)."""
    if not flight.surveyed or origin is None or flight.frames is None:
        return ()
    keyframe = {flight.frames.names[frame]: k for k, frame in enumerate(frame_index.tolist())}
    return tuple(Surveyed(survey, _in_world(survey, origin, keyframe)) for survey in flight.surveyed)


def _in_world(survey: SurveyedPoint, origin: GeoOrigin, keyframe: Mapping[str, int]) -> ControlPoint:
    place = enu_from_geodetic(survey.latitude_deg, survey.longitude_deg, survey.altitude_m, origin)[0]
    std_m = np.where(np.isfinite(place), survey.std_m, np.inf)
    views = [(keyframe[v.picture], v.u_px, v.v_px) for v in survey.views if v.picture in keyframe]
    table = np.array(views, dtype=float).reshape(-1, 3)
    seen_by = table[:, 0].astype(np.int64)
    return ControlPoint(survey.name, np.nan_to_num(place), std_m, seen_by, table[:, 1:], VIEW_STD_PX)


@dataclass(frozen=True)
class ControlComparison:
    """The surveyed points that one part of the map shows, its keyframes numbered from 0."""

    points: tuple[Surveyed, ...]
    misread: str = ""
    """Why no pixel is trusted; empty if they are (`slam.mapping.control_pixels`)."""

    @staticmethod
    def of(points: Sequence[Surveyed], members: NDArray[np.int64]) -> ControlComparison:
        """Return the comparison for the keyframes ``members`` (m,)."""
        number = {k: place for place, k in enumerate(members.tolist())}
        return ControlComparison(tuple(replace(s, point=s.point.of_keyframes(number)) for s in points))

    @property
    def candidates(self) -> NDArray[np.bool_]:
        """(p,) which points the first refinement uses: all that may be, if they are enough."""
        usable = np.array([s.may_be_used for s in self.points], dtype=bool)
        return np.asarray(usable & (usable.sum() >= LEAST_POINTS) & (not self.misread))

    def rough(self, camera: Camera, w_T_b: Array, metric: bool) -> NDArray[np.bool_]:
        """Return the candidates (p,) without those far off the others on level, unplaced poses (m, 4, 4)."""
        good = self.candidates
        here, there = self.on_floor(camera, w_T_b, 0.0)
        if len(here) == good.sum():
            good[good] = rough_agreement(here, there, metric).used
        return np.asarray(good & (good.sum() >= LEAST_POINTS))

    def on_floor(self, camera: Camera, w_T_b: Array, floor_z_m: float) -> tuple[Array, Array]:
        """Return where the candidates' pictures show them on the floor, and their surveys, each (q, 3).

        ``w_T_b`` (m, 4, 4) are level poses over the floor at ``floor_z_m``. Points without a height, and
        those above the horizon of a picture, are left out.
        """
        chosen = [s.point for s, use in zip(self.points, self.candidates, strict=True) if use]
        here = np.array([_on_floor(p, camera, w_T_b, floor_z_m) for p in chosen]).reshape(-1, 3)
        there = np.array([p.w_p_m for p in chosen]).reshape(-1, 3)
        known = np.array([np.isfinite(p.std_m).all() for p in chosen], dtype=bool)
        known &= np.isfinite(here).all(axis=1)
        return here[known], there[known]

    def off_floor(self, camera: Camera, w_T_b: Array, floor_z_m: float) -> Array:
        """Return the surveys minus the places on the floor (q, 3), as `on_floor` defines both."""
        here, there = self.on_floor(camera, w_T_b, floor_z_m)
        return there - here

    def judge(self, bundle: Bundle, used: NDArray[np.bool_]) -> ControlVerdict:
        """Compare the points with a refined map that follows those in ``used`` (p,)."""
        placed = bundle.optimum.problem.measurements.placed
        seen = [k for k, s in enumerate(self.points) if s.can_be_compared and placed]
        found = locate(bundle.optimum, [self.points[k].point for k in seen])
        located = dict(zip(seen, found, strict=True))
        # What the residuals ask for beyond the stated deviations is no error of a single point.
        scale = bundle.noise.control
        sigmas = np.full(len(self.points), np.nan)
        for k, place in located.items():
            sigmas[k] = _sigmas(self.points[k].point, place, scale)
        usable = np.array([s.may_be_used for s in self.points], dtype=bool)
        limit = np.sqrt(chi_square_limit(FALSE_ALARM / max(int(usable.sum()), 1), 3))
        # Where too few agreed, the coarser map without them must not call them back.
        agree = usable & (sigmas <= limit) & used.any() & (not self.misread)
        agree &= agree.sum() >= LEAST_POINTS
        return ControlVerdict(self.points, agree, located, scale, placed, self.misread)


def _on_floor(point: ControlPoint, camera: Camera, w_T_b: Array, floor_z_m: float) -> Array:
    places = [
        camera.floor_points(w_T_b[k], uv[None], floor_z_m)[0]
        for k, uv in zip(point.keyframe.tolist(), point.pixel, strict=True)
    ]
    return np.array([*np.median(places, axis=0)[:2], floor_z_m])


def _sigmas(point: ControlPoint, place: LocatedPoint, scale: float) -> float:
    """Return the whitened distance of a point's place on the map from its survey."""
    known = np.isfinite(point.std_m)
    off = (place.w_p_m - point.w_p_m)[known]
    covariance = np.nan_to_num(place.covariance)[np.ix_(known, known)]
    covariance = covariance + np.diag((scale * point.std_m[known]) ** 2)
    return float(np.sqrt(off @ np.linalg.solve(covariance, off)))


def _mean_residual(rows: Sequence[PointResidual]) -> tuple[Array, Array]:
    """Return the mean residual (3,) of points, NaN along an axis that none has, and its standard deviations.

    Most of a residual's deviation is that of the map's place, which all of them share: a mean of many is
    taken as no better known than one.
    """
    off_m = np.array([row.residual_m for row in rows], dtype=float)
    std_m = np.array([row.std_m for row in rows], dtype=float)
    known = np.isfinite(off_m)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    mean = np.sum(np.where(known, off_m, 0.0), axis=0) / count
    return mean, np.sqrt(np.sum(np.where(known, std_m, 0.0) ** 2, axis=0) / count)


@dataclass(frozen=True)
class ControlVerdict:
    """Verdict of a refined map on the surveyed points."""

    points: tuple[Surveyed, ...]
    used: NDArray[np.bool_]
    """(p,) which points agree, if enough do."""
    located: Mapping[int, LocatedPoint]
    """Number of each point that can be compared -> its place on the map."""
    scale: float
    """Factor on the stated deviations of the survey."""
    placed: bool
    """Whether the map is on Earth."""
    misread: str = ""

    def report(self, bundle: Bundle, used: NDArray[np.bool_], fixes: Fixes | None = None) -> ControlReport:
        """Return the residuals of all points of a map that follows those in ``used`` (p,).

        ``fixes``: the GPS fixes that it has.
        """
        rows = tuple(self._residual(k, bool(used[k])) for k in range(len(self.points)))
        systems = {
            point.survey.height_system for point, is_used in zip(self.points, used, strict=True) if is_used
        }
        report = ControlReport(
            points=rows,
            survey_scale=self.scale,
            misread=self.misread,
            height_system=systems.pop() if len(systems) == 1 else "",
        )
        measured = bundle.optimum.problem.measurements
        if not measured.positions:
            return report
        if used.any():
            compared = np.flatnonzero(used).tolist()
            offset_m, std_m = bundle.position_offset_m, bundle.position_offset_std_m
            offset_m, std_m = (np.where(measured.axes_of_both, x, np.nan) for x in (offset_m, std_m))
        else:
            compared = [k for k, row in enumerate(rows) if row in report.checks]
            if not compared:
                return report
            offset_m, std_m = _mean_residual([rows[k] for k in compared])
            datum_m = max(self.points[k].survey.datum_std_m for k in compared)
            std_m = np.hypot(std_m, [datum_m, datum_m, 0.0])
        altitudes = [self.points[k].survey.altitude_m for k in compared]
        known = [z for z in altitudes if np.isfinite(z)]
        return replace(
            report,
            gps_offset_m=triple(offset_m),
            gps_offset_std_m=triple(std_m),
            gps_std_m=None if fixes is None else fixes.std_m,
            gps_is_stated=fixes is not None and fixes.stated,
            altitude_m=float(np.mean(known)) if known else None,
        )

    def _residual(self, k: int, used: bool) -> PointResidual:
        survey, point, place = self.points[k].survey, self.points[k].point, self.located.get(k)
        row = PointResidual(
            name=survey.name, role=survey.role, used=used, reason=survey.fault, views=len(point.keyframe)
        )
        if survey.fault:
            return row
        if self.placed:
            here_m = np.where(np.isfinite(point.std_m), point.w_p_m, np.nan)
            row = replace(row, surveyed_m=triple(here_m))
        if place is None:
            reason = f"pictures on the map that show it: {row.views}, and {LEAST_VIEWS} are needed"
            return replace(row, reason=reason if self.placed else "the map is not placed on Earth")
        off = np.where(np.isfinite(point.std_m), place.w_p_m - point.w_p_m, np.nan)
        std = np.sqrt(np.diag(place.covariance) + (self.scale * point.std_m) ** 2)
        pixels = float(np.sqrt(np.mean(np.sum(place.residual_px**2, axis=1))))
        row = replace(row, residual_m=triple(off), std_m=triple(std), residual_px=pixels)
        if used or survey.role == "check":
            return row
        if (usable := sum(s.may_be_used for s in self.points)) < LEAST_POINTS:
            return replace(row, reason=f"{usable} can be used, and {LEAST_POINTS} are needed")
        return replace(row, reason=f"{row.distance_m:.3g} m from where the pictures show it")
