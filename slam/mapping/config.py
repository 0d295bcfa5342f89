"""All settings of the pipeline, each part's its own; the defaults run."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from backend.bundle.problem import BundleConfig
from backend.measurements import SAME_PLACE_HEIGHTS, nominal_errors
from frontend.features import FeatureConfig
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.keyframes import KeyframeConfig
from frontend.retrieval import RetrievalConfig
from frontend.tracks import TrackConfig
from slam.inertial.instruments import InertialTrust


@dataclass(frozen=True)
class SensorTrust:
    """Assumptions about sensors beyond their nominal figures."""

    attitude_floor_rad: float = 0.005
    """Least standard deviation of an attitude, whatever its sensor states."""
    attitude_graph_rad: float = 0.05
    """Standard deviation of roll and pitch in the pose graph, as wind disturbs attitudes."""
    level_std_rad: float = 0.1
    """Standard deviation of roll and pitch where the camera is assumed to look straight down."""
    range_floor_m: float = nominal_errors.RANGE_FLOOR_M
    """Least standard deviation of a range, whatever its sensor states."""
    height_floor_m: float = nominal_errors.BAROMETER_FLOOR_M
    """Least standard deviation of a height by the barometer, whatever its sensor states."""
    accel_gain_std: float = nominal_errors.ACCEL_GAIN_RATIO
    """Relative standard deviation of an accelerometer's gains, which is that of lengths by it."""
    gyro_gain_std: float = nominal_errors.GYRO_GAIN_RATIO
    """The same of a gyro."""


_LEAST_NEIGHBOURS = 4
"""Those in the same line and in the lines beside it, in a survey with little overlap."""
_PAIRS_OF_SHORT = 6000
"""Pairs that a short flight has time for: a minute at 10 ms each."""
_NEIGHBOURS_OF_LONG = 16
"""Neighbours in a longer flight. A point that n pictures show gives n - 1 independent constraints, for which
each of them must match one of the others: further pairs between them repeat what is known. Of the features in
common ground 46 % match in photographs of fields, and 61 % in video. 16 neighbours then keep 99.5 % of the
constraints of all pairs that overlap by 0.3, in a survey with overlaps of 80 % and over ground that is flown
ten times; 10 keep 98 %. `tests.slam.mapping.test_compared_neighbours` has the computation."""


