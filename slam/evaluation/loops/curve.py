"""Precision and recall over the threshold on a score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """Precision and recall at each threshold, in falling order.

    Precision is the true share of the pairs at or above the threshold; recall is the share of all true pairs.
    """

    threshold: Array
    precision: Array
    recall: Array

    @property
    def area(self) -> float:
        """Area under precision over recall (average precision).

        True pairs without a score are never found and add nothing. NaN where there is no true pair.
        """
        if np.isnan(self.recall).any():
            return float("nan")
        return float(np.diff(self.recall, prepend=0.0) @ self.precision)

    @property
    def full_precision_recall(self) -> float:
        """Largest recall before the first false pair; NaN where there is no true pair."""
        if np.isnan(self.recall).any():
            return float("nan")
        return float(self.recall[self.precision == 1.0].max(initial=0.0))

    def thinned(self, most: int) -> Curve:
        """Reduce the curve to at most ``most`` entries, including its ends."""
        kept = np.unique(np.linspace(0, len(self.threshold) - 1, most).round().astype(int))
        kept = kept[: len(self.threshold)]
        return Curve(self.threshold[kept], self.precision[kept], self.recall[kept])


def precision_recall(score: Array, is_true: NDArray[np.bool_], true_total: int) -> Curve:
    """Compute the curve of pairs with a ``score`` (m,), higher is more similar; equal scores are accepted
    together.

    ``is_true`` (m,) marks the loops; ``true_total`` counts all loops, including those without a score.
    """
    order = np.argsort(-score, kind="stable")
    score, is_true = score[order], is_true[order]
    last = np.flatnonzero(np.diff(score, append=-np.inf) != 0)
    right = np.cumsum(is_true)[last]
    recall = right / true_total if true_total else np.full(len(last), np.nan)
    return Curve(score[last], right / (last + 1.0), recall)
