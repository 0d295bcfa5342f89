"""Maps of one simulated flight with and without each of its instruments (`tests.benchmarks.instruments`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.measurements.nominal_errors import ACCEL_GAIN_RATIO, ACCEL_OFFSET_M_S2
from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation import Evaluation, evaluate
from slam.inertial.navigate import navigate
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import Observations
from slam.mapping.pipeline import optimize_with_observations
from tests.benchmarks.inertial_bound import navigation_bound_m, scale_bound, smoothing_bound_m

ALL, NO_IMU, NO_SONAR = "camera, IMU and sonar", "camera and sonar", "camera and IMU"
CAMERA, NO_CAMERA = "camera", "IMU and sonar"
PARTS: dict[str, Callable[[Flight], Flight]] = {
    ALL: lambda flight: flight,
    NO_IMU: lambda flight: replace(flight, imu=None),
    NO_SONAR: lambda flight: replace(flight, sonar=None),
    CAMERA: lambda flight: replace(flight, imu=None, sonar=None),
    NO_CAMERA: lambda flight: replace(flight, camera=None, frames=None),
}
"""Instruments of a map -> the streams of them; all have the attitude that the vehicle reports."""
PAIRS = (NO_IMU, NO_SONAR, NO_CAMERA)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mapped:
    """Result of one flight with some of its instruments. NaN: there is no such figure."""

    status: str
    warnings: tuple[str, ...] = ()
    metric: bool = True
    """Whether the map is in metres; otherwise its errors are those after a similarity."""
    placed: float = 0.0
    """Share of the keyframes in the main map."""
    path_m: float = np.nan
    """Length of the true path over the keyframes of the main map."""
    error_m: float = np.nan
    """RMS error of the positions (``ate_m``)."""
    mean_error_m: float = np.nan
    """Mean error of the positions."""
    shape_error_m: float = np.nan
    """RMS error of the positions after a similarity, which leaves no error of the scale."""
    landmark_percent: float = np.nan
    """RMS error of the distances between landmarks."""
    log_scale: float = np.nan
    """Logarithm of the ratio of the true lengths to the map's."""
    scale_std: float = np.nan
    """Reported standard deviation of the scale."""
    farthest: float = np.nan
    """NEES of the keyframe farthest from the first one."""
    nees: float = np.nan
    """Mean NEES over the keyframes."""
    in_band: bool = False
    """Whether the mean NEES is in its 95 % band."""

    @property
    def whole(self) -> bool:
        """Whether all keyframes are in one map with metres."""
        return self.metric and self.placed == 1.0


@dataclass(frozen=True)
class Gap:
    """The gap of one flight, and the map's position behind it."""

    seconds: float
    """Time between the last picture before the gap that is registered and the first one after it."""
    error_m: float
    """Horizontal error of the first keyframe behind the gap."""
    std_m: float
    """Reported standard deviation of that error."""
    nees: float
    """Its NEES, two degrees of freedom."""
    navigation_m: float
    """Error of navigation by the IMU alone over the gap."""
    smoothing_m: float
    """Least error of any estimate from IMU and pictures."""


@dataclass(frozen=True)
class Flown:
    """Results of one flight."""

    kind: str
    seed: int
    maps: dict[str, Mapped]
    gap: Gap | None = None
    least_mean_error: float = np.nan
    """Least mean error of the positions of any estimate, as a share of the path. Pictures show its shape
    exactly, so it is the least deviation of the scale times the mean distance from the first position."""


def least_mean_error(flight: Flight) -> float:
    """Return the least mean error of the positions of a flight with IMU and sonar, as a share of its path."""
    truth = flight.truth
    assert truth is not None
    position_m = truth.w_T_b[:, :3, 3]
    path_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum()
    away_m = np.linalg.norm(position_m - position_m[0], axis=1).mean()
    scale_std = scale_bound(flight, ACCEL_GAIN_RATIO, ACCEL_OFFSET_M_S2)
    return float(scale_std * away_m / path_m)


