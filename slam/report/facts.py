"""Figures of a report, computed once: the results of a flight and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.instrument import Instrument
from slam.core.pose_heights import up_stds
from slam.core.units import SPACE, error_length, length, with_error
from slam.evaluation.aligned_maps import chain_on_result, odometry_on_result
from slam.report.coordinates import datum_text, plane_text
from slam.report.gaps import Gap, gaps
from slam.report.heading import heading_doubt
from slam.report.loop_change import LoopChange, loop_change

if TYPE_CHECKING:
    from backend.pose_graph.solution import RangeErrors
    from slam.core.flight import Flight
    from slam.core.streams import Sonar

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
    least_certain: int | None
    """Keyframe with that uncertainty; None where some are not known."""
    scale_std: float
    """Relative uncertainty that all lengths share; 0 where it is not known."""
    mostly_scale: bool
    """Whether that uncertainty causes more than half of the variance of a position."""
    relative_to: str
    """Origin that positions are known relative to; empty where they are absolute."""
    chain_moved_m: float
    """Largest distance of a keyframe from the plain chain's, with the first keyframes aligned."""
    loops_moved_m: tuple[float, float]
    """Typical and largest distance of a keyframe from where it lies without loop closures; NaN where the map
    without them is not known."""
    loop_change: LoopChange | None
    """The part of that which all keyframes share, and the rest; None where it is not known."""
    scale_source: str
    sensor_gain: str
    """Gain and offset of the height sensor, in words; empty without one."""
    sensor_zero: str
    axes: str
    """Directions of x and y, and the place of the origin, in words."""
    gaps: tuple[Gap, ...]
    """Stretches of the path that no usable picture shows."""
    is_graph: bool
    gps_std_m: float = float("nan")
    """Horizontal standard deviation of a fix; NaN without GPS."""
    gps_accuracy: str = "stated"
    """Whether that deviation is "stated" or "assumed"."""
    range_exact: bool = False
    """Whether gain and zero of the height sensor are taken as exact."""
    altitude_known: bool = True
    """Whether an altitude is known on Earth."""
    controlled: bool = False
    """Whether control points hold the map."""
    plane: str = ""
    """Coordinate system of the rasters, in words; empty for a graph."""
    datum: str = ""
    """The datum of heights, in words; empty for a graph."""
    heading_doubt: str = ""
    """The drift of the recorded heading beyond its stated accuracy, in words; empty where both agree."""
    is_refined: bool = False
    """Whether all pictures and instruments were fitted together; those of the map without loops are not."""
    has_truth: bool = False
    """Whether the flight holds a true path."""
    metric: bool = True
    """Whether lengths are metres, as `slam.core.estimate.Estimate` defines it."""

    @property
    def against(self) -> str:
        """The reference of a stated accuracy of a place, in words."""
        if self.relative_to:
            return f"relative to {self.relative_to}"
        return "on Earth" if self.controlled else "on Earth, as the GPS has it,"

    @property
    def condition(self) -> str:
        """The condition on which lengths are right that nothing else checks, as the end of a sentence."""
        several = " and " in self.scale_source or self.scale_source.endswith("points")
        return f"if the {self.scale_source} {'are' if several else 'is'} right"

    @property
    def in_one_piece(self) -> bool:
        """Whether all that was mapped hangs together; False for a graph, which has no pictures to link."""
        return self.maps <= 1 and not self.is_graph

    def length(self, metres: float) -> str:
        """Return a length of this map with its unit."""
        return length(metres, self.metric)

    def error(self, metres: float) -> str:
        """Return the uncertainty of a length of this map with its unit."""
        return error_length(metres, self.metric)


