"""One place where instruments, not pictures, join two parts of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backend.measurements import RelativePose
from slam.core.messages import Message, warning


@dataclass(frozen=True)
class Bridge:
    """A join of two parts by instruments, and what to say of it."""

    edge: RelativePose
    """The kind is ``inertial``."""
    doubt: str = ""
    """Why the instruments are wrong, so that its error is unknown; empty where nothing contradicts them."""

    @property
    def warning(self) -> Message:
        """The line that tells the pilot of it."""
        bridged = (
            f"no overlapping pictures connect keyframes {self.edge.i} and {self.edge.j}: the instruments "
            "bridge the gap"
        )
        if self.doubt:
            return warning(f"{bridged} with an unknown error, because {self.doubt}: check imu0")
        std_m = float(np.sqrt(np.trace(self.edge.covariance[3:, 3:])))
        return warning(f"{bridged}, ± {std_m:.2g} m", "expect that error in what is measured across it")
