"""Readings of each sensor at the times of the keyframes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from backend.measurements import Attitude, BarometerHeight, Position, RowExposure, SlantRange
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin
from slam.core.instrument_readings import MAX_GAP_S
from slam.core.streams import AttitudeSeries, Scalar, Sonar
from slam.mapping.config import PipelineConfig
from slam.mapping.gps.consensus import Agreement
from slam.mapping.gps.fixes import Fixes, fixes_of, nearest

Array = NDArray[np.float64]

_LEAST_JUDGED = 4
"""Samples around a time, from which on those that disagree with most of them are left out."""
_OUTLIER_SIGMA = 5.0
"""Deviation from the others that one healthy sample in two million exceeds."""

_LONGEST_S = 4 * MAX_GAP_S
"""Longest stretch of samples that a line is fitted to."""
REACH_S = MAX_GAP_S + _LONGEST_S
"""Time from a sample beyond which it tells no value."""

_RANGED_SHARE = 0.5
"""Share of keyframes with ranges up to which the barometer counts beside them: a height sensor that reaches
the floor near the take-off alone says nothing of the climb."""


def local_value(
    stamps_s: Array, values: Array, at_s: Array, half_window_s: float, noise_std: ArrayLike = np.inf
) -> tuple[Array, Array]:
    """Straight line fitted to the samples around each time; between two samples, interpolation.

    A time before the first sample or after the last is reached from samples over twice its distance: from two
    neighbours a line would carry their noise far off. The line goes through the samples that most others
    around that time agree with, within ``noise_std`` (d,) or the noise that neighbours show: one false echo
    must not spoil the mean.

    ``values`` (n, d), ``at_s`` (k,). Returns (k, d) values, NaN where there is a gap, and (k,) the factor
    that the fit puts on the standard deviation of one sample: white noise averages out, and where no majority
    agrees, the factor is the spread of the samples.
    """
    order = np.argsort(stamps_s, kind="stable")
    stamps_s, values = stamps_s[order], values[order]
    noise_std = np.broadcast_to(noise_std, values.shape[1:])
    tolerance = _OUTLIER_SIGMA * np.maximum(noise_std, _noise_between_neighbours(values))
    out = np.full((len(at_s), values.shape[1]), np.nan)
    factor = np.ones(len(at_s))
    for k, t in enumerate(at_s):
        beyond_s = max(stamps_s[0] - t, t - stamps_s[-1], 0.0) if len(stamps_s) else 0.0
        reach_s = max(half_window_s, 3 * beyond_s)
        lo, hi = np.searchsorted(stamps_s, [t - reach_s, t + reach_s])
        # Interpolation needs a sample on each side. One at exactly this time needs no other: photographs have
        # their own angles, however far apart they are.
        last = np.searchsorted(stamps_s, t, side="right") - 1
        lo = max(0, min(lo, last))
        least = lo + (1 if last >= 0 and stamps_s[last] == t else 2)
        hi = min(len(stamps_s), max(hi, least, np.searchsorted(stamps_s, t) + 1))
        dt, near = stamps_s[lo:hi] - t, values[lo:hi]
        if len(dt) == 0 or np.abs(dt).min() > MAX_GAP_S or np.ptp(stamps_s[lo:hi]) > _LONGEST_S:
            continue
        agrees, least_factor = _on_one_line(dt, near, tolerance), 0.0
        if 2 * agrees.sum() > len(dt):
            dt, near = dt[agrees], near[agrees]
        else:
            least_factor = float((np.ptp(near, axis=0) / noise_std).max())
        centre = dt.mean()
        spread = np.sum((dt - centre) ** 2)
        weight = np.full(len(dt), 1.0 / len(dt))
        if spread > 0:
            weight = weight - centre * (dt - centre) / spread
        out[k] = weight @ near
        factor[k] = max(float(np.sqrt(np.sum(weight**2))), least_factor)
    return out, factor


def _noise_between_neighbours(values: Array) -> Array:
    """Return (d,) the standard deviation of white noise from the smallest quarter of the steps between
    neighbours, which outliers hardly reach; motion makes it larger."""
    if len(values) < 2:
        return np.zeros(values.shape[1])
    quarter = float(ndtri(0.625)) * np.sqrt(2)
    return np.asarray(np.quantile(np.abs(np.diff(values, axis=0)), 0.25, axis=0) / quarter)


def _on_one_line(t: Array, values: Array, tolerance: Array) -> NDArray[np.bool_]:
    """Return (n,) which samples (n, d) lie within ``tolerance`` (d,) of the line through two of them that
    most samples agree with, and best. Up to three samples are not judged: each pair has a line of its own.

    Source: Torr and Zisserman 2000 (CVIU 78), the loss of MSAC, over all pairs instead of random ones.
    """
    if len(np.unique(t)) < _LEAST_JUDGED or not np.all((tolerance > 0) & np.isfinite(tolerance)):
        return np.ones(len(t), dtype=bool)
    a, b = np.triu_indices(len(t), 1)
    a, b = a[t[a] < t[b]], b[t[a] < t[b]]
    slope = (values[b] - values[a]) / (t[b] - t[a])[:, None]
    line = values[a][:, None] + (t - t[a][:, None])[..., None] * slope[:, None]
    off = (np.abs(values - line) / tolerance).max(axis=2)
    return np.asarray(off[np.argmin(np.minimum(off, 1.0).sum(axis=1))] <= 1.0)


def attitudes_at(series: AttitudeSeries | None, at_s: Array, floor_std_rad: float) -> tuple[Attitude, ...]:
    """Attitude at each keyframe; ``floor_std_rad`` bounds from below what a maker's figure may claim."""
    if series is None:
        return ()
    value, std = np.full((len(at_s), 3), np.nan), np.full((len(at_s), 3), np.inf)
    for axes in ([0, 1], [2]):  # a heading may be missing where the tilt is known
        angles = series.roll_pitch_yaw_rad[:, axes]
        good = np.isfinite(angles).all(axis=1)
        unwrapped = np.unwrap(angles[good], axis=0)
        noise = np.array(series.noise_std_rad)[axes]
        value[:, axes], factor = local_value(
            series.stamps_s[good], unwrapped, at_s, 0.05, np.hypot(noise, floor_std_rad)
        )
        std[:, axes] = np.hypot(noise * factor[:, None], floor_std_rad)
    std[np.isnan(value)] = np.inf
    known = np.isfinite(value[:, :2]).all(axis=1)
    return tuple(Attitude(int(k), np.nan_to_num(value[k]), std[k]) for k in np.flatnonzero(known))