def gather(estimate: Estimate, flight: Flight | None) -> Facts:
    """Compute the figures; ``flight`` is None where the input was a graph."""
    known = is_placed(estimate)
    main = np.flatnonzero(known & (estimate.component == 0))
    position = estimate.w_T_b[main, :3, 3]
    # An unknown standard deviation has no upper limit: the median counts it as the largest.
    every_sigma = _each_sigma_m(estimate.covariances)
    sigma = every_sigma[known]
    verdicts = [loop.verdict for loop in estimate.loops]
    sizes = (
        np.bincount(estimate.component[estimate.component >= 0]) if len(estimate.component) else np.zeros(0)
    )
    extent = np.ptp(position[:, :2], axis=0) if len(position) else np.full(2, np.nan)
    kinds = [edge.kind for edge in estimate.relative_poses]
    scale_std = estimate.scale_std or 0.0 if flight is not None else 0.0
    gain, zero = _height_sensor(estimate, flight)
    without_loops, doubt = odometry_on_result(estimate), heading_doubt(estimate, flight)
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
        least_certain=_least_certain(every_sigma, known),
        scale_std=scale_std,
        mostly_scale=estimate.origin is None and _is_mostly_scale(estimate, main, scale_std),
        relative_to=_relative_to(estimate, flight),
        chain_moved_m=_moved_m(estimate, chain_on_result(estimate), main)[1],
        loops_moved_m=_moved_m(estimate, without_loops, main),
        loop_change=loop_change(without_loops[main, :3, 3], position),
        scale_source=_scale_source(estimate, flight),
        sensor_gain=gain,
        sensor_zero=zero,
        axes=_axes(estimate, flight),
        gaps=gaps(estimate, flight),
        is_graph=flight is None,
        gps_std_m=_gps_std_m(flight),
        gps_accuracy=whence(flight.gps) if flight is not None and flight.gps is not None else "stated",
        range_exact=_range_exact(estimate, flight),
        altitude_known=estimate.altitude_known,
        controlled=estimate.follows_control_points,
        plane="" if flight is None else plane_text(estimate),
        datum="" if flight is None else datum_text(estimate),
        heading_doubt=doubt,
        is_refined=bool(estimate.information_shares),
        has_truth=flight is not None and flight.truth is not None,
        metric=estimate.metric,
    )


def _gps_std_m(flight: Flight | None) -> float:
    if flight is None or flight.gps is None:
        return float("nan")
    return float(np.hypot(*flight.gps.noise_std_m[:2]) / np.sqrt(2))


def whence(series: Instrument) -> str:
    """Return whether the noise of an instrument is stated or assumed, in a word."""
    return "assumed" if series.noise_assumed else "stated"


def _range_exact(estimate: Estimate, flight: Flight | None) -> bool:
    sonar = flight.sonar if flight is not None else None
    return sonar is not None and _range_priors(estimate.range_errors, sonar) == (0, 0)


def _range_priors(found: RangeErrors | None, sonar: Sonar) -> tuple[float, float]:
    """Return how well the map knew gain and zero before the flight: as stated, unless it refutes that."""
    if found is None or found.gain_prior_std is None or found.zero_prior_std_m is None:
        return sonar.scale_std, sonar.datum_std_m
    return found.gain_prior_std, found.zero_prior_std_m


def is_placed(estimate: Estimate) -> NDArray[np.bool_]:
    """(n,) whether a keyframe has a pose."""
    return np.asarray(np.isfinite(estimate.w_T_b.sum(axis=(1, 2))))


def position_sigma_m(covariances: Array) -> Array:
    """Standard deviation (m,) of a position over its three axes together, where known, from (n, 6, 6)."""
    found = _each_sigma_m(covariances)
    return found[np.isfinite(found)]


def heights_over_floor(estimate: Estimate) -> tuple[Array, Array]:
    """Return heights (n,) over the floor, and their standard deviations, NaN where they are not known.

    The errors that keyframes and floor share, as those of altitudes on Earth, are no part of them.
    """
    pose, covariances = estimate.over_floor_T_b, estimate.over_floor_covariances
    return pose[:, 2, 3] - estimate.floor_z_m, up_stds(pose, covariances)


def median_height_m(estimate: Estimate) -> float:
    """Return the median height of a keyframe over the floor; NaN where none is known in metres."""
    height_m = heights_over_floor(estimate)[0]
    known = estimate.metric and np.isfinite(height_m).any()
    return float(np.nanmedian(height_m)) if known else float("nan")


