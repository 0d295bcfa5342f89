"""Positions as they were known in flight, compared with the final map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend import se3
from slam.core.estimate import Estimate

Array = NDArray[np.float64]


def live_error(frames: NDArray[np.int64], w_T_b: Array, estimate: Estimate) -> float:
    """Return the RMS distance of the live positions (n, 4, 4) of ``frames`` from those of the final map.

    Both are relative to the first keyframe that they share; NaN if they share none.
    """
    final = dict(zip(estimate.frame_index.tolist(), estimate.w_T_b, strict=True))
    pairs = [(pose, final[k]) for k, pose in zip(frames.tolist(), w_T_b, strict=True) if k in final]
    poses = np.array(pairs).reshape(-1, 2, 4, 4)
    poses = poses[np.isfinite(poses).all(axis=(1, 2, 3))]
    if len(poses) == 0:
        return float("nan")
    first = se3.inverse(poses[0])
    off = (first[0] @ poses[:, 0])[:, :3, 3] - (first[1] @ poses[:, 1])[:, :3, 3]
    return float(np.sqrt((off**2).sum(axis=1).mean()))
