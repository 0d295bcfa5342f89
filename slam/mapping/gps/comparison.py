"""Comparison of the GPS fixes with one part of the map, before and after its refinement."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.position_steps import PositionStep
from slam.core.messages import Kind
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M
from slam.mapping.gps.altitude_course import AltitudesOnMap
from slam.mapping.gps.consensus import Agreement, exact_agreement, rough_agreement
from slam.mapping.gps.fixes import Fixes, nearest
from slam.mapping.gps.messages import FixMessages, fix_messages
from slam.mapping.gps.stale_fixes import moved_since_m, stale_line
from slam.mapping.gps.stated_accuracy import (
    Contradiction,
    FixesOnMap,
    altitude_contradiction,
    altitude_course_contradiction,
    mirror_contradiction,
    stated_accuracy_contradiction,
)
from slam.mapping.gps.steps import step_warning

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FixComparison:
    """The fixes, and the keyframes of one part of the map."""

    fixes: Fixes
    stamps_s: Array
    """(m,) times of the keyframes."""
    moved_m: Array | None = None
    """(n,) how far the map moved since the fix that each repeats, NaN for fixes that count; None where it was
    not compared for repeats."""

    def without_repeats(self, w_T_b: Array, metric: bool) -> FixComparison:
        """Return the comparison that leaves out the fixes that repeat a place while the level, unplaced poses
        ``w_T_b`` (m, 4, 4) move."""
        fixes = self.fixes
        if fixes.repeats_place is None:
            return self
        here_m = fixes.on_map(self.stamps_s, w_T_b)
        moved_m = moved_since_m(
            here_m, fixes.w_p_antenna_m, fixes.repeats_place, metric=metric, nominal_std_m=fixes.std_m
        )
        return replace(self, moved_m=moved_m)

    @property
    def stale(self) -> NDArray[np.bool_]:
        """(n,) which fixes repeat a place while the pictures move: they are not compared."""
        return np.zeros(len(self.fixes), bool) if self.moved_m is None else np.isfinite(self.moved_m)

    @property
    def at_one_place(self) -> bool:
        """Whether all fixes have one place: the receiver had stopped, and they tell no lengths."""
        repeats = self.fixes.repeats_place
        return repeats is not None and bool(repeats[1:].all())

    def refined(self, offset_m: Array, antenna_m: Array) -> FixComparison:
        """Return the comparison of fixes less an offset (3,) they share, for an estimated antenna (3,)."""
        moved = replace(self.fixes, w_p_antenna_m=self.fixes.w_p_antenna_m - offset_m, antenna_m=antenna_m)
        return replace(self, fixes=moved)

    def rough(self, w_T_b: Array, metric: bool) -> Agreement:
        """Compare with the level, unplaced poses ``w_T_b`` (m, 4, 4)."""
        here_m = self._covered(w_T_b)
        agreement = rough_agreement(here_m, self.fixes.w_p_antenna_m, metric, self.fixes.std_m)
        return agreement.without(self.stale)

    def exact(self, w_T_b: Array, map_std_m: Array | None = None) -> Agreement:
        """Compare with the refined poses ``w_T_b`` (m, 4, 4), known to ``map_std_m`` (n, 3) at the fixes."""
        off_m = self.fixes.w_p_antenna_m - self._covered(w_T_b)
        return exact_agreement(off_m, self.fixes.each_std_m, map_std_m).without(self.stale)

    def _covered(self, w_T_b: Array) -> Array:
        """Return the antenna's position (n, 3) on the map at each fix that is compared, else NaN."""
        here_m = self.fixes.on_map(self.stamps_s, w_T_b)
        here_m[self.stale] = np.nan
        return here_m

    def map_std_m(self, w_T_b: Array, covariances: Array, unused: NDArray[np.bool_]) -> Array:
        """Return standard deviations (n, 3) of the antenna on the map at fixes that it does not use, and 0 at
        the others; ``covariances`` (m, 3, 3) are those of the antenna at the poses, in the axes of the world.
        Where one is unknown (NaN), so is the deviation of a fix at it.

        An antenna whose place nobody stated moves the map as a whole at one heading. At another heading it
        differs from that as the attitude does from those of the fixes that the map uses.
        """
        std_m = np.zeros((len(unused), 3))
        if not unused.any() or unused.all():
            return std_m
        near = nearest(self.stamps_s, self.fixes.stamps_s)
        R = w_T_b[near, :3, :3]
        turned = R - R[~unused].mean(axis=0)
        antenna_m = NOMINAL_ANTENNA_STD_M if self.fixes.assumes_antenna_place else 0.0
        total = covariances[near] + antenna_m**2 * turned @ np.swapaxes(turned, 1, 2)
        std_m[unused] = np.sqrt(np.diagonal(total, axis1=1, axis2=2))[unused]
        return std_m

    def of_keyframes(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (n,) the fixes that are nearest in time to the keyframes ``which`` (m,)."""
        return which[nearest(self.stamps_s, self.fixes.stamps_s)]

    def messages(self, agreement: Agreement, step: PositionStep | None = None) -> FixMessages:
        """Return remarks and warnings about the fixes, and about a ``step`` that the refinement shows."""
        found, names = fix_messages(self.fixes, agreement), self.fixes.names
        if step is not None:
            aside = step_warning(step, self.fixes, self.stamps_s)
            found = replace(found, warnings=(*found.warnings, aside))
        if self.moved_m is None or not (line := stale_line(names, self.moved_m)):
            return found
        left_out = (*found.left_out, *(names[k] for k in np.flatnonzero(self.stale).tolist()))
        if line.kind is Kind.NOTE:
            return FixMessages((*found.remarks, line), found.warnings, left_out)
        return FixMessages(found.remarks, (line, *found.warnings), left_out)

    def contradictions(self, agreement: Agreement, w_T_b: Array) -> list[Contradiction]:
        """Compare the stated or assumed accuracy with refined poses ``w_T_b`` (m, 4, 4)."""
        fixes, high = self.fixes, agreement.altitude_used & np.isfinite(agreement.off_m[:, 2])
        # Fixes that state more than is typical are no evidence for what the others state.
        high &= fixes.each_std_m[:, 2] <= fixes.std_m[2]
        covered = np.isfinite(agreement.off_m[:, 0])
        on_map = self._on_map(agreement, w_T_b, agreement.used & covered)
        # One lane of mirrored fixes agrees with the map by itself: the other lanes are those not used.
        across = mirror_contradiction(on_map) or mirror_contradiction(self._on_map(agreement, w_T_b, covered))
        if across is None:
            across = stated_accuracy_contradiction(on_map, fixes.std_m, fixes.stated)
        up = altitude_contradiction(agreement.off_m[high, 2], fixes.std_m[2], fixes.stated)
        if up is None and not fixes.stated:  # a small drift stands out of an accuracy that is only assumed
            up = self._altitude_course(agreement, w_T_b, high)
        return [each for each in (across, up) if each is not None]

    def _altitude_course(
        self, agreement: Agreement, w_T_b: Array, high: NDArray[np.bool_]
    ) -> Contradiction | None:
        """Return how the altitudes of the fixes ``high`` (n,) drift or step, whose accuracy is assumed."""
        fixes = self.fixes
        names = [fixes.names[k] for k in np.flatnonzero(high).tolist()]
        here_m = fixes.on_map(self.stamps_s, w_T_b)[high, :2]
        altitudes = AltitudesOnMap(agreement.off_m[high, 2], here_m, fixes.stamps_s[high], names)
        return altitude_course_contradiction(altitudes, fixes.std_m[2])

    def _on_map(self, agreement: Agreement, w_T_b: Array, chosen: NDArray[np.bool_]) -> FixesOnMap:
        """Return the ``chosen`` (n,) fixes on the map, without those less accurate than is typical."""
        used = chosen & (self.fixes.each_std_m[:, :2] <= self.fixes.std_m[:2]).all(axis=1)
        here_m = self.fixes.on_map(self.stamps_s, w_T_b)[used, :2]
        at_s = self.fixes.stamps_s[used]
        w_R_b = w_T_b[nearest(self.stamps_s, at_s), :3, :3]
        moving = len(at_s) > 1 and bool((np.diff(at_s) > 0).all())
        velocity_m_s = np.gradient(here_m, at_s, axis=0) if moving else np.zeros_like(here_m)
        names = tuple(self.fixes.names[k] for k in np.flatnonzero(used).tolist())
        return FixesOnMap(agreement.off_m[used, :2], here_m, w_R_b, velocity_m_s, names)
