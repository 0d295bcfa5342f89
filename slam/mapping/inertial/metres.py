"""A chain of pictures without ranges, scaled to metres by the heights that the filter tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.heights import HeightEstimate
from slam.mapping.lift_edges import Edges
from slam.mapping.map import Map

Array = NDArray[np.float64]


def scaled(chain: Map, height_m: Array, log_std: Array, gain_std: float) -> Map | None:
    """Return the chain with each part scaled to the heights (n,) of its keyframes, NaN where not known.

    The scale of a part is as uncertain as its heights (``log_std``) and the accelerometer's gain together.
    The result is None where no height of a part is known.
    """
    heights = chain.edges.heights
    ratio, std = np.ones(len(height_m)), np.zeros(len(height_m))
    w_T_b, covariances = chain.w_T_b.copy(), chain.covariances.copy()
    for part in range(int(chain.component.max(initial=-1)) + 1):
        members = np.flatnonzero(chain.component == part)
        known = members[np.isfinite(height_m[members])]
        if not len(known):
            return None
        ratio[members] = np.median(height_m[known] / heights.height_m[known])
        std[members] = np.hypot(np.median(log_std[known]), gain_std)
        away = w_T_b[members, :3, 3] - w_T_b[members[0], :3, 3]
        stretch = np.zeros((len(members), 6))
        stretch[:, 3:] = std[members, None] * np.einsum("nba,nb->na", w_T_b[members, :3, :3], away)
        covariances[members] += stretch[:, :, None] * stretch[:, None, :]
    unit = np.ones((len(ratio), 6))
    unit[:, 3:] = ratio[:, None]
    w_T_b[:, :3, 3] *= ratio[:, None]
    covariances *= unit[:, :, None] * unit[:, None, :]
    in_metres = HeightEstimate(ratio * heights.height_m, std, np.ones(len(ratio), bool))
    poses = chain.edges.at_heights(in_metres.height_m)
    return replace(
        chain,
        edges=Edges(chain.edges.registrations, poses, in_metres),
        w_T_b=w_T_b,
        covariances=covariances,
        over_floor_covariances=covariances,
    )
