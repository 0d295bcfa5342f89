"""The moments of a recording whose pictures are asked where their camera looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Schedule:
    """The moments at which pictures are taken from a recording."""

    most: int
    """Largest number of stretches, evenly over the recording: the cost does not grow with its length."""
    apart_s: float
    """Shortest time between the starts of two stretches, since errors of nearer ones are related."""
    after_s: tuple[float, ...]
    """Other pictures of a stretch are taken so long after its first one."""
    longest_s: float
    """A stretch ends after so long, where the recorder took fewer pictures."""

    def starts_s(self, lasts_s: float) -> Array:
        """Return the starts (n,) of the stretches of a recording that lasts so long."""
        count = int(np.clip(lasts_s / self.apart_s, 1, self.most))
        return np.asarray((np.arange(count) + 0.5) / count * lasts_s)


GLANCE = Schedule(most=32, apart_s=1.0, after_s=(0.2, 0.5), longest_s=2.0)
"""Short stretches for a comparison with instruments: a vehicle turns by some degrees meanwhile, the pictures
still overlap, and turns of a vehicle last about a second."""
CHAIN = Schedule(most=16, apart_s=3.0, after_s=(0.5, 1.0, 1.5, 2.0, 2.5), longest_s=5.0)
"""Long stretches for the pictures alone, in which a vehicle turns farther than it tilts; as many pictures."""
