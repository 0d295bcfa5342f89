"""Comparison of the GPS fixes with one part of the map, before and after its refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.mapping.fixes import Fixes
from slam.mapping.position_consensus import Agreement, exact_agreement, rough_agreement
from slam.mapping.position_words import FixWords, fix_words
from slam.mapping.stated_accuracy import FixesOnMap, stated_accuracy_warning

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FixComparison:
    """The fixes, and the keyframes of one part of the map."""

    fixes: Fixes
    stamps_s: Array
    """(m,) times of the keyframes."""

    def rough(self, w_T_b: Array, metric: bool) -> Agreement:
        """Compare with the level, unplaced poses ``w_T_b`` (m, 4, 4)."""
        return rough_agreement(self.fixes.on_map(self.stamps_s, w_T_b), self.fixes.w_p_b_m, metric)

    def exact(self, w_T_b: Array) -> Agreement:
        """Compare with the refined poses ``w_T_b`` (m, 4, 4)."""
        off_m = self.fixes.w_p_b_m - self.fixes.on_map(self.stamps_s, w_T_b)
        return exact_agreement(off_m, self.fixes.std_m)

    def words(self, agreement: Agreement, w_T_b: Array) -> FixWords:
        """Return what is said about the fixes on refined poses ``w_T_b`` (m, 4, 4)."""
        words = fix_words(self.fixes, agreement)
        if not self.fixes.stated:
            return words
        contradicted = stated_accuracy_warning(self._on_map(agreement, w_T_b), self.fixes.std_m)
        return words.with_warning(contradicted) if contradicted else words

    def _on_map(self, agreement: Agreement, w_T_b: Array) -> FixesOnMap:
        used = agreement.used & np.isfinite(agreement.off_m[:, 0])
        here_m = self.fixes.on_map(self.stamps_s, w_T_b)[used, :2]
        at_s = self.fixes.stamps_s[used]
        after = np.clip(np.searchsorted(self.stamps_s, at_s), 1, len(self.stamps_s) - 1)
        nearest = after - (at_s - self.stamps_s[after - 1] < self.stamps_s[after] - at_s)
        moving = len(at_s) > 1 and bool((np.diff(at_s) > 0).all())
        velocity_m_s = np.gradient(here_m, at_s, axis=0) if moving else np.zeros_like(here_m)
        return FixesOnMap(agreement.off_m[used, :2], here_m, w_T_b[nearest, :3, :3], velocity_m_s)
