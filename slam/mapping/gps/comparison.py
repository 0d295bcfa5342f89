"""Comparison of the GPS fixes with one part of the map, before and after its refinement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.mapping.gps.consensus import Agreement, exact_agreement, rough_agreement
from slam.mapping.gps.fixes import Fixes, nearest
from slam.mapping.gps.messages import FixMessages, fix_messages
from slam.mapping.gps.stated_accuracy import (
    Contradiction,
    FixesOnMap,
    altitude_contradiction,
    stated_accuracy_contradiction,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FixComparison:
    """The fixes, and the keyframes of one part of the map."""

    fixes: Fixes
    stamps_s: Array
    """(m,) times of the keyframes."""

    def refined(self, offset_m: Array, antenna_m: Array) -> FixComparison:
        """Return the comparison of fixes less an offset (3,) they share, for an estimated antenna (3,)."""
        moved = replace(self.fixes, w_p_b_m=self.fixes.w_p_b_m - offset_m, antenna_m=antenna_m)
        return replace(self, fixes=moved)

    def rough(self, w_T_b: Array, metric: bool) -> Agreement:
        """Compare with the level, unplaced poses ``w_T_b`` (m, 4, 4)."""
        here_m = self.fixes.on_map(self.stamps_s, w_T_b)
        return rough_agreement(here_m, self.fixes.w_p_b_m, metric, self.fixes.std_m)

    def exact(self, w_T_b: Array) -> Agreement:
        """Compare with the refined poses ``w_T_b`` (m, 4, 4)."""
        off_m = self.fixes.w_p_b_m - self.fixes.on_map(self.stamps_s, w_T_b)
        return exact_agreement(off_m, self.fixes.std_m)

    def of_keyframes(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (n,) the fixes that are nearest in time to the keyframes ``which`` (m,)."""
        return which[nearest(self.stamps_s, self.fixes.stamps_s)]

    def messages(self, agreement: Agreement) -> FixMessages:
        """Return remarks and warnings about the fixes."""
        return fix_messages(self.fixes, agreement)

    def contradictions(self, agreement: Agreement, w_T_b: Array) -> list[Contradiction]:
        """Compare the stated or assumed accuracy with refined poses ``w_T_b`` (m, 4, 4)."""
        fixes, high = self.fixes, agreement.altitude_used & np.isfinite(agreement.off_m[:, 2])
        found = (
            stated_accuracy_contradiction(self._on_map(agreement, w_T_b), fixes.std_m, fixes.stated),
            altitude_contradiction(agreement.off_m[high, 2], fixes.std_m[2], fixes.stated),
        )
        return [each for each in found if each is not None]

    def _on_map(self, agreement: Agreement, w_T_b: Array) -> FixesOnMap:
        used = agreement.used & np.isfinite(agreement.off_m[:, 0])
        here_m = self.fixes.on_map(self.stamps_s, w_T_b)[used, :2]
        at_s = self.fixes.stamps_s[used]
        w_R_b = w_T_b[nearest(self.stamps_s, at_s), :3, :3]
        moving = len(at_s) > 1 and bool((np.diff(at_s) > 0).all())
        velocity_m_s = np.gradient(here_m, at_s, axis=0) if moving else np.zeros_like(here_m)
        return FixesOnMap(agreement.off_m[used, :2], here_m, w_R_b, velocity_m_s)
