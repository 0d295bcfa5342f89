"""Errors over time of what a model predicts, started anew from the readings every two seconds.

A replay predicts the readings of a flight with commands. In one without, gyro and accelerometer predict
those of the other instruments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, VERMILLION, grid
from slam.core.units import everyday
from slam.report.criticism.plain_names import figure, reading
from slam.report.criticism.segment import CLIPPED_SHARE, RESTART_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.core.flight import Flight
    from slam.data_quality.inertial_comparison import IntegralComparison
    from slam.simulation.model import Model
    from slam.simulation.replay import Comparison

Array = NDArray[np.float64]

SHOWN_S = 20.0
"""Length of a segment: ten predictions."""
FEWEST_KNOWN = 0.8
"""Least share of the moments of a segment with a known error."""


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of one prediction, which starts anew every ``RESTART_S``."""

    stamps_s: Array
    """(n,)."""
    off: Array
    """(n,) reading less prediction; NaN where there is none."""
    restart_s: float = 0.0
    """Time of a restart; the others lie ``RESTART_S`` apart, before and after it."""

    def within(self, begin_s: float, end_s: float) -> PredictionErrors:
        """Return the errors between two times."""
        inside = (self.stamps_s >= begin_s) & (self.stamps_s < end_s)
        return replace(self, stamps_s=self.stamps_s[inside], off=self.off[inside])

    @property
    def rms(self) -> float:
        """Root mean square of the known errors; NaN without any."""
        known = self.off[np.isfinite(self.off)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan

    def worst(self) -> tuple[float, float]:
        """Return the largest mean error over ``SHOWN_S``, and where that begins; single outliers are
        clipped."""
        known = np.isfinite(self.off)
        if not known.any():
            return -np.inf, 0.0
        size = np.where(known, np.abs(self.off), 0.0)
        size = np.minimum(size, np.quantile(size[known], 1.0 - CLIPPED_SHARE))
        since_s = np.ceil((self.stamps_s[0] - self.restart_s) / RESTART_S) * RESTART_S
        first = self.restart_s + since_s
        begins = np.arange(first, max(self.stamps_s[-1] - SHOWN_S, first) + 1e-9, RESTART_S)
        found = []
        for begin_s in begins:
            rows = slice(*np.searchsorted(self.stamps_s, [begin_s, begin_s + SHOWN_S]))
            whole = known[rows].mean() > FEWEST_KNOWN if rows.stop > rows.start else False
            found.append((float(size[rows].mean()) if whole else -np.inf, float(begin_s)))
        return max(found)


@dataclass(frozen=True)
class BeforeAndAfter:
    """Errors of one channel by two models."""

    channel: str
    """Channel in words."""
    unit: str
    before: PredictionErrors
    after: PredictionErrors
    replayed: str = ""
    """Channel of the replay; empty where instruments are compared."""

    @property
    def falls_to(self) -> float:
        """Ratio of the errors, after over before."""
        return self.after.rms / self.before.rms if self.before.rms > 0.0 else np.nan

    def draw(self, axes: Axes, begin_s: float, labels: tuple[str, str]) -> str:
        """Draw both errors over ``SHOWN_S``, and return their sizes in words."""
        shown = [errors.within(begin_s, begin_s + SHOWN_S) for errors in (self.before, self.after)]
        factor, unit = everyday(max(errors.rms for errors in shown), self.unit)
        for errors, label, colour in zip(shown, labels, (VERMILLION, BLUE), strict=True):
            at = np.flatnonzero(np.diff((errors.stamps_s - errors.restart_s) // RESTART_S)) + 1
            line = np.insert(errors.stamps_s, at, np.nan), factor * np.insert(errors.off, at, np.nan)
            axes.plot(*line, color=colour, linewidth=1.2, label=label)
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_ylabel(f"error [{unit}]", fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        grid(axes)
        before, after = (f"{figure(factor * errors.rms)} {unit}" for errors in shown)
        return f"{before} before, {after} after"


def errors_by_channel(flight: Flight, before: Model | None, after: Model) -> list[BeforeAndAfter]:
    """Return the errors of every channel by two models; without the first, those of the readings as
    recorded."""
    if flight.command is None:
        return _of_integrals(flight, before, after)
    assert before is not None
    return _of_replays(flight, before, after)


def _of_replays(flight: Flight, before: Model, after: Model) -> list[BeforeAndAfter]:
    from slam.simulation.replay import replay

    each = [replay(flight, model, (RESTART_S,)) for model in (before, after)]
    restart_s = float(each[0].restarts_s[0]) if len(each[0].restarts_s) else 0.0

    def errors(one: Comparison) -> PredictionErrors:
        return PredictionErrors(one.stamps_s, one.measured - one.restarted, restart_s)

    return [
        BeforeAndAfter(reading(old.name), old.unit, errors(old), errors(new), old.name)
        for old, new in zip(*(one.channels for one in each), strict=True)
        if old.noise_std > 0.0 and not old.name.startswith("imu.")
    ]


def _of_integrals(flight: Flight, before: Model | None, after: Model) -> list[BeforeAndAfter]:
    from slam.data_quality.inertial_comparison import CHANNELS, comparisons, near_floor
    from slam.simulation.inverse.correct import correct_flight

    low_s = near_floor(flight)
    old, new = (
        dict(comparisons(flight if model is None else correct_flight(flight, model).flight))
        for model in (before, after)
    )
    return [
        BeforeAndAfter(name, unit, integral_errors(old[kind], k, low_s), integral_errors(new[kind], k, low_s))
        for kind, channels in CHANNELS.items()
        if kind in old and kind in new
        for k, (name, unit) in enumerate(channels)
    ]


def integral_errors(seen: IntegralComparison, k: int, low_s: Array) -> PredictionErrors:
    """Return the errors from each start on; of a second integral, whose first rate nothing measures, beside
    the line through the start and the middle. Near the floor there are none."""
    from slam.data_quality.inertial_comparison import ABOUT_S

    stamps, off = seen.stamps_s, seen.off[:, k]
    errors = np.full(len(stamps), np.nan)

    def at(time_s: float) -> float:
        rows = slice(*np.searchsorted(stamps, [time_s - ABOUT_S, time_s + ABOUT_S]))
        about, later_s = off[rows], stamps[rows] - time_s
        if len(about) < 2:
            return np.nan
        # Over a flight a second integral grows to a slope of tens of metres a second: a mean of readings that
        # lie unevenly about the moment would be off by metres.
        at_moment, _slope = np.polynomial.polynomial.polyfit(later_s, about, 1)
        return float(at_moment) if later_s[0] <= 0 <= later_s[-1] else np.nan

    for begin_s in np.arange(np.ceil(stamps[0] / RESTART_S) * RESTART_S, stamps[-1] - RESTART_S, RESTART_S):
        low = np.searchsorted(low_s, begin_s + RESTART_S) > np.searchsorted(low_s, begin_s)
        rows = slice(*np.searchsorted(stamps, [begin_s, begin_s + RESTART_S]))
        if low or rows.stop - rows.start < 2:
            continue
        ends = at(begin_s), at(begin_s + RESTART_S / 2)
        rate = (ends[1] - ends[0]) / (RESTART_S / 2) if seen.order == 2 else 0.0
        errors[rows] = off[rows] - ends[0] - rate * (stamps[rows] - begin_s)
    return PredictionErrors(stamps, errors)
