"""Before and after for flights without commands: what gyro and accelerometer predict of other instruments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, VERMILLION, grid, png
from slam.core.units import everyday
from slam.report.criticism.plain_names import figure as figures
from slam.report.criticism.segment import CLIPPED_SHARE, RESTART_S, Segment

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.data_quality.inertial_comparison import IntegralComparison

Array = NDArray[np.float64]

SHOWN_S = 20.0
"""Length of the segment: ten predictions."""
MOST_PANELS = 3


@dataclass(frozen=True)
class _Errors:
    """Errors of one prediction, which starts anew every ``RESTART_S``."""

    stamps_s: Array
    """(n,)."""
    off: Array
    """(n,) reading less prediction; NaN where there is none."""

    def within(self, begin_s: float, end_s: float) -> _Errors:
        """Return the errors between two times."""
        inside = (self.stamps_s >= begin_s) & (self.stamps_s < end_s)
        return _Errors(self.stamps_s[inside], self.off[inside])

    @property
    def rms(self) -> float:
        """Root mean square of the known errors."""
        return float(np.sqrt(np.nanmean(self.off**2)))


@dataclass(frozen=True)
class _Pair:
    """Errors of one channel as recorded, and as the extended model corrects the readings."""

    channel: str
    unit: str
    before: _Errors
    after: _Errors


def compared_segment(result: Criticism, flights: Sequence[Flight]) -> Segment | None:
    """Return the segment in which the channel that gains most has its largest error as recorded, with the
    other kinds of channels that gain; None for flights with commands, or where nothing gains."""
    names = _channels(result)
    judged = [f for f in flights if f.name in result.flights and f.command is None]
    if not names or not judged or result.extended is None:
        return None
    tried = [(flight, pairs) for flight in judged if (pairs := _pairs(flight, result, names))]
    each = [
        (*_worst(pairs[0].before), flight, pairs) for flight, pairs in tried if pairs[0].channel == names[0]
    ]
    if not each:
        return None
    _, begin_s, flight, pairs = max(each, key=lambda one: one[0])
    return _drawn(flight, pairs, begin_s)


def _channels(result: Criticism) -> list[str]:
    """Return the judged channels that gain by more than a misfit, the best of each kind, the best first."""
    from slam.criticism.search.thresholds import MISFIT
    from slam.criticism.without_commands.whitened_rows import CHANNELS

    kinds = {name: kind for kind, channels in CHANNELS.items() for name, _ in channels}
    gain = result.causes[0].gain if result.causes else None
    best: dict[str, str] = {}
    for error in sorted(gain.judged if gain else (), key=lambda e: e.after / e.before if e.before else 1.0):
        if error.channel in kinds and error.after < (1.0 - MISFIT) * error.before:
            best.setdefault(kinds[error.channel], error.channel)
    return list(best.values())[:MOST_PANELS]


def _pairs(flight: Flight, result: Criticism, names: Sequence[str]) -> list[_Pair]:
    from slam.criticism.without_commands.whitened_rows import CHANNELS
    from slam.data_quality.inertial_comparison import comparisons, near_floor
    from slam.simulation.inverse.correct import correct_flight

    assert result.extended is not None
    low_s = near_floor(flight)
    before, after = (dict(comparisons(of)) for of in (flight, correct_flight(flight, result.extended).flight))
    pairs = []
    for name in names:
        kind, k, unit = next(
            (kind, k, unit)
            for kind, channels in CHANNELS.items()
            for k, (channel, unit) in enumerate(channels)
            if channel == name
        )
        if kind in before and kind in after:
            pairs.append(_Pair(name, unit, _errors(before[kind], k, low_s), _errors(after[kind], k, low_s)))
    return pairs


def _errors(seen: IntegralComparison, k: int, low_s: Array) -> _Errors:
    """Return the errors from each start on; of a second integral, whose first rate nothing measures, beside
    the line through the start and the middle. Near the floor there are none."""
    from slam.data_quality.inertial_comparison import ABOUT_S

    stamps, off = seen.stamps_s, seen.off[:, k]
    errors = np.full(len(stamps), np.nan)

    def mean(time_s: float) -> float:
        about = off[np.searchsorted(stamps, time_s - ABOUT_S) : np.searchsorted(stamps, time_s + ABOUT_S)]
        return float(np.mean(about)) if len(about) else np.nan

    for begin_s in np.arange(np.ceil(stamps[0]), stamps[-1] - RESTART_S, RESTART_S):
        low = np.searchsorted(low_s, begin_s + RESTART_S) > np.searchsorted(low_s, begin_s)
        rows = slice(*np.searchsorted(stamps, [begin_s, begin_s + RESTART_S]))
        if low or rows.stop - rows.start < 2:
            continue
        ends = mean(begin_s), mean(begin_s + RESTART_S / 2)
        rate = (ends[1] - ends[0]) / (RESTART_S / 2) if seen.order == 2 else 0.0
        errors[rows] = off[rows] - ends[0] - rate * (stamps[rows] - begin_s)
    return _Errors(stamps, errors)


def _worst(errors: _Errors) -> tuple[float, float]:
    """Return the largest mean error over ``SHOWN_S``, and where that begins; single outliers are clipped."""
    known = np.isfinite(errors.off)
    if not known.any():
        return -np.inf, 0.0
    size = np.where(known, np.abs(errors.off), 0.0)
    size = np.minimum(size, np.quantile(size[known], 1.0 - CLIPPED_SHARE))
    first = np.ceil(errors.stamps_s[0])
    begins = np.arange(first, max(errors.stamps_s[-1] - SHOWN_S, first) + 1e-9, RESTART_S)
    found = []
    for begin_s in begins:
        rows = slice(*np.searchsorted(errors.stamps_s, [begin_s, begin_s + SHOWN_S]))
        whole = known[rows].mean() > 0.8 if rows.stop > rows.start else False
        found.append((float(size[rows].mean()) if whole else -np.inf, float(begin_s)))
    return max(found)


def _drawn(flight: Flight, pairs: Sequence[_Pair], begin_s: float) -> Segment:
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(7.2, 0.8 + 1.25 * len(pairs)), dpi=160, layout="constrained")
    end_s, told = begin_s + SHOWN_S, []
    for axes, pair in zip(np.ravel(drawn.subplots(len(pairs), 1, sharex=True)), pairs, strict=True):
        shown = [errors.within(begin_s, end_s) for errors in (pair.before, pair.after)]
        factor, unit = everyday(max(errors.rms for errors in shown), pair.unit)
        for errors, label, colour in zip(
            shown, ("as recorded", "corrected by the extended model"), (VERMILLION, BLUE), strict=True
        ):
            at = np.flatnonzero(np.diff((errors.stamps_s - begin_s) // RESTART_S)) + 1
            line = np.insert(errors.stamps_s, at, np.nan), factor * np.insert(errors.off, at, np.nan)
            axes.plot(*line, color=colour, linewidth=1.2, label=label)
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_ylabel(f"error [{unit}]", fontsize=8)
        axes.set_title(pair.channel, fontsize=9, loc="left")
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        grid(axes)
        rms = [f"{figures(factor * errors.rms)} {unit}" for errors in shown]
        told.append(f"{pair.channel} {rms[0]} before, {rms[1]} after")
    drawn.axes[-1].set_xlabel(f"time in {flight.name} [s]", fontsize=9)
    handles, labels = drawn.axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    caption = (
        f"Error of what gyro or accelerometer alone predicts of another instrument's reading, started anew "
        f"from that reading every {RESTART_S:g} s, where the lines break. The corrections are those of all "
        f"causes together, fitted to the whole flight, this stretch among it. Root mean square over the "
        f"{SHOWN_S:g} s: {'; '.join(told)}."
    )
    return Segment(
        "Before and after", png(drawn), caption,
        f"“Before and after” shows {begin_s:.0f} to {end_s:.0f} s of {flight.name}, where the error of "
        f"{pairs[0].channel} is largest.",
    )  # fmt: skip
