"""Obstacles on the floor, found by the sonar: echoes on the map, masks for pictures, cleared flying heights.

The pictures give heights over the floor up to one scale, whatever stands below: so the ratio of range to
height has a sharp peak where the sonar hears the floor, and shorter ranges come from obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from backend.wording import counted, either
from frontend.camera import Camera
from frontend.elevation import Elevation, elevation_map
from frontend.masking import ObstacleMask
from frontend.robust import robust_std
from frontend.views import Masks
from slam.core.flight import Flight
from slam.core.messages import Message, about
from slam.core.streams import Image, Sonar
from slam.mapping.config import MaskingConfig

Array = NDArray[np.float64]

BANDWIDTH = 0.012
"""Bandwidth of the density of log(range / height)."""
PEAK_SHARE = 0.35
"""The floor is the farthest peak at least this high beside the highest."""
RELATIVE_GAMMA = 0.04
"""Ranges wander by some percent: nothing stands out by less than this share of the flying height."""
SPIKE_READINGS = 5
"""Shorter runs of echoes are no obstacle."""
NEAR_MARGIN, LOW_RANGES = 1.2, 3.0
"""Factors on the minimum range between which a missing echo may be an object that is too close."""
_HIDDEN = "pixels that show them are hidden from the matching of pictures, but stay in the mosaic"
OBSTACLE_ECHO = "echo from an obstacle"
"""Reason why an echo is no height of flight."""
FEWEST = 10
MOST_STANDING = 0.5
"""Share of the echoes: the floor is what most of them hear, else sonar or heights of the map are at fault."""
VISIT_S = 3.0
"""Readings of one place so far apart in time are two visits: a beam passes a place within a second or two."""
LONG_S, CLIMBED = 0.5, 0.5 * RELATIVE_GAMMA
"""Between keyframes so far apart in time, and in height by so much of it, the height is anyone's guess."""


