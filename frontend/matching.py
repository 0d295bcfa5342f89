"""Which features of two pictures show the same point of the floor."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.features import Features


def match(a: Features, b: Features, ratio: float = 0.85) -> NDArray[np.int64]:
    """Mutual nearest neighbours that are clearly nearer than the second. (m, 2) rows (index in a, in b).

    Source: Lowe 2004, section 7.1 (ratio test); the paper (section 3.1) takes the nearest alone.
    """
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), dtype=np.int64)
    binary = a.descriptor.dtype == np.uint8
    norm, depth = (cv2.NORM_HAMMING, cv2.CV_32S) if binary else (cv2.NORM_L2, cv2.CV_32F)
    distance, forward = cv2.batchDistance(a.descriptor, b.descriptor, depth, normType=norm, K=2)
    distance, forward = distance.reshape(-1, 2), forward.reshape(-1, 2)
    _, backward = cv2.batchDistance(b.descriptor, a.descriptor, depth, normType=norm, K=1)
    nearest = forward[:, 0]
    mutual = backward.reshape(-1)[nearest] == np.arange(len(a))
    clear = distance[:, 0] < ratio * distance[:, 1]
    kept = np.flatnonzero(mutual & clear)
    return np.column_stack([kept, nearest[kept]]).astype(np.int64)
