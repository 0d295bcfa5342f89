"""Errors of the reported velocity as the refinement estimates them, and the warning about large ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from backend.bundle.reported.factor import BIAS, CHANNELS, GAINS, LAG, REPORTED
from backend.significance import SURE_SIGMAS
from backend.sparse_cholesky import SingularMatrixError
from slam.core.instrument_errors import VelocityErrors
from slam.core.messages import Message, note

_GAIN, _OFFSET_M_S, _FADING_M_S = 0.1, 0.1, 0.12
"""Errors that are worth a warning: as large as usual ones of on-board velocities, or twice as large."""


def velocity_errors(bundle: Bundle | None) -> VelocityErrors | None:
    """Return the errors; None where the refinement does not use the velocity."""
    if bundle is None or bundle.optimum.problem.reported is None:
        return None
    try:
        std = bundle.optimum.standard_deviations(REPORTED)
    except SingularMatrixError:
        return None
    value = bundle.optimum.values.atVector(REPORTED)
    noise, part = bundle.noise.reported, bundle.optimum.problem.reported
    jumps = np.array([np.zeros(CHANNELS), *part.jumps.values()]) * noise.error
    return VelocityErrors(
        gain=_pair(value[GAINS]),
        gain_std=_pair(std[GAINS]),
        offset_m_s=_pair(value[BIAS]),
        offset_std_m_s=_pair(std[BIAS]),
        lag_s=float(value[LAG]),
        lag_std_s=float(std[LAG]),
        fading_m_s=(noise.error[0], noise.error[1]),
        fading_time_s=(noise.time_s[0], noise.time_s[1]),
        jump_m_s=_pair(np.abs(jumps).max(axis=0)),
    )


def velocity_warning(found: VelocityErrors | None) -> Message | None:
    """Report large errors, which the map allows for; None where there are none."""
    if found is None:
        return None
    words = []
    for axis, name in enumerate(("forward", "left")):
        gain, gain_std = found.gain[axis], found.gain_std[axis]
        offset, offset_std = found.offset_m_s[axis], found.offset_std_m_s[axis]
        if abs(gain - 1) > max(_GAIN, SURE_SIGMAS * gain_std):
            words.append(f"{gain:.2f} ± {gain_std:.2g} times the speed {name}")
        if abs(offset) > max(_OFFSET_M_S, SURE_SIGMAS * offset_std):
            words.append(f"{offset:+.2f} ± {offset_std:.2g} m/s too much {name}")
        if found.fading_m_s[axis] > _FADING_M_S:
            words.append(f"± {found.fading_m_s[axis]:.2g} m/s {name} that change over the flight")
        if found.jump_m_s[axis] > _FADING_M_S:
            words.append(f"{found.jump_m_s[axis]:.2g} m/s more or less {name} from a picture on")
    line = (
        f"velocity0 reads {', '.join(words)}: the map allows for it, and other programs should not trust it"
    )
    return note(line) if words else None


def _pair(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
