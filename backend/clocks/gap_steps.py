"""Lost time in a gap of one stream, told from a clock that was set forward there.

Both leave the same gap. The motion tells them apart: a second stream without that gap shows the same motion
after it. Readings after a gap in which the clock was set fit it only once the gap is closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.clocks.delay_residuals import DelayResiduals, turn_costs
from backend.clocks.picture_clock import LEAST_TURNS, NOTABLE_S, variation

Array = NDArray[np.float64]

LONGEST_LAG_S = 0.5
"""Longest constant delay between the two streams that is looked for besides the gap; ten times what filters
and transfer cause in instruments of one vehicle."""
_LONGEST_PAUSE = 1.5
"""Median intervals beyond which an interval is a gap: one reading at least is missing."""
_MOST_GAPS = 8
"""Gaps of a stream that are tried, the longest first."""
_SURE = 4.0
"""Standard deviations between the two explanations of a gap. Where d of them part both, the difference of
their costs is normal with mean d² and standard deviation 2 d, so that a gap without a step exceeds the square
of this with a probability of 3e-5 at most; that is 5e-4 for all gaps of two streams."""
_FILLED = 0.5
"""Share of a gap that the other stream must have recorded."""


@dataclass(frozen=True)
class StampGap:
    """A pause in the stamps of one stream while the other one goes on."""

    last_s: float
    """Stamp of the last reading before it."""
    lost_s: float
    """Its excess over the usual interval."""

    def is_filled_by(self, other_s: Array) -> bool:
        """Return whether the sorted stamps (m,) of another stream go on in most of the gap."""
        end_s = self.last_s + self.lost_s
        within = other_s[(other_s > self.last_s) & (other_s < end_s)]
        longest_s = float(np.diff(np.concatenate([[self.last_s], within, [end_s]])).max())
        return longest_s < (1 - _FILLED) * self.lost_s

    def closed(self, stamps_s: Array) -> Array:
        """Return stamps (n,) of the same stream as if no time had passed."""
        return np.where(stamps_s > self.last_s, stamps_s - self.lost_s, stamps_s)

    def opened(self, stamps_s: Array) -> Array:
        """Return stamps (n,) of the other stream with the same gap, which leaves the first as it is."""
        return np.where(stamps_s > self.last_s, stamps_s + self.lost_s, stamps_s)


def gaps_of_one(stamps_s: Array, other_s: Array) -> list[StampGap]:
    """Return the longest gaps of sorted stamps (n,) that the stamps (m,) of another stream fill."""
    steps = np.diff(stamps_s)
    usual_s = float(np.median(steps)) if len(steps) else np.inf
    found = []
    for k in np.argsort(-steps, kind="stable")[:_MOST_GAPS].tolist():
        gap = StampGap(float(stamps_s[k]), float(steps[k]) - usual_s)
        if steps[k] < _LONGEST_PAUSE * usual_s or gap.lost_s < NOTABLE_S:
            break
        if gap.is_filled_by(other_s):
            found.append(gap)
    return found


def is_step(gap: StampGap, before: DelayResiduals | None, after: DelayResiduals | None) -> bool:
    """Return whether the motion fits surely better ``after`` the gap was closed than ``before``.

    Both hold the same moments under the same stamps where they have them in common; only these count.
    """
    if before is None or after is None:
        return False
    _, of_before, of_after = np.intersect1d(before.begin_s, after.begin_s, return_indices=True)
    # Nothing is known of the motion in the gap itself.
    begin_s, end_s = after.begin_s[of_after], after.end_s[of_after]
    apart = (begin_s - LONGEST_LAG_S > gap.last_s) | (end_s + LONGEST_LAG_S < gap.last_s)
    of_before, of_after = of_before[apart], of_after[apart]
    if len(of_before) < 2 * LEAST_TURNS:
        return False
    before, after = before.part(of_before), after.part(of_after)
    # Costs compare under one kind of noise only; which one is right is not known beforehand.
    later = after.begin_s > gap.last_s
    return all(_is_better(before, after, ratios, later) for ratios in (before.ratios, after.ratios))


def _is_better(
    before: DelayResiduals, after: DelayResiduals, ratios: tuple[float, ...], later: NDArray[np.bool_]
) -> bool:
    """Compare the costs of turns, of which the ``later`` (n,) are those that a step moves."""
    costs = [turn_costs(each.squares_with(ratios)) for each in (before, after)]
    least = [cost[:, int(cost.sum(axis=0).argmin())] for cost in costs]
    excess = least[0] - least[1]
    total = float(excess.sum())
    # Turns before the gap fit both, so that only later ones vary for the reason in question.
    varies = float(variation(excess, excess[later]))
    return total > _SURE**2 and 4 * total**2 > _SURE**2 * varies