def ranges_at(sonar: Sonar | None, at_s: Array, floor_std_m: float) -> tuple[SlantRange, ...]:
    """Slant range at each keyframe; readings outside the sensor's limits are left out."""
    if sonar is None:
        return ()
    good = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    if not good.any():
        return ()
    value, factor = local_value(
        sonar.stamps_s[good], sonar.range_m[good, None], at_s, 0.1, np.hypot(sonar.noise_std_m, floor_std_m)
    )
    std = np.hypot(sonar.noise_std_m * factor, floor_std_m)
    return tuple(
        SlantRange(int(k), float(value[k, 0]), float(std[k]), sonar.b_T_s)
        for k in np.flatnonzero(np.isfinite(value[:, 0]))
    )


def heights_at(barometer: Scalar | None, at_s: Array, floor_std_m: float) -> tuple[BarometerHeight, ...]:
    """Height by the barometer at each keyframe."""
    if barometer is None:
        return ()
    good = np.isfinite(barometer.value)
    value, factor = local_value(
        barometer.stamps_s[good],
        barometer.value[good, None],
        at_s,
        0.1,
        np.hypot(barometer.noise_std, floor_std_m),
    )
    std_m = np.hypot(barometer.noise_std * factor, floor_std_m)
    return tuple(
        BarometerHeight(int(k), float(value[k, 0]), float(std_m[k]))
        for k in np.flatnonzero(np.isfinite(value[:, 0]))
    )


