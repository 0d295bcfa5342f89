"""Positions beside the track that all instruments give together.

The filter gives each fix little weight, because the errors of neighbouring fixes are alike. Fixes of another
time, scale or direction, or a receiver that holds its last fix, then look like any error of fixes, and bend
the track.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from backend.quantiles import chi_square_limit
from slam.core.messages import Message, warning
from slam.core.units import length
from slam.inertial.instruments import InertialTrust, fixes_of_one_error

if TYPE_CHECKING:
    from backend.ekf.results import States
    from slam.inertial.filter_input import FilterInput

Array = NDArray[np.float64]

_CHANCE = 1e-5
"""Probability of a message about fixes whose errors are as large as they state."""
_LONGEST_STEP_S = 2.0
"""Poses farther apart do not show where the vehicle was between them."""


def fix_contradiction(
    inputs: FilterInput, states: States, at_s: Array, trust: InertialTrust
) -> Message | None:
    """Return a line where the fixes lie farther beside the track than they state; None otherwise.

    ``states`` are those at ``at_s`` (n,). A horizontal error that lasts as long as the filter assumes is
    drawn anew so often that its mean square follows a chi-square distribution.
    """
    fixes = inputs.readings.w_p_antenna_m
    if fixes is None or len(at_s) < 2:
        return None
    after = np.searchsorted(at_s, fixes.stamps_s).clip(1, len(at_s) - 1)
    inside = (fixes.stamps_s >= at_s[0]) & (fixes.stamps_s <= at_s[-1])
    inside &= at_s[after] - at_s[after - 1] < _LONGEST_STEP_S
    if not inside.any():
        return None
    track = CubicHermiteSpline(at_s, states.w_T_b[:, :2, 3], states.w_v_m_s[:, :2])
    lever = states.w_T_b[:, :2, :3] @ np.array(inputs.model.b_p_position_m)
    nearest = np.where(fixes.stamps_s - at_s[after - 1] < at_s[after] - fixes.stamps_s, after - 1, after)
    off_m = (fixes.values[:, :2] - track(fixes.stamps_s) - lever[nearest])[inside]
    many = fixes_of_one_error(fixes.stamps_s, trust)
    # What the noise was raised to, because the fixes do not fit, is no excuse for them.
    raised = inputs.adjustments.noise_factor.get("position", 1.0)
    std_m = (fixes.std[inside, :2] if fixes.std.ndim > 1 else fixes.std[:2]) / np.sqrt(many) / raised
    drawn = 2.0 * max(1.0, len(off_m) / many)
    excess = float(np.mean((off_m / std_m) ** 2))
    if excess * drawn <= chi_square_limit(_CHANCE, drawn):
        return None
    off, stated = float(np.sqrt((off_m**2).sum(axis=1).mean())), float(np.sqrt(2.0) * np.median(std_m))
    return warning(
        f"gps0 and the other instruments contradict each other: its fixes lie {length(off)} beside the "
        f"track, and {length(stated)} is stated",
        "check its clock, its datum and noise_std, and the axes and signs of attitude0 and velocity0",
    )