@dataclass(frozen=True)
class Echoes:
    """Every reading of the sonar where the map has it."""

    stamps_s: Array
    """(m,)."""
    w_p_m: Array
    """(m, 2) where the axis of the beam meets the floor; NaN where the vehicle's pose is not known."""
    height_m: Array
    """(m,) over the floor, in the map's metres; NaN where there was no echo."""
    radius_m: Array
    """(m,) of the beam on the floor."""
    too_near: NDArray[np.bool_]
    """(m,) no echo although the floor is in range, low enough for an obstacle below the sensor's least range;
    ``height_m`` is what it has at least. The floor may be silent too: alone these prove nothing."""
    floor_std_m: float
    """Scatter of the echoes from the floor."""
    flying_m: float
    """Median height of flight."""

    def gamma_m(self, config: MaskingConfig) -> float:
        """Smallest height of an object above the floor."""
        return max(config.gamma_3_m, 5 * self.floor_std_m, RELATIVE_GAMMA * self.flying_m)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(m,) which readings have an echo at a known place."""
        return np.isfinite(self.height_m) & ~self.too_near

    def standing(self, config: MaskingConfig) -> NDArray[np.bool_]:
        """(m,) which readings hear an obstacle; single spikes are none."""
        measured = np.flatnonzero(self.measured)
        out = np.zeros(len(self.height_m), dtype=bool)
        out[measured] = _without_spikes(self.height_m[measured]) > self.gamma_m(config)
        return out

    def changed_between_visits(self, config: MaskingConfig) -> bool:
        """Return whether most obstacles that were passed twice were there in one visit alone.

        What stands on the floor is heard at every visit.
        """
        standing, measured = self.standing(config), np.flatnonzero(self.measured)
        tree = cKDTree(self.w_p_m[measured])
        changed = []
        for k in np.flatnonzero(standing).tolist():
            near = measured[tree.query_ball_point(self.w_p_m[k], self.radius_m[k] / 2)]
            other = near[np.abs(self.stamps_s[near] - self.stamps_s[k]) > VISIT_S]
            if len(other):
                changed.append(2 * np.count_nonzero(standing[other]) < len(other))
        return len(changed) >= FEWEST and float(np.mean(changed)) > 0.5

    @property
    def map(self) -> Elevation | None:
        """Return the elevation map; None without any echo."""
        return elevation_map(self.w_p_m, self.height_m, self.radius_m)


def echoes_in_map(sonar: Sonar | None, stamps_s: Array, w_T_b: Array, floor_z_m: float) -> Echoes | None:
    """The sonar's readings by poses (n, 4, 4) at ``stamps_s`` (n,) over a level floor; None without any.

    Readings between two poses have no place where one is NaN: its keyframe is of another part, or of none.
    """
    known = np.asarray(np.isfinite(w_T_b).all(axis=(1, 2)))
    placed = np.flatnonzero(known)
    if sonar is None or len(placed) < 2:
        return None
    poses = poses_between(stamps_s[placed], w_T_b[placed], sonar.stamps_s)
    after = np.clip(np.searchsorted(stamps_s, sonar.stamps_s), 1, len(stamps_s) - 1)
    poses[~(known[after - 1] & known[after])] = np.nan
    poses[_height_unknown(stamps_s[placed], w_T_b[placed, 2, 3] - floor_z_m, sonar.stamps_s)] = np.nan
    s_T = poses @ sonar.b_T_s
    axis, origin = -s_T[:, :3, 2], s_T[:, :3, 3]
    height = origin[:, 2] - floor_z_m
    in_limits = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        fall = np.where(in_limits, -sonar.range_m * axis[:, 2], np.nan)
        ratio = np.where((height > 0) & (fall > 0), fall / height, np.nan)
        if np.isfinite(ratio).sum() < FEWEST:
            return None
        # A multipath echo reads farther than the floor.
        scale = _floor_ratio(_without_spikes(ratio[np.isfinite(ratio)]))
        measured = height - fall / scale
        to_floor = height / -axis[:, 2]
        floor_in_range = (to_floor * scale > NEAR_MARGIN * sonar.min_range_m) & (
            to_floor * scale < sonar.max_range_m
        )
        low = height * scale < LOW_RANGES * sonar.min_range_m
    silent = _without_spikes((~in_limits).astype(float)) > 0
    too_near = silent & ~in_limits & floor_in_range & low
    measured = np.where(too_near, height - sonar.min_range_m / scale, measured)
    on_floor = np.abs(ratio / scale - 1) < 3 * BANDWIDTH
    floor_std = robust_std(measured[on_floor]) if on_floor.any() else 0.0
    floor_std = float(np.hypot(floor_std, _step_m(sonar.range_m[in_limits]) / np.sqrt(12)))
    return Echoes(
        sonar.stamps_s,
        origin[:, :2] + to_floor[:, None] * axis[:, :2],
        measured,
        to_floor * np.tan(sonar.beam_width_rad / 2),
        too_near,
        floor_std,
        float(np.nanmedian(height)),
    )


def _step_m(range_m: Array) -> float:
    """Return the step to which ranges are rounded; exact ranges have next to none."""
    values = np.unique(range_m)
    return float(np.median(np.diff(values))) if len(values) > 1 else 0.0


def _without_spikes(values: Array) -> Array:
    """Return the running median (m,) of values."""
    from scipy.ndimage import median_filter  # a long import, for this alone

    return np.asarray(median_filter(values, SPIKE_READINGS))


def _height_unknown(stamps_s: Array, height_m: Array, at_s: Array) -> NDArray[np.bool_]:
    """(k,) which times lie in a stretch without keyframes, where the vehicle has climbed or sunk in that
    stretch or in one beside it: in gusts it may do both between two keyframes of equal heights.
    """
    after = np.clip(np.searchsorted(stamps_s, at_s), 1, len(stamps_s) - 1)
    climbed = np.abs(np.diff(height_m)) > CLIMBED * np.minimum(height_m[1:], height_m[:-1])
    beside = np.pad(climbed, 1)
    climbed = climbed | beside[:-2] | beside[2:]
    return np.asarray((climbed & (np.diff(stamps_s) > LONG_S))[after - 1])


def _floor_ratio(ratio: Array) -> float:
    """The farthest high peak of the density of range over height."""
    logs = np.log(ratio)
    grid = np.arange(
        np.percentile(logs, 1) - 3 * BANDWIDTH, np.percentile(logs, 99) + 3 * BANDWIDTH, BANDWIDTH / 4
    )
    edges = np.append(grid - BANDWIDTH / 8, grid[-1] + BANDWIDTH / 8)
    counts = np.histogram(logs, edges)[0]
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / 4) ** 2)
    density = np.convolve(counts, kernel, "same")
    padded = np.pad(density, 1)
    peak = (density >= padded[:-2]) & (density > padded[2:]) & (density >= PEAK_SHARE * density.max())
    return float(np.exp(grid[np.flatnonzero(peak)[-1]]))


def poses_between(stamps_s: Array, w_T_b: Array, at_s: Array) -> Array:
    """(k, 4, 4) poses at any times between those of (n, 4, 4); NaN before the first and after the last."""
    inside = (at_s >= stamps_s[0]) & (at_s <= stamps_s[-1])
    out = np.full((len(at_s), 4, 4), np.nan)
    if inside.any():
        times = at_s[inside]
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, :3] = Slerp(stamps_s, Rotation.from_matrix(w_T_b[:, :3, :3]))(times).as_matrix()
        poses[:, :3, 3] = np.column_stack([np.interp(times, stamps_s, w_T_b[:, a, 3]) for a in range(3)])
        out[inside] = poses
    return out


def no_masks(frame: int) -> Image | None:
    """Every pixel is looked at."""
    return None


@dataclass(frozen=True)
class Obstacles:
    """Objects that stand on the floor of a flight."""

    sonar: Sonar
    """Without the readings that hear obstacles: they are no heights over the floor."""
    masks: Masks
    """Mask of each frame by its number."""
    warning: Message
    """One line for the user."""
    w_p_m: Array
    """(m, 2) where the map that they were found in has each reading of the sonar."""
    radius_m: float
    """Median radius of the beam on the floor."""

    def moved_from(self, before: Obstacles) -> bool:
        """Whether the map ``before`` had the readings elsewhere by half a beam, but for a similarity."""
        known = np.isfinite(self.w_p_m).all(axis=1) & np.isfinite(before.w_p_m).all(axis=1)
        a, b = before.w_p_m[known] @ [1, 1j], self.w_p_m[known] @ [1, 1j]
        if len(a) < 2:
            return False
        a, b = a - a.mean(), b - b.mean()
        off = np.abs(b - np.vdot(a, b) / np.vdot(a, a) * a)
        return bool(np.percentile(off, 95) > 0.5 * self.radius_m)

    @property
    def unusable_masks_warning(self) -> Message:
        """One line for the user, where there is no map without what shows them."""
        return about(
            self.warning.about,
            self.warning.finding,
            "hiding them from the matching would leave no map, so nothing is hidden",
            "what stands on the floor may bend the map: fly higher over it",
        )

    def cleared(self, flight: Flight) -> Flight:
        """The flight with heights over the floor alone."""
        return replace(flight, sonar=self.sonar).with_warning(self.warning)


def cleared_echoes(recorded: Sonar | None, used: Sonar | None) -> dict[str, int]:
    """Return the number of recorded echoes that a map does not use, by reason; empty where it uses all."""
    if recorded is None or used is None:
        return {}
    cleared = int(np.count_nonzero(np.isfinite(recorded.range_m) & np.isnan(used.range_m)))
    return {OBSTACLE_ECHO: cleared} if cleared else {}


def range_contradiction(
    echoes: Echoes, config: MaskingConfig, fits_ground_below: bool = False
) -> Message | None:
    """Return a line where the ranges contradict the map's heights or each other; None where they do not.

    ``fits_ground_below``: most ranges are those of structure that the pictures show.
    """
    standing, measured = echoes.standing(config), int(echoes.measured.sum())
    if standing.sum() > MOST_STANDING * measured and not fits_ground_below:
        return about(
            "sonar0",
            f"{standing.sum()} of {measured} ranges {either(standing.sum(), 'does', 'do')} not fit "
            "the map's heights over the floor, and "
            "lengths that rest on them may be as wrong",
            "check the sensor, and the camera's shutter and calibration",
        )
    if not standing.any():
        return None
    share = float(np.nanmedian(echoes.height_m[standing])) / echoes.flying_m
    # Otherwise they shift the mean of all ranges by less than the width of the floor's own peak.
    matters = share * standing.sum() > BANDWIDTH * measured
    if matters and echoes.changed_between_visits(config):
        return about(
            "sonar0",
            f"over the same ground the ranges of some visits are {100 * share:.0f} % shorter than "
            "those of others, and lengths that rest on them may be as wrong",
            "if nothing moved there, check the sensor, and whether the zoom of the camera changed",
        )
    return None


def hears_obstacles(echoes: Echoes, config: MaskingConfig) -> bool:
    """Return whether enough echoes come from obstacles, and neither contradict the map nor each other."""
    standing, measured = echoes.standing(config).sum(), int(echoes.measured.sum())
    enough = standing >= max(FEWEST, config.least_share * measured)
    return bool(enough) and range_contradiction(echoes, config) is None


def _not_judged(count: int) -> str:
    """Return how many readings of a sonar are no echoes at a known height, in brackets."""
    more = counted(count, "more reading is", "more readings are")
    return f" ({more} from before or after the map, or outside of the sensor's range)" if count else ""


def find_obstacles(
    flight: Flight,
    camera: Camera,
    stamps_s: Array,
    over_floor_T_b: Array,
    floor_z_m: float,
    config: MaskingConfig,
) -> Obstacles | None:
    """Find objects on the floor under a map's keyframes; return None without any, or without a sonar. Where
    the ranges contradict the map (`range_contradiction`), no echo counts as an obstacle."""
    sonar, frames = flight.sonar, flight.frames
    echoes = (
        echoes_in_map(sonar, stamps_s, over_floor_T_b, floor_z_m) if config.pixels or config.echoes else None
    )
    if echoes is None or sonar is None or frames is None:
        return None
    standing = echoes.standing(config)
    measured = int(echoes.measured.sum())
    elevation = echoes.map
    if elevation is None or not hears_obstacles(echoes, config):
        return None
    radius_m = float(np.nanmedian(echoes.radius_m))
    gamma = echoes.gamma_m(config)
    mask = ObstacleMask(elevation, camera, floor_z_m, gamma)
    placed = np.flatnonzero(np.isfinite(over_floor_T_b).all(axis=(1, 2)))
    poses = poses_between(stamps_s[placed], over_floor_T_b[placed], frames.stamps_s)
    done = [
        *(["they are not used as flying heights"] if config.echoes else []),
        *([_HIDDEN] if config.pixels else []),
    ]
    warning = about(
        "obstacles",
        f"{counted(standing.sum(), 'sonar echo comes', 'sonar echoes come')} from {gamma:.2f} to "
        f"{np.nanmax(echoes.height_m[standing]):.2f} m above the floor, of {measured} that the map can "
        f"judge{_not_judged(len(sonar.stamps_s) - measured)}",
        f"{', and '.join(done)}",
    ).as_note()
    cleared = replace(sonar, range_m=np.where(standing & config.echoes, np.nan, sonar.range_m))
    return Obstacles(
        cleared,
        (lambda frame: mask(poses[frame])) if config.pixels else no_masks,
        warning,
        echoes.w_p_m,
        radius_m,
    )