def row_exposure(flight: Flight, at_s: Array) -> RowExposure | None:
    """How the rows of photographs are exposed, for the pictures at ``at_s`` (n,); None for a video, whose
    frames tell it."""
    frames, camera = flight.frames, flight.camera
    if not flight.all_keyframes or frames is None or camera is None:
        return None
    w_v_m_s = np.full((len(at_s), 3), np.nan)
    if frames.w_v_m_s is not None:
        # The nearest one: a keyframe has the stamp of its picture, but for the correction of a clock.
        w_v_m_s = frames.w_v_m_s[np.searchsorted((frames.stamps_s[1:] + frames.stamps_s[:-1]) / 2, at_s)]
    return RowExposure(camera.size_px[1], camera.readout_s or None, w_v_m_s)


@dataclass(frozen=True)
class KeyframeReadings:
    """Readings of all instruments at the times of the keyframes."""

    stamps_s: Array
    attitudes: tuple[Attitude, ...]
    ranges: tuple[SlantRange, ...]
    positions: tuple[Position, ...]
    heights: tuple[BarometerHeight, ...]
    """Heights by the barometer; empty where a height sensor measures the floor from most keyframes: it is far
    more exact."""
    range_gain_std: float
    range_datum_std_m: float
    roll_pitch_rad: Array
    """(n, 2); zero where no attitude was measured."""
    roll_pitch_std_rad: Array
    """(n, 2) standard deviations for the pose graph."""
    fixes: Fixes | None = None
    """The fixes that ``positions`` come from; None without GPS."""
    exposure: RowExposure | None = None
    """How the rows of the pictures are exposed; None where it is not known how the cameras move."""
    names: tuple[str, ...] = ()
    """(n,) names of photographs for messages; empty for other pictures, which have their numbers."""

    def with_fixes(self, agreement: Agreement) -> KeyframeReadings:
        """Return the readings with positions from the fixes that agree with the map alone."""
        assert self.fixes is not None
        fixes = self.fixes.only(agreement.used, agreement.altitude_used)
        return replace(self, positions=fixes.at(self.stamps_s))

    @staticmethod
    def at(
        flight: Flight, stamps_s: Array, origin: GeoOrigin | None, config: PipelineConfig
    ) -> KeyframeReadings:
        """Interpolate all streams at the times of the keyframes ``stamps_s`` (n,)."""
        trust = config.trust
        fixes = fixes_of(flight, origin)
        attitudes = attitudes_at(flight.attitude, stamps_s, trust.attitude_floor_rad)
        roll_pitch = np.zeros((len(stamps_s), 2))
        std = np.full((len(stamps_s), 2), trust.level_std_rad)
        for a in attitudes:
            roll_pitch[a.k] = a.roll_pitch_yaw_rad[:2]
            std[a.k] = np.hypot(a.std_rad[:2], trust.attitude_graph_rad)
        ranges = ranges_at(flight.sonar, stamps_s, trust.range_floor_m)
        is_ranged = len(ranges) > _RANGED_SHARE * len(stamps_s)
        return KeyframeReadings(
            stamps_s=stamps_s,
            attitudes=attitudes,
            ranges=ranges,
            heights=() if is_ranged else heights_at(flight.barometer, stamps_s, trust.height_floor_m),
            positions=fixes.at(stamps_s) if fixes else (),
            fixes=fixes,
            range_gain_std=flight.sonar.scale_std if flight.sonar else 0.0,
            range_datum_std_m=flight.sonar.datum_std_m if flight.sonar else 0.0,
            roll_pitch_rad=roll_pitch,
            roll_pitch_std_rad=std,
            exposure=row_exposure(flight, stamps_s),
            names=_photograph_names(flight, stamps_s),
        )


def _photograph_names(flight: Flight, stamps_s: Array) -> tuple[str, ...]:
    """Return the names of the photographs at the times ``stamps_s`` (n,); none for other pictures."""
    frames = flight.frames
    if frames is None or not flight.all_keyframes:
        return ()
    return tuple(frames.names[k] for k in nearest(frames.stamps_s, stamps_s).tolist())