def maps_of(
    flight: Flight, kind: str, seed: int, gap_s: float = 0.0, sets: Sequence[str] = tuple(PARTS)
) -> Flown:
    """Map a flight with some sets of its instruments."""
    maps, gap = {}, None
    for name in sets:
        if flight.sonar is None and "sonar" in name:
            continue
        maps[name], found = _mapped(PARTS[name](flight), flight)
        if found is not None and gap_s > 0 and name == (ALL if flight.sonar is not None else NO_SONAR):
            gap = _gap(flight, *found)
    least = np.nan if flight.sonar is None else least_mean_error(flight)
    return Flown(kind, seed, maps, gap, least)


_Found = tuple[Estimate, Evaluation, Observations]


def _mapped(given: Flight, flight: Flight) -> tuple[Mapped, _Found | None]:
    """Map some streams of a flight; a flight that cannot be mapped has the reason as its status."""
    try:
        if given.camera is None:
            estimate, observations = navigate(given).estimate, None
        else:
            estimate, observations = optimize_with_observations(given, PipelineConfig())
    except InputError as refused:
        return Mapped(f"no map: {refused}"), None
    found = evaluate(estimate, flight)
    result = judged_map(estimate, found)
    return result, None if observations is None else (estimate, found, observations)


def judged_map(estimate: Estimate, found: Evaluation) -> Mapped:
    """Return the figures of a map and its evaluation."""
    tracks = found.tracks
    apart_m = np.linalg.norm(tracks.loops_m - tracks.reference_m, axis=1)
    away_m = np.linalg.norm(tracks.reference_m - tracks.reference_m[0], axis=1)
    percent = [row.error_percent.loops for row in found.landmarks]
    nees = found.nees
    known = np.nan_to_num(tracks.nees, nan=-1.0)[np.argmax(away_m)]
    return Mapped(
        status=estimate.status,
        warnings=estimate.warnings,
        metric=estimate.metric,
        placed=float((estimate.component == 0).mean()),
        path_m=float(np.linalg.norm(np.diff(tracks.reference_m, axis=0), axis=1).sum()),
        error_m=found.ate_m.rmse if estimate.metric else found.ate_sim3_m.rmse,
        mean_error_m=float(apart_m.mean()),
        shape_error_m=found.ate_sim3_m.rmse,
        landmark_percent=float(np.sqrt(np.nanmean(np.square(percent)))) if _any(percent) else np.nan,
        log_scale=float(np.log(found.scale)),
        scale_std=np.nan if estimate.scale_std is None else estimate.scale_std,
        farthest=float(known) if known >= 0 else np.nan,
        nees=np.nan if nees is None else nees.pose.mean,
        in_band=nees is not None and nees.pose.consistent,
    )


def _any(values: list[float]) -> bool:
    return bool(np.isfinite(values).any())


def _gap(flight: Flight, estimate: Estimate, found: Evaluation, observations: Observations) -> Gap | None:
    """Return the widest gap between registered pictures; None where the map does not cross it."""
    assert flight.imu is not None
    passed = [p.frame for p in observations.passed]
    seen = np.unique(np.concatenate([observations.frame_index, np.array(passed, dtype=np.int64)]))
    stamps_s = observations.frame_stamps_s[seen]
    widest = int(np.argmax(np.diff(stamps_s)))
    gap_s = float(stamps_s[widest + 1] - stamps_s[widest])
    behind = np.flatnonzero((estimate.stamps_s >= stamps_s[widest + 1] - 1e-6) & (estimate.component == 0))
    compared = np.isin(estimate.stamps_s - estimate.stamps_s[0], found.tracks.stamps_s)
    if len(behind) == 0 or estimate.component[0] != 0 or not compared[behind[0]]:
        return None
    k = int(behind[0])
    row = int(np.searchsorted(found.tracks.stamps_s, estimate.stamps_s[k] - estimate.stamps_s[0] - 1e-9))
    error_m = (found.tracks.loops_m - found.tracks.reference_m)[row, :2]
    w_R_b = estimate.w_T_b[k, :3, :3]
    P = (w_R_b @ estimate.covariances[k, 3:, 3:] @ w_R_b.T)[:2, :2]
    noise = flight.imu.gyro_noise_density, flight.imu.accel_noise_density
    return Gap(
        seconds=gap_s,
        error_m=float(np.linalg.norm(error_m)),
        std_m=float(np.sqrt(np.trace(P))),
        nees=float(error_m @ np.linalg.solve(P, error_m)),
        navigation_m=navigation_bound_m(gap_s, *noise),
        smoothing_m=smoothing_bound_m(gap_s, *noise),
    )
