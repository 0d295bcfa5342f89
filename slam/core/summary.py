"""What one run came to, for a program to read: ``summary.json``."""

from __future__ import annotations

import json
import math
import resource
import sys
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from backend.pose_graph.certificate import Certificate
    from backend.pose_graph.solution import RangeErrors
    from slam.core.estimate import Estimate, InstrumentErrors

_RSS_UNITS_IN_MB = 1 << 20 if sys.platform == "darwin" else 1 << 10
"""``ru_maxrss`` counts bytes on macOS and KiB elsewhere."""


@dataclass(frozen=True)
class Summary:
    """The figures of one optimization."""

    status: str
    """``ok``, or in one sentence what is not observed or could not be placed."""
    frames: int
    """Pictures read; vertices where the input was a graph."""
    keyframes: int
    odometry_edges: int
    loop_edges: int
    rejected: dict[str, int] = field(default_factory=dict)
    """Frames, edges and values dropped, counted by reason."""
    landmarks: int = 0
    """Surveyed points that came with the flight."""
    timing_s: dict[str, float] = field(default_factory=dict)
    peak_rss_mb: float = 0.0
    warnings: tuple[str, ...] = ()
    error: float | None = None
    """Graphs alone: half the squared whitened residuals over all kept edges."""
    iterations: int | None = None
    """Graphs alone."""
    scale_std: float | None = None
    """Relative, of all lengths together; None where nothing told the scale."""
    range_errors: RangeErrors | None = None
    """Flights with a height sensor: the gain and the zero of its readings, as found."""
    instruments: InstrumentErrors | None = None
    """Errors of attitude and accelerometer, as the map shows them."""
    certificate: Certificate | None = None
    """Graphs alone: whether the solution is the global optimum."""

    def to_json(self) -> dict[str, Any]:
        """As ``summary.json`` holds it; a figure that is not finite becomes null."""
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
            "warnings": list(self.warnings),
        }
        if self.error is not None:
            record["error"] = self.error
        if self.iterations is not None:
            record["iterations"] = self.iterations
        if self.range_errors is not None:
            record["height_sensor"] = {**asdict(self.range_errors), "scale_std": self.scale_std}
        for name, errors in ({} if self.instruments is None else asdict(self.instruments)).items():
            if errors is not None:
                record[name] = errors
        if self.certificate is not None:
            record["certificate"] = asdict(self.certificate)
        return record


def summarise(estimate: Estimate, landmarks: int = 0, graph_alone: bool = False) -> Summary:
    """Count what an estimate holds; the peak memory is this process's until now."""
    kinds = [edge.kind for edge in estimate.relative_poses]
    return Summary(
        status=estimate.status,
        frames=estimate.frames,
        keyframes=len(estimate.stamps_s),
        odometry_edges=kinds.count("odometry"),
        loop_edges=kinds.count("loop"),
        rejected={reason: int(count) for reason, count in estimate.rejected.items()},
        landmarks=landmarks,
        timing_s={stage: float(seconds) for stage, seconds in estimate.timing_s.items()},
        peak_rss_mb=peak_rss_mb(),
        warnings=estimate.warnings,
        error=float(estimate.graph_error) if graph_alone else None,
        iterations=int(estimate.iterations) if graph_alone else None,
        scale_std=estimate.scale_std,
        range_errors=estimate.range_errors,
        instruments=estimate.instruments,
        certificate=estimate.certificate,
    )


def peak_rss_mb() -> float:
    """Largest resident memory of this process so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _RSS_UNITS_IN_MB


def json_text(record: object) -> str:
    """A record as JSON that every reader takes: NaN and infinity, which JSON has not, become null."""
    return json.dumps(without_nan(record), indent=2, allow_nan=False) + "\n"


def without_nan(value: Any) -> Any:
    """The same with NaN and infinity, which JSON has not, as None."""
    if isinstance(value, dict):
        return {str(key): without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
