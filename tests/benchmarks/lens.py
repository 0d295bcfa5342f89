"""A lens whose told calibration is wrong, found by the refinement of made surveys.

The pictures are projected by `tests.backend.made_floor`, which shares no code with the refinement or the
simulator. Fifty surveys count; their positions are as exact as those of an RTK receiver.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.lens import NAMES
from backend.bundle.refinement import refine
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.made_floor import make
from tests.benchmarks.metric import Metric, at_least, reported, within

Array = NDArray[np.float64]

SURVEYS = 50
_SCENE = "rtk, lens wrong"
_PUT_IN = "focal length 3 %, principal point 20 px along each axis, k1 0.1, p1 0.002, p2 -0.001"
_BAND = 0.81, 1.21
"""Where the mean square of 50 x 4 independent normal errors lies with a probability of 95 %. The numbers are
correlated: focal lengths, radial terms, and the principal point with the tangential terms along each axis.
"""


def measure() -> list[Metric]:
    """Refine each survey, and compare its lens with the true one."""
    found = [survey(seed) for seed in range(SURVEYS)]
    errors, stds = (np.array(part) for part in zip(*found, strict=True))
    whitened = errors / stds
    share = 100 * np.mean(np.abs(whitened) < 2, axis=0)
    how = f"{_PUT_IN}; the worst number {share.min():.0f} %"
    rmse = np.sqrt(np.mean(errors**2, axis=0))
    return [
        at_least("numbers of the lens within their told 2 sigma", share.mean(), "%", 94.0, how),
        within("mean square of all errors over their variances", float(np.mean(whitened**2)), "", _BAND),
        *(
            reported(f"{name}: root mean square error", value, unit(name))
            for name, value in zip(NAMES["brown"], rmse, strict=True)
        ),
    ]


def unit(name: str) -> str:
    """Return the unit of a number of the calibration."""
    return "px" if name in ("fx", "fy", "cx", "cy") else ""


def survey(seed: int) -> tuple[Array, Array]:
    """Return errors (9,) of the lens of one survey, and their standard deviations."""
    made = make(SCENES[_SCENE], seed)
    lens = refine(made.measurements, made.start, made.floor_z_m).lens
    assert lens is not None
    return lens.calibration - made.lens, lens.std
