"""Positions as they were known in flight, compared with the final map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.evaluation.trajectory import position_error, umeyama

Array = NDArray[np.float64]

_FEWEST = 3
"""Points that determine a similarity."""


def live_error(frames: NDArray[np.int64], w_T_b: Array, estimate: Estimate) -> float:
    """Return the RMS distance of the live positions (n, 4, 4) of ``frames`` from those of the final map.

    They are aligned by a similarity, as live lengths may be heights of the camera. NaN if they share fewer
    than three keyframes.
    """
    final = dict(zip(estimate.frame_index.tolist(), estimate.w_T_b, strict=True))
    pairs = [(pose, final[k]) for k, pose in zip(frames.tolist(), w_T_b, strict=True) if k in final]
    positions = np.array(pairs).reshape(-1, 2, 4, 4)[..., :3, 3]
    live, final_m = positions[np.isfinite(positions).all(axis=(1, 2))].transpose(1, 0, 2)
    if len(live) < _FEWEST:
        return float("nan")
    return position_error(umeyama(live, final_m, with_scale=True).apply(live), final_m).rmse
