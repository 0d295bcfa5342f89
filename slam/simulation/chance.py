"""Chance: each stream of a flight draws random numbers of its own."""

from __future__ import annotations

import zlib

import numpy as np


def generator(seed: int, stream: str, *index: int) -> np.random.Generator:
    """The random numbers of one stream of one flight, independent of those of every other."""
    return np.random.default_rng((seed, zlib.crc32(stream.encode()), *index))
