"""Work of the front end that a further pass over the same pictures, with other masks, can use again.

It is found by what it was made of, so the result is the same to the bit as without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from frontend.features import Features
from frontend.motions import Expectation
from frontend.registration import Registration
from frontend.store import FeatureStore

Key = tuple[bytes, bytes, tuple[bytes, float] | None]


@dataclass
class EarlierPass:
    """Features and comparisons of one pass."""

    store: FeatureStore | None = None
    keyframe_of: dict[int, int] = field(default_factory=dict)
    """Frame -> keyframe in the store, where its features are all those of the picture without a mask."""
    registrations: dict[Key, Registration] = field(default_factory=dict)
    """Results of comparisons, by the features of both keyframes and the expectation."""

    def features(self, frame: int) -> Features | None:
        """Return all features of a picture; None if they are not known."""
        if self.store is None or frame not in self.keyframe_of:
            return None
        return self.store[self.keyframe_of[frame]]

    def compared(self, made_of: Mapping[tuple[int, int], Key]) -> dict[tuple[int, int], Registration]:
        """Return the known registrations of pairs (i, j) of keyframes."""
        each = {pair: self.registrations.get(key) for pair, key in made_of.items()}
        return {(i, j): replace(found, i=i, j=j) for (i, j), found in each.items() if found is not None}


def comparison_key(store: FeatureStore, i: int, j: int, expected: Expectation | None) -> Key:
    """Return what the result of a comparison of two keyframes depends on."""
    expectation = None if expected is None else (expected.corners_px.tobytes(), expected.lead)
    return store.digest(i), store.digest(j), expectation
