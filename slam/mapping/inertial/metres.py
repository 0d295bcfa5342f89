"""A chain of pictures without ranges, scaled to metres by the heights that the filter tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.heights import HeightEstimate
from slam.mapping.lift_edges import error_growth
from slam.mapping.map import Map

Array = NDArray[np.float64]


def in_metres(chain: Map, heights: HeightEstimate, gain_std: float) -> Map:
    """Return the chain with each part scaled to the ``heights`` of its keyframes, NaN where not known.

    The scale of a part is as uncertain as its heights and the accelerometer's gain together. A part without a
    known height stays as it is. Pictures tell the motion of the camera, so that the parts grow about it.
    """
    n, b_p_c_m = len(chain.component), chain.camera.b_T_c[:3, 3]
    ratio, std = np.ones(n), np.zeros(n)
    from_camera_m = -chain.w_T_b[:, :3, :3] @ b_p_c_m
    w_p_c = chain.w_T_b[:, :3, 3] - from_camera_m
    from_first_m = np.zeros((n, 3))
    for part in range(int(chain.component.max(initial=-1)) + 1):
        members = np.flatnonzero(chain.component == part)
        known = members[np.isfinite(heights.height_m[members])]
        from_first_m[members] = w_p_c[members] - w_p_c[members[0]]
        if len(known):
            camera_m = heights.height_m[known] - from_camera_m[known, 2]
            ratio[members] = np.median(camera_m / w_p_c[known, 2])
            std[members] = np.hypot(np.median(heights.log_std[known]), gain_std)
    w_T_b = chain.w_T_b.copy()
    w_T_b[:, :3, 3] = ratio[:, None] * w_p_c + from_camera_m
    growth = error_growth(ratio, b_p_c_m)
    of_scale = np.zeros((n, 6))
    of_scale[:, 3:] = (std * ratio)[:, None] * np.einsum("nba,nb->na", chain.w_T_b[:, :3, :3], from_first_m)
    covariances = growth @ chain.covariances @ growth.transpose(0, 2, 1)
    covariances += of_scale[:, :, None] * of_scale[:, None, :]
    return replace(
        chain, w_T_b=w_T_b, covariances=covariances, over_floor_covariances=covariances, metric=True
    )
