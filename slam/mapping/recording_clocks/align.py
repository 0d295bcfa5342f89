"""The clock of one recording of a flight relative to that of another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.clocks.alignment import ClockAlignment, align_turns
from backend.clocks.lag_profile import finer_lag, lag_profile
from backend.clocks.picture_clock import SURE
from backend.significance import RIVAL_CHI_SQUARE
from slam.core.errors import InputError
from slam.core.units import with_error
from slam.mapping.recording_clocks.motion import RecordedMotion

Array = NDArray[np.float64]

_APART_S = 5.0
"""Speeds change over some seconds: a second lag so near is the same peak."""
_MOST_NAMED = 4


@dataclass(frozen=True)
class KnownClock:
    """How a recording's stamps become those of the reference."""

    lag_s: float
    """Stamp in the recording less that of the same moment in the reference, at ``middle_s``."""
    how: str
    """Source of the alignment: "turns of cam0 and imu0", or "given by --offset"."""
    middle_s: float = 0.0
    drift: float = 0.0
    lag_std_s: float | None = None
    """None where a user gave the lag."""
    drift_std: float | None = None
    """None where the drift is taken as zero."""
    turned: Array | None = None
    """(3, 3) rotation of the recording's body axes into the reference's; None where it is not determined."""
    turned_std_rad: float = np.inf
    steps: int = 0

    @staticmethod
    def of(found: ClockAlignment, how: str) -> KnownClock:
        """Return what the turns show."""
        return KnownClock(
            lag_s=found.lag_s,
            how=how,
            middle_s=found.middle_s,
            drift=found.drift,
            lag_std_s=found.lag_std_s,
            drift_std=found.drift_std,
            turned=found.b_R_m,
            turned_std_rad=float(found.mount_std_rad.max()),
            steps=found.steps,
        )

    def on_reference(self, stamps_s: Array) -> Array:
        """Return stamps (n,) of the recording on the clock of the reference."""
        return np.asarray(stamps_s - self.lag_s - self.drift * (stamps_s - self.middle_s))

    def begins(self) -> str:
        """Say when the recording begins after the reference, as ``--offset`` states it, and its drift."""
        at_s = float(self.on_reference(np.zeros(1))[0])
        text = f"begins {at_s:+.3f} s after it"
        if self.lag_std_s is not None:
            std_s = float(np.hypot(self.lag_std_s, (self.drift_std or 0.0) * self.middle_s))
            text = f"begins {with_error(at_s, std_s, '+')} s after it"
        if self.drift_std is not None:
            text += f", its clock drifts by {-1e6 * self.drift:+.0f} ± {1e6 * self.drift_std:.0f} ppm"
        return f"{text} ({self.how})"


def align(moved: RecordedMotion, reference: RecordedMotion, stream: str) -> KnownClock:
    """Find the clock of ``moved``; ``stream`` names it in the advice.

    Raises ``InputError`` where nothing ties the two clocks, or several lags fit as well.
    """
    first, second = moved.flight.name, reference.flight.name
    advice = f"give --offset {stream}=SECONDS, by which {first} begins after {second}"
    rivals: tuple[float, ...] = ()
    tried = []
    if reference.gyro is not None and moved.turns is not None:
        shown_by = "imu0" if reference.flight.imu is not None else "attitude0"
        how = f"turns of {moved.turns[0]} and {shown_by}"
        result = align_turns(moved.turns[1], reference.gyro)
        if result.found is not None:
            return KnownClock.of(result.found, how)
        tried.append(how)
        rivals = result.rivals_s
    if not rivals and moved.speed is not None and reference.speed is not None:
        how = f"speeds of {moved.speed[0]} and {reference.speed[0]}"
        found, rivals = _by_speed(moved, reference, how)
        if found is not None:
            return found
        tried.append(how)
    if rivals:
        named = ", ".join(f"{-lag_s:+.2f} s" for lag_s in rivals[:_MOST_NAMED])
        raise InputError(
            f"{first}: its clock fits that of {second} equally well at {len(rivals)} places, where it begins "
            f"{named} after it; {advice}"
        )
    what = " and ".join(tried) or "one has neither pictures, gyro, attitude, velocity nor GPS"
    raise InputError(
        f"{first}: nothing ties its clock to that of {second} (compared: {what}): the two overlap too "
        f"briefly, or the vehicle hardly moved; {advice}"
    )


def _by_speed(
    moved: RecordedMotion, reference: RecordedMotion, how: str
) -> tuple[KnownClock | None, tuple[float, ...]]:
    """Return the clock by the speeds, or the lags that fit equally well."""
    assert moved.speed is not None
    assert reference.speed is not None
    profile = lag_profile(moved.speed[1], reference.speed[1])
    lags_s = profile.peaks(_APART_S, _MOST_NAMED)
    best = float(profile.evidence.max(initial=0.0))
    if best < SURE**2:
        return None, ()
    near = np.interp(lags_s, profile.lags_s, profile.evidence)
    rivals = lags_s[near > best - RIVAL_CHI_SQUARE]
    if len(rivals) > 1:
        return None, tuple(rivals.tolist())
    mean_s, std_s = finer_lag(moved.speed[1], reference.speed[1], profile, float(lags_s[0]))
    return KnownClock(mean_s, how, lag_std_s=std_s), ()
