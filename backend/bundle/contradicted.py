"""Keyframes that their own pictures contradict after a refinement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras


def contradicted_keyframes(optimum: BundleOptimum) -> NDArray[np.bool_]:
    """Return (n,) whether a keyframe is where most of its observations of the floor are outliers.

    They are dropped, or beyond Huber's limit. An instrument then holds the keyframe away from the place that
    the pictures give it, and seems exact.
    """
    problem, seen = optimum.problem, optimum.cost.observations
    cameras = Cameras.of(problem, optimum.values)
    off = seen.residuals(cameras, optimum.at.point)
    fits = np.hypot(off[:, 0], off[:, 1]) <= seen.huber_sigmas * seen.std_px
    total, fitting = (
        np.bincount(keyframe, minlength=len(cameras.f_T_c))
        for keyframe in (problem.tracks.keyframe, seen.keyframe[fits])
    )
    return np.asarray(2 * fitting < total)