def typical_axis_stds(estimate: Estimate) -> tuple[float, float]:
    """Return the median standard deviation of a keyframe's x and y, each, and of its z; NaN if unknown."""
    rotation, covariances = estimate.w_T_b[:, :3, :3], estimate.covariances[:, 3:, 3:]
    variance = np.einsum("nab,nbc,nac->na", rotation, covariances, rotation)
    variance = variance[np.isfinite(variance).all(axis=1)]
    if len(variance) == 0:
        return float("nan"), float("nan")
    level, up = variance[:, :2].mean(axis=1), variance[:, 2]
    return float(np.sqrt(np.median(level))), float(np.sqrt(np.median(up)))


def largest_height_std(estimate: Estimate) -> float:
    """Return the standard deviation of the least certain height of a keyframe in the world; NaN if none is
    known.

    The tilt and the altitude of the whole map are part of it.
    """
    std_m = up_stds(estimate.w_T_b, estimate.covariances)
    return float(np.nanmax(std_m)) if np.isfinite(std_m).any() else float("nan")


def _each_sigma_m(covariances: Array) -> Array:
    """Standard deviation (n,) of a position over its three axes together; infinite where it is not known."""
    variance = np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
    return np.asarray(np.sqrt(np.where(variance >= 0, variance, np.inf)))


def _least_certain(sigma_m: Array, known: NDArray[np.bool_]) -> int | None:
    placed = np.flatnonzero(known)
    if len(placed) == 0 or not np.isfinite(sigma_m[placed]).all():
        return None
    return int(placed[np.argmax(sigma_m[placed])])


def _or_nan(value: float) -> float:
    return float(value) if np.isfinite(value) else float("nan")


def _moved_m(estimate: Estimate, before_w_T_b: Array, main: NDArray[np.int64]) -> tuple[float, float]:
    """Return the median and the largest distance of keyframes from where they were before."""
    moved = np.linalg.norm((before_w_T_b - estimate.w_T_b)[main, :3, 3], axis=1)
    if not np.isfinite(moved).any():
        return float("nan"), float("nan")
    return float(np.nanmedian(moved)), float(np.nanmax(moved))


def _relative_to(estimate: Estimate, flight: Flight | None) -> str:
    if flight is None:
        return "the pose that is held"
    return "" if estimate.origin is not None else "the first keyframe"


def _axes(estimate: Estimate, flight: Flight | None) -> str:
    if flight is None:
        return "Those of the file."
    if estimate.origin is not None:
        return "x points east, y north and z up."
    origin = "and z up. The origin is on the ground below the first keyframe."
    headed = flight.attitude is not None and bool(np.isfinite(flight.attitude.roll_pitch_yaw_rad[:, 2]).any())
    if headed:
        return f"x points where the recorded heading (yaw) is zero, y to the left of it, {origin}"
    return f"x points where the drone's nose pointed at the first keyframe, y to the left of it, {origin}"


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
    assumed = flight.sonar.assumed

    def described(value: str, prior_std: float, determined: bool, key: str) -> str:
        if prior_std == 0:
            return "exact, according to its sensor.yaml"
        how = "assumed" if key in assumed else "stated"
        return value if determined else f"{value}, as {how}: this flight does not determine it"

    gain = with_error(found.gain, found.gain_std)
    zero = f"{with_error(1e3 * found.zero_m, 1e3 * found.zero_std_m, '+')}{SPACE}mm"
    priors = _range_priors(found, flight.sonar)
    keys = ("scale_std", "datum_std")
    gain, zero = map(described, (gain, zero), priors, found.determined(*priors), keys)
    return gain, zero


def _scale_source(estimate: Estimate, flight: Flight | None) -> str:
    if flight is None:
        return "the graph's own edges"
    if not estimate.metric:
        return "none"
    sources = ["height sensor"] if estimate.range_errors is not None else []
    sources += ["control points"] if estimate.follows_control_points else []
    sources += ["GPS"] if estimate.origin is not None and flight.gps is not None else []
    accelerometer = estimate.instruments.accelerometer
    sources += ["accelerometer"] if accelerometer is not None and accelerometer.used else []
    if not sources and estimate.instruments.barometer is not None:
        return "barometer"
    if not sources and estimate.instruments.velocity is not None:
        return "vehicle's own velocity"
    # Without refinement the scale comes from the heights that initialised the pose graph.
    return " and ".join(sources) or "height sensor"
