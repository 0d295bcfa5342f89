"""Figures of a report, computed once: the results of a flight and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.units import SPACE, length, percent
from slam.evaluation.trajectory import gauge

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Facts:
    """Figures of the report; lengths in metres, NaN where a figure is not known."""

    keyframes: int
    placed: int
    frames: int
    maps: int
    """Number of connected parts with more than one keyframe."""
    extent_m: tuple[float, float]
    """East-west and north-south size of the flown path of the largest part."""
    path_m: float
    """Length of the flown path of the largest part, keyframe to keyframe."""
    duration_s: float
    loops_kept: int
    loops_rejected: int
    sigma_median_m: float
    """Position of a keyframe: one standard deviation over the three axes together."""
    sigma_max_m: float
    scale_std: float
    """Relative uncertainty that all lengths share: the height sensor's unless GPS is more accurate; else
    0."""
    mostly_scale: bool
    """Whether that uncertainty causes more than half of the variance of a position."""
    relative_to: str
    """Origin that positions are known relative to; empty where they are absolute."""
    chain_moved_m: float
    """Largest distance of a keyframe from the plain chain's, with the first keyframes aligned."""
    scale_source: str
    sensor_gain: str
    """Gain and offset of the height sensor, in words; empty without one."""
    sensor_zero: str
    is_graph: bool
    metric: bool = True
    """Whether lengths are metres, as `slam.core.estimate.Estimate` defines it."""

    def length(self, metres: float) -> str:
        """Return a length of this map with its unit."""
        return length(metres, self.metric)


def gather(estimate: Estimate, flight: Flight | None) -> Facts:
    """Compute the figures; ``flight`` is None where the input was a graph."""
    known = is_placed(estimate)
    main = np.flatnonzero(known & (estimate.component == 0))
    position = estimate.w_T_b[main, :3, 3]
    sigma = position_sigma_m(estimate.covariances[known])
    # An unknown standard deviation has no upper limit: the median counts it as the largest.
    sigma = np.append(sigma, np.full(int(known.sum()) - len(sigma), np.inf))
    verdicts = [loop.verdict for loop in estimate.loops]
    sizes = (
        np.bincount(estimate.component[estimate.component >= 0]) if len(estimate.component) else np.zeros(0)
    )
    extent = np.ptp(position[:, :2], axis=0) if len(position) else np.full(2, np.nan)
    kinds = [edge.kind for edge in estimate.relative_poses]
    scale_std = _scale_std(estimate, flight)
    gain, zero = _height_sensor(estimate, flight)
    return Facts(
        keyframes=len(known),
        placed=int(known.sum()),
        frames=estimate.frames,
        maps=int((sizes > 1).sum()),
        extent_m=(float(extent[0]), float(extent[1])),
        path_m=float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum()),
        duration_s=float(np.ptp(estimate.stamps_s)) if flight is not None and len(known) else float("nan"),
        loops_kept=kinds.count("loop") if flight is None else verdicts.count("kept"),
        loops_rejected=verdicts.count("rejected"),
        sigma_median_m=_or_nan(np.median(sigma)) if len(sigma) else float("nan"),
        sigma_max_m=_or_nan(sigma.max()) if len(sigma) else float("nan"),
        scale_std=scale_std,
        mostly_scale=_is_mostly_scale(estimate, main, scale_std),
        relative_to=_relative_to(estimate, flight),
        chain_moved_m=_moved_m(estimate, main),
        scale_source=_scale_source(estimate, flight),
        sensor_gain=gain,
        sensor_zero=zero,
        is_graph=flight is None,
        metric=estimate.metric,
    )


def is_placed(estimate: Estimate) -> NDArray[np.bool_]:
    """(n,) whether a keyframe has a pose."""
    return np.asarray(np.isfinite(estimate.w_T_b.sum(axis=(1, 2))))


def position_sigma_m(covariances: Array) -> Array:
    """Standard deviation (m,) of a position over its three axes together, where known, from (n, 6, 6)."""
    variance = np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
    return np.asarray(np.sqrt(variance[np.isfinite(variance) & (variance >= 0)]))


def _or_nan(value: float) -> float:
    return float(value) if np.isfinite(value) else float("nan")