@dataclass(frozen=True)
class LoopConfig:
    """Which pairs count as loops, and how many are looked at."""

    min_separation_s: float = 10.0
    """Closer in time is odometry."""
    min_overlap: float = 0.3
    """Pairs that the poses say overlap by this share of a footprint are compared."""
    plausible_sigmas: float = 6.0
    """A loop farther than this from where the poses known so far have it is refused."""
    plausible_heights: float = SAME_PLACE_HEIGHTS
    """But nothing within this many flying heights is."""
    max_neighbours: int = 80
    """Most keyframes that each one is compared with, of those that overlap by the poses, largest overlaps
    first. In a hover, each overlaps all others. A long flight compares each with fewer."""
    max_pairs: int = 0
    """Pairs compared over the whole flight, of those that look alike, and again of those that overlap. Each
    keyframe is still compared with ``_LEAST_NEIGHBOURS`` others. 0: no limit of their sum."""

    def neighbours(self, wanted: int, keyframes: int) -> int:
        """Return how many others each of ``keyframes`` is compared with: at most ``wanted``."""
        if self.max_pairs == 0:
            return wanted
        return min(wanted, max(_LEAST_NEIGHBOURS, 2 * self.max_pairs // max(1, keyframes)))

    def overlapping(self, keyframes: int) -> int:
        """Return how many others that overlap it each of ``keyframes`` is compared with."""
        wanted = max(_NEIGHBOURS_OF_LONG, 2 * _PAIRS_OF_SHORT // max(1, keyframes))
        return self.neighbours(min(self.max_neighbours, wanted), keyframes)


@dataclass(frozen=True)
class MaskingConfig:
    """When an echo is an obstacle (IMAV 2011 paper, section 3.1.1)."""

    pixels: bool = True
    """Pixels that show obstacles are not searched for features."""
    echoes: bool = True
    """Echoes from obstacles are no heights of flight."""
    gamma_3_m: float = 0.06
    """Nothing that stands less high over the floor is masked."""
    least_share: float = 0.01
    """Smallest share of the echoes that must be obstacles; below it the floor is flat and is left alone."""


_MOST = 1e6
"""Nothing that is set is larger, in any unit that is used."""
_SHARE, _COUNT, _RATIO = (0.0, 1.0), (1, _MOST), (1.0, _MOST)
_POSITIVE, _OR_NONE = (1e-12, _MOST), (0, _MOST)
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "features": {"max_features": _COUNT, "max_side_px": _COUNT},
    "homography": {
        "threshold_px": _POSITIVE,
        "max_iterations": _COUNT,
        "confidence": _SHARE,
        "noise_floor_px": _OR_NONE,
    },
    "gates": {
        "max_outlier_share": _SHARE,
        "max_relative_change": _RATIO,
        "min_inliers": _COUNT,
        "min_spread": _SHARE,
        "max_corner_std": _POSITIVE,
        "max_scale": _RATIO,
        "min_overlap": _SHARE,
    },
    "keyframes": {"min_overlap": (0.0, 2.0), "patience": _OR_NONE},
    "retrieval": dict.fromkeys(("words", "sample", "neighbours", "dimensions"), _COUNT),
    "loops": {
        "min_separation_s": _OR_NONE,
        "min_overlap": _SHARE,
        "plausible_sigmas": _POSITIVE,
        "plausible_heights": _OR_NONE,
        "max_neighbours": _COUNT,
        "max_pairs": _OR_NONE,
    },
    "tracks": {"max_observations": _COUNT, "least_a_keyframe": _COUNT},
    "bundle": {
        "rounds": _COUNT,
        "huber_sigmas": _POSITIVE,
        "drop_sigmas": _POSITIVE,
        "slope_std_rad": _POSITIVE,
        "start_relief": _POSITIVE,
    },
    "masking": {"gamma_3_m": _OR_NONE, "least_share": _SHARE},
    "trust": {
        "attitude_floor_rad": _OR_NONE,
        "attitude_graph_rad": _POSITIVE,
        "level_std_rad": _POSITIVE,
        "range_floor_m": _OR_NONE,
        "height_floor_m": _OR_NONE,
        "accel_gain_std": _OR_NONE,
        "gyro_gain_std": _OR_NONE,
    },
    "inertial": dict.fromkeys((f.name for f in fields(InertialTrust)), _POSITIVE),
}
"""Least and most of every number, by section and key: `frontend` and `backend` know of no settings file."""


@dataclass(frozen=True)
class PipelineConfig:
    """Settings of the whole post-flight job. Raises ``ValueError`` for a number outside its range."""

    features: FeatureConfig = field(default_factory=FeatureConfig)
    homography: HomographyConfig = field(default_factory=HomographyConfig)
    gates: GateConfig = field(default_factory=GateConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    retrieval: RetrievalConfig = field(default_factory=RetrievalConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    tracks: TrackConfig = field(default_factory=TrackConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    masking: MaskingConfig = field(default_factory=MaskingConfig)
    trust: SensorTrust = field(default_factory=SensorTrust)
    inertial: InertialTrust = field(default_factory=InertialTrust)

    def __post_init__(self) -> None:
        for section, keys in RANGES.items():
            for key, (least, most) in keys.items():
                value = getattr(getattr(self, section), key)
                if not least <= value <= most:
                    got = str(value)[:20]  # an integer may be larger than any float
                    raise ValueError(f"{section}.{key}: must be from {least:g} to {most:g}, got {got}")
        if not self.tracks.grids or min(min(grid) for grid in self.tracks.grids) < 1:
            raise ValueError(f"tracks.grids: must hold cells across and down, got {self.tracks.grids}")
