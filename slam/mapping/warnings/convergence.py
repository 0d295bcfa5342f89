"""Warning about a refinement that ended before it converged."""

from __future__ import annotations

from backend.bundle.refinement import Bundle
from slam.core.messages import Message, warning
from slam.core.names import enumerated
from slam.mapping.keyframe_readings import KeyframeReadings


def convergence_warnings(bundle: Bundle, readings: KeyframeReadings) -> list[Message]:
    """Report a refinement that ended before it converged, with the instruments that may be the cause."""
    if not bundle.not_converged:
        return []
    measured = (
        ("the attitude", readings.attitudes),
        ("the height sensor", readings.ranges),
        ("the barometer", readings.heights),
        ("GPS", readings.positions),
    )
    names = [name for name, taken in measured if taken]
    return [
        warning(
            f"the refinement of {len(bundle.w_T_b)} keyframes did not converge ({bundle.not_converged}): "
            "errors may be larger than their standard deviations",
            f"check {enumerated(names)}" if names else "add pictures that overlap these",
        )
    ]