def sentence(facts: Facts) -> str:
    """Summarise the result and its accuracy in words for a pilot."""
    thing = "poses" if facts.is_graph else "keyframes"
    if facts.placed == 0:
        return f"Nothing could be placed: none of {facts.keyframes} {thing} has a position."
    whole = (
        f"All {facts.keyframes}"
        if facts.placed == facts.keyframes
        else f"{facts.placed} of {facts.keyframes}"
    )
    maps = (
        "one consistent map" if facts.maps <= 1 else f"{facts.maps} separate maps that share no common ground"
    )
    text = f"{whole} {thing} lie on {maps}"
    if np.isfinite(facts.sigma_median_m):
        median, worst = facts.length(facts.sigma_median_m), facts.length(facts.sigma_max_m)
        worst = f"±{SPACE}{worst} at worst" if np.isfinite(facts.sigma_max_m) else "others are not known"
        relative = f"relative to {facts.relative_to} " if facts.relative_to else ""
        text += f"; {relative}a position is known to ±{SPACE}{median} (median), {worst}"
        if facts.mostly_scale:
            text += f", mostly because the scale of all lengths is known to {percent(facts.scale_std)} only"
    text += "."
    if facts.loops_kept:
        closures = "loop closure holds" if facts.loops_kept == 1 else "loop closures hold"
        text += f" {facts.loops_kept} {closures} it together."
    else:
        text += " No place was recognised a second time with certainty, so errors add up along the path."
    if not facts.metric:
        text += (
            " No sensor determined the length of a metre, so lengths are relative: in heights, multiples of "
            "the camera's mean height over the floor."
        )
    return text


def chain_on_result(estimate: Estimate) -> Array:
    """Plain chain (n, 4, 4) with its first keyframe's position and heading on the result's."""
    known = np.flatnonzero(np.isfinite(estimate.chain_w_T_b.sum(axis=(1, 2))) & is_placed(estimate))
    if len(known) == 0:
        return np.full_like(estimate.chain_w_T_b, np.nan)
    first = known[0]
    return gauge(estimate.chain_w_T_b[first], estimate.w_T_b[first]) @ estimate.chain_w_T_b


def _moved_m(estimate: Estimate, main: NDArray[np.int64]) -> float:
    moved = np.linalg.norm((chain_on_result(estimate) - estimate.w_T_b)[main, :3, 3], axis=1)
    return float(np.nanmax(moved)) if np.isfinite(moved).any() else float("nan")


def _relative_to(estimate: Estimate, flight: Flight | None) -> str:
    if flight is None:
        return "the pose that is held"
    return "" if estimate.origin is not None else "the first keyframe"


def _scale_std(estimate: Estimate, flight: Flight | None) -> float:
    """Relative standard deviation of the common scale; positions on Earth determine it best."""
    if flight is None or estimate.scale_std is None or estimate.origin is not None:
        return 0.0
    return estimate.scale_std


def _is_mostly_scale(estimate: Estimate, members: NDArray[np.int64], scale_std: float) -> bool:
    if len(members) < 2:
        return False
    away_m = np.linalg.norm(estimate.w_T_b[members, :3, 3] - estimate.w_T_b[members[0], :3, 3], axis=1)
    variance = np.trace(estimate.covariances[members, 3:, 3:], axis1=1, axis2=2)
    return bool(np.nansum((scale_std * away_m) ** 2) > 0.5 * np.nansum(variance))


def _height_sensor(estimate: Estimate, flight: Flight | None) -> tuple[str, str]:
    """Estimated gain and offset of the height sensor's readings, in words."""
    found = estimate.range_errors
    if flight is None or flight.sonar is None or found is None:
        return "", ""

    def described(value: str, prior_std: float, determined: bool) -> str:
        if prior_std == 0:
            return "exact, according to its sensor.yaml"
        return value if determined else f"{value}, as assumed: this flight does not determine it"

    gain = f"{found.gain:.3f} ±{SPACE}{found.gain_std:.3f}"
    zero = f"{1e3 * found.zero_m:+.1f} ±{SPACE}{1e3 * found.zero_std_m:.1f}{SPACE}mm"
    priors = flight.sonar.scale_std, flight.sonar.datum_std_m
    gain, zero = map(described, (gain, zero), priors, found.determined(*priors))
    return gain, zero


def _scale_source(estimate: Estimate, flight: Flight | None) -> str:
    if flight is None:
        return "the graph's own edges"
    if not estimate.metric:
        return "none"
    sources = ["height sensor"] if estimate.range_errors is not None else []
    control = estimate.control is not None and any(point.used for point in estimate.control.points)
    sources += ["control points"] if control else []
    sources += ["GPS"] if estimate.origin is not None and flight.gps is not None else []
    accelerometer = estimate.instruments.accelerometer
    sources += ["accelerometer"] if accelerometer is not None and accelerometer.used else []
    if not sources and estimate.instruments.barometer is not None:
        return "barometer"
    if not sources and estimate.instruments.velocity is not None:
        return "vehicle's own velocity"
    # Without refinement the scale comes from the heights that initialised the pose graph.
    return " and ".join(sources) or "height sensor"
