"""Random generators: each stream of a flight has its own."""

from __future__ import annotations

import zlib

import numpy as np


def generator(seed: int, stream: str, *index: int) -> np.random.Generator:
    """Return the random generator of one stream of one flight, independent of all others."""
    return np.random.default_rng((seed, zlib.crc32(stream.encode()), *index))
