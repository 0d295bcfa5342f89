"""Similarity of keyframes, by our descriptors and by common alternative methods.

Each method gives one vector a keyframe; the similarity of two keyframes is the inner product.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.retrieval import as_float
from frontend.store import FeatureStore
from slam.core.streams import Image

Float32 = NDArray[np.float32]

BINS = 8
"""Number of histogram bins a channel."""
WORDS = 400
SAMPLE = 12_000
"""Number of descriptors that the bag of words is trained on."""


def colour_histogram(image: Image) -> Float32:
    """Compute the (512,) joint histogram of a picture's colours (256 for grey levels), as square roots.

    The inner product of two is the Bhattacharyya coefficient. Source: Swain and Ballard 1991.
    """
    channels, bins = ([0], [256]) if image.ndim == 2 else ([0, 1, 2], [BINS] * 3)
    counts = cv2.calcHist([image], channels, None, bins, [0.0, 256.0] * len(channels)).ravel()
    return np.asarray(np.sqrt(counts / max(float(counts.sum()), 1.0)).astype(np.float32))


def bags_of_words(store: FeatureStore, seed: int = 0) -> Float32:
    """Compute the (n, words) term frequency times inverse document frequency, unit length.

    OpenCV (``BOWKMeansTrainer``) trains the vocabulary on a sample of the flight's descriptors. Source: Sivic
    and Zisserman 2003, section 4.
    """
    everything = np.concatenate([as_float(store[k].descriptor) for k in _spread(len(store), 200)])
    rng = np.random.default_rng(seed)
    if len(everything) > SAMPLE:
        everything = everything[rng.choice(len(everything), SAMPLE, replace=False)]
    cv2.setRNGSeed(seed)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 10, 1e-4)
    api: Any = cv2.xfeatures2d  # the stubs lack it
    trainer = api.BOWKMeansTrainer(
        min(WORDS, max(1, len(everything) // 8)), stop, 1, cv2.KMEANS_RANDOM_CENTERS
    )
    words = trainer.cluster(np.ascontiguousarray(everything))
    counts = np.stack([_word_counts(as_float(store[k].descriptor), words) for k in range(len(store))])
    seen_in = np.maximum((counts > 0).sum(axis=0), 1)
    weighted = counts * np.log(len(counts) / seen_in)
    size = np.linalg.norm(weighted, axis=1, keepdims=True)
    return np.asarray(
        np.divide(weighted, size, out=np.zeros_like(weighted), where=size > 0).astype(np.float32)
    )


def _spread(n: int, most: int) -> range:
    return range(0, n, max(1, n // most))


def _word_counts(descriptor: Float32, words: Float32) -> NDArray[np.float64]:
    nearest = np.argmin(np.sum(words**2, axis=1) - 2 * descriptor @ words.T, axis=1)
    return np.bincount(nearest, minlength=len(words)) / max(1, len(descriptor))
