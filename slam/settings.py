"""All settings of the pipeline, each part's its own; the defaults run."""

from __future__ import annotations

from dataclasses import dataclass, field

from backend.bundle.graph import BundleConfig
from frontend.features import FeatureConfig
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.keyframes import KeyframeConfig
from frontend.retrieval import RetrievalConfig
from frontend.tracks import TrackConfig
from slam.inertial.instruments import InertialTrust
from slam.mapping.obstacles import MaskingConfig


@dataclass(frozen=True)
class SensorTrust:
    """What is assumed of sensors beyond what their makers say."""

    attitude_floor_rad: float = 0.005
    """No attitude is believed better than this."""
    attitude_graph_rad: float = 0.05
    """Roll and pitch in the pose graph, before the pictures have had their say: wind misleads attitudes."""
    level_std_rad: float = 0.1
    """Roll and pitch of a camera that is only said to look straight down."""
    range_floor_m: float = 0.005
    """No range is believed better than this."""
    accel_gain_std: float = 0.02
    """Relative: an accelerometer's own gain, by which it has all lengths wrong."""


@dataclass(frozen=True)
class LoopConfig:
    """Which pairs count as loops, and how many are looked at."""

    min_separation_s: float = 10.0
    """Closer in time is odometry."""
    min_overlap: float = 0.3
    """Pairs that the poses say overlap by this share of a footprint are compared."""
    plausible_sigmas: float = 6.0
    """A loop farther than this from where the poses known so far have it is refused."""
    plausible_heights: float = 0.2
    """But nothing within this many flying heights is."""
    max_pairs: int = 6000
    """Pairs compared over the whole flight, of those that look alike, and again of those the poses suggest;
    a long flight compares each keyframe with fewer others."""


@dataclass(frozen=True)
class PipelineConfig:
    """Settings of the whole post-flight job."""

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
