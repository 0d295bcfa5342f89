"""The figures of one run for other programs: ``summary.json``."""

from __future__ import annotations

import json
import math
import resource
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from slam.core.messages import Message, by_kind

if TYPE_CHECKING:
    from backend.pose_graph.certificate import Certificate
    from backend.pose_graph.solution import RangeErrors, RowMistake
    from frontend.obstacles import ObstacleList
    from slam.core.control_points import ControlReport
    from slam.core.estimate import Estimate, GroundFacts
    from slam.core.instrument_errors import InstrumentErrors

_RSS_UNITS_IN_MB = 1 << 20 if sys.platform == "darwin" else 1 << 10
"""``ru_maxrss`` counts bytes on macOS and KiB elsewhere."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The figures of one optimization."""

    frames: int
    """Number of pictures read, or of vertices of a pose graph."""
    keyframes: int
    odometry_edges: int
    loop_edges: int
    rejected: dict[str, int] = field(default_factory=dict)
    """Number of dropped frames, edges and values by reason."""
    not_placed: dict[str, str] = field(default_factory=dict)
    """Name of each picture that should have a pose and has none -> reason."""
    not_drawn: dict[str, str] = field(default_factory=dict)
    """Name of each keyframe that the mosaic does not show -> reason."""
    partly_drawn: dict[str, str] = field(default_factory=dict)
    """Name of each keyframe of which the mosaic lacks ground -> how much of it, and why."""
    landmarks: int = 0
    """Number of surveyed points of the flight."""
    timing_s: dict[str, float] = field(default_factory=dict)
    peak_rss_mb: float = 0.0
    messages: tuple[Message, ...] = ()
    error: float | None = None
    """Half the sum of squared whitened residuals over all kept edges; for pose graphs only."""
    iterations: int | None = None
    """Number of iterations; for pose graphs only."""
    scale_std: float | None = None
    """Relative standard deviation that all lengths share; None where the scale is not observed."""
    range_errors: RangeErrors | None = None
    """Estimated gain and zero of the height sensor; None without one."""
    instruments: InstrumentErrors | None = None
    """Errors of attitude, accelerometer and mount, as the map determines them."""
    accuracy_basis: str = ""
    """The one instrument or the assumed values on which the stated accuracy rests; empty where several do."""
    information_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Direction -> instrument -> its share in the variance; empty without a refinement."""
    ground: GroundFacts | None = None
    """The ground of the mosaic; None without a mosaic."""
    obstacles: ObstacleList | None = None
    """Things that stand on the ground; None where nothing would show them."""
    control: ControlReport | None = None
    """Control points and check points; None without any."""
    height_system: str | None = None
    """The level of altitudes, ``unknown`` if nobody states it; None without a place on Earth."""
    row_mistakes: tuple[RowMistake, ...] = ()
    """Rejected edges of a pose graph that one typical mistake of their rows explains."""
    certificate: Certificate | None = None
    """Whether the solution is the global optimum; of a flight, for its pairs of pictures alone."""

    @property
    def status(self) -> str:
        """``ok``, or the reasons why the map may be wrong, in one line."""
        return by_kind(self.messages).status

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``summary.json``."""
        record: dict[str, Any] = {
            "status": self.status,
            "frames": self.frames,
            "keyframes": self.keyframes,
            "edges": {
                "odometry": self.odometry_edges,
                "loop": self.loop_edges,
                "rejected": dict(self.rejected),
            },
            "landmarks": self.landmarks,
            "timing_s": {stage: round(seconds, 4) for stage, seconds in self.timing_s.items()},
            "peak_rss_mb": round(self.peak_rss_mb, 1),
            "warnings": list(map(str, self.messages)),
            "notes": list(map(str, by_kind(self.messages).notes)),
        }
        of_pictures = {
            "not_placed": self.not_placed, "not_drawn": self.not_drawn, "partly_drawn": self.partly_drawn,
        }  # fmt: skip
        for name, pictures in of_pictures.items():
            if pictures:
                record[name] = dict(pictures)
        if self.error is not None:
            record["error"] = self.error
        if self.iterations is not None:
            record["iterations"] = self.iterations
        if self.range_errors is not None:
            record["height_sensor"] = {**asdict(self.range_errors), "scale_std": self.scale_std}
        for name, errors in ({} if self.instruments is None else asdict(self.instruments)).items():
            if errors is not None:
                record[name] = errors
        if self.accuracy_basis:
            record["accuracy_basis"] = self.accuracy_basis
        if self.information_shares:
            record["information_shares"] = {
                direction: {name: round(share, 4) for name, share in shares.items()}
                for direction, shares in self.information_shares.items()
            }
        if self.ground is not None:
            record["ground"] = asdict(self.ground)
        if self.obstacles is not None:
            record["obstacles"] = asdict(self.obstacles)
        if self.control is not None:
            record |= _control_record(self.control)
        if self.height_system is not None:
            record["height_system"] = self.height_system
        if self.row_mistakes:
            record["row_mistakes"] = [asdict(each) for each in self.row_mistakes]
        if self.certificate is not None:
            record["certificate"] = asdict(self.certificate)
        return record


def summarise(estimate: Estimate, landmarks: int = 0, graph_alone: bool = False) -> Summary:
    """Return the figures of an estimate, and the peak memory of this process until now."""
    kinds = [edge.kind for edge in estimate.relative_poses]
    return Summary(
        frames=estimate.frames,
        keyframes=len(estimate.stamps_s),
        odometry_edges=kinds.count("odometry"),
        loop_edges=kinds.count("loop"),
        rejected={reason: int(count) for reason, count in estimate.rejected.items()},
        not_placed=estimate.not_placed,
        not_drawn=estimate.not_drawn,
        partly_drawn=estimate.partly_drawn,
        landmarks=landmarks,
        timing_s={stage: float(seconds) for stage, seconds in estimate.timing_s.items()},
        peak_rss_mb=peak_rss_mb(),
        messages=estimate.messages,
        error=float(estimate.graph_error) if graph_alone else None,
        iterations=int(estimate.iterations) if graph_alone else None,
        scale_std=estimate.scale_std,
        range_errors=estimate.range_errors,
        instruments=estimate.instruments,
        accuracy_basis=estimate.accuracy_basis,
        information_shares=estimate.information_shares,
        ground=estimate.ground,
        obstacles=estimate.obstacles,
        control=estimate.control,
        height_system=None if estimate.origin is None else estimate.height_system or "unknown",
        row_mistakes=estimate.row_mistakes,
        certificate=estimate.certificate,
    )


def _control_record(control: ControlReport) -> dict[str, Any]:
    record: dict[str, Any] = {"control_points": [asdict(point) for point in control.points]}
    if control.gps_offset_m is not None:
        offset = {"offset_m": control.gps_offset_m, "offset_std_m": control.gps_offset_std_m}
        record["gps_against_control" if control.is_followed else "gps_against_check_points"] = offset
    if control.survey_scale > 1:
        record["survey_scale"] = control.survey_scale
    return record


def peak_rss_mb() -> float:
    """Return the largest resident memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _RSS_UNITS_IN_MB


def json_text(record: object) -> str:
    """Return a record as standard JSON: NaN and infinity become null."""
    return json.dumps(without_nan(record), indent=2, allow_nan=False) + "\n"


def without_nan(value: Any) -> Any:
    """Return the value with NaN and infinity, which JSON lacks, replaced by None."""
    if isinstance(value, dict):
        return {str(key): without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
