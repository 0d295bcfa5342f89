"""The verdicts on the fixes of one part of the map, from one refinement to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.mapping.gps.consensus import Agreement

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FixVerdicts:
    """The verdict that the next refinement follows, and what earlier ones have shown."""

    agreement: Agreement
    doubted: Mask
    """(n,) fixes that were left out once because the pictures contradicted their keyframes."""
    called_back: Mask
    """(n, 2) fixes, and their altitudes, that were used again after a refinement without them."""

    @classmethod
    def first(cls, agreement: Agreement) -> FixVerdicts:
        """Return the verdict before any refinement."""
        n = len(agreement.used)
        return cls(agreement, np.zeros(n, bool), np.zeros((n, 2), bool))

    def after(self, found: Agreement, contradicted: Mask) -> FixVerdicts:
        """Return the verdict after a refinement that followed this one.

        ``found`` is the comparison of all fixes with the refined map. Fixes at keyframes that the pictures
        have ``contradicted`` (n,) are compared once more with a map that does not use them: a precise fix
        that is wrong can hold its keyframe, and then agrees with the map.

        A fix can agree with a map that is uncertain without it, and contradict one that uses it. Once it has
        been called back and contradicts the map, it stays out.
        """
        before = self.agreement
        newly_doubted = before.used & contradicted & ~self.doubted
        now, was = _masks(found), _masks(before)
        known = now & ~(self.called_back & ~was)
        next_one = Agreement(known[:, 0] & ~newly_doubted, known[:, 1] & ~newly_doubted, found.off_m)
        return FixVerdicts(
            next_one, self.doubted | newly_doubted, self.called_back | (_masks(next_one) & ~was)
        )


def _masks(agreement: Agreement) -> Mask:
    return np.stack([agreement.used, agreement.altitude_used], axis=1)
