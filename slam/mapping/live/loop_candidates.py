"""Earlier keyframes that a new keyframe may see again, by appearance and by the poses so far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.loops import appearance
from frontend.retrieval import Appearance, RetrievalConfig
from frontend.store import FeatureStore

Array = NDArray[np.float64]

_FIRST_VOCABULARY = 16
"""Keyframes from which the first vocabulary is learnt; it is learnt again each time their number doubles."""


class AppearanceIndex:
    """Signatures of all keyframes so far, by a vocabulary that is learnt from their own features."""

    def __init__(self, store: FeatureStore, config: RetrievalConfig) -> None:
        self._store, self._config = store, config
        self._learnt: Appearance | None = None
        self._learnt_at = 0
        self._rows: list[NDArray[np.float32]] = []

    def add(self, newest: int) -> None:
        """Add the keyframe ``newest``, whose features are in the store already."""
        count = newest + 1
        if count >= max(_FIRST_VOCABULARY, 2 * self._learnt_at):
            self._learnt, self._learnt_at = appearance(self._store, self._config), count
            self._rows = [self._learnt.of(self._store[k].descriptor) for k in range(count)]
        elif self._learnt is not None:
            self._rows.append(self._learnt.of(self._store[newest].descriptor))

    def similar(self, among: NDArray[np.int64], count: int) -> list[int]:
        """Return up to ``count`` keyframes of ``among`` (m,) that look like the newest, the most similar
        first; none before a vocabulary is learnt."""
        if self._learnt is None or len(among) == 0:
            return []
        similarity = np.array([self._rows[k] for k in among.tolist()]) @ self._rows[-1]
        return [int(k) for k in among[np.argsort(-similarity, kind="stable")[:count]]]


def near(w_p_b: Array, here: Array, reach: float, among: NDArray[np.int64], count: int) -> list[int]:
    """Return up to ``count`` keyframes of ``among`` (m,) nearest to ``here`` (3,), within ``reach``.

    ``w_p_b`` (m, 3) are their positions; NaN where not placed.
    """
    apart = np.linalg.norm((w_p_b - here)[:, :2], axis=1)
    order = np.argsort(apart, kind="stable")  # NaN is last
    return [int(among[k]) for k in order[:count] if apart[k] <= reach]
