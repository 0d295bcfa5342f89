"""The pictures of a criticism: the worst stretch before and after, the ranking, the gain part by part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.drawing import BLUE, GREEN, GREY, ORANGE, VERMILLION, canvas, legend_below, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.criticism.verdict.covariate import Covariate, Misses
    from slam.criticism.verdict.criticism import ChannelCheck, Criticism, Gain
    from slam.flight import Flight
    from slam.simulation.model import Model

Array = NDArray[np.float64]

STRETCH_S = 10.0
ANEW_S = 2.0
"""Roll-outs of this length, one after the other."""
FEWEST_SAMPLES = 20
STRAY_SHARE = 0.02
MOST_BARS = 12
MOST_FLIGHTS = 20
"""Flights that are searched for the worst stretch."""
CHECKS_A_ROW = 6
COVARIATE_BINS, FEWEST_IN_BIN = 12, 3
MOST_DOTS = 1500
SHOWN_SHARE = 0.005
"""Of the values at either end is left out of a drawing's axes: one stray reading squeezes all others."""


@dataclass(frozen=True)
class Stretch:
    """A drawn stretch of a flight."""

    picture: bytes
    caption: str


@dataclass(frozen=True)
class _Found:
    miss: float
    """Of the model as it was: its mean, in standard deviations of the noise."""
    flight: str
    channel: str
    unit: str
    stamps_s: Array
    measured: Array
    before: Array
    after: Array


REPLAYED = {
    "roll": "attitude.roll", "pitch": "attitude.pitch", "yaw": "attitude.yaw",
    "velocity_x": "velocity.v_x", "velocity_y": "velocity.v_y", "range": "sonar.range",
}  # fmt: skip
"""Names of criticism's channels in a replay."""


def before_after_picture(
    model: Model,
    extended: Model,
    flights: Sequence[Flight],
    channel: str | None = None,
    unseen: Mapping[str, Model] | None = None,
) -> Stretch | None:
    """The stretch that the model misses most, as measured and as both models fly it: of one ``channel`` of
    the replay, or of all that are the vehicle's own instruments.

    ``unseen``: by the flight's name, the extension as fitted on the other flights.
    """
    from slam.errors import InputError
    from slam.replay import replay

    best: _Found | None = None
    for flight in flights[:MOST_FLIGHTS]:
        try:
            after = (unseen or {}).get(flight.name, extended)
            pair = replay(flight, model, (ANEW_S,)), replay(flight, after, (ANEW_S,))
        except InputError:
            continue  # a flight without commands has no replay
        for old, new in zip(pair[0].channels, pair[1].channels, strict=True):
            if channel is not None and old.name != channel:
                continue
            if old.name.startswith("imu.") or (channel is None and old.noise_std <= 0):
                continue  # noise of an imu hides what the eye should see; a truth's figures have no scale
            found = _worst(flight.name, old.name, old.unit, old.noise_std, old.stamps_s, old.measured,
                           old.restarted, new.restarted)  # fmt: skip
            if found is not None and (best is None or found.miss > best.miss):
                best = found
    if best is None:
        return None
    figure, axes = canvas(7.2, 3.2)
    time = best.stamps_s - best.stamps_s[0]
    axes.plot(time, best.measured, ".", color=GREY, markersize=3, label="measured")
    axes.plot(time, best.before, color=VERMILLION, linewidth=1.4, label=f"model {model.name}")
    axes.plot(time, best.after, color=BLUE, linewidth=1.4, label="extended model")
    axes.set_xlabel(f"time from {best.stamps_s[0]:.1f} s of {best.flight} [s]")
    axes.set_ylabel(f"{best.channel} [{best.unit}]")
    legend_below(axes)
    rms = [float(np.sqrt(np.nanmean((side - best.measured) ** 2))) for side in (best.before, best.after)]
    fitted = "; the extension was fitted on the other flights" if best.flight in (unseen or {}) else ""
    caption = (
        f"{best.channel} over the {STRETCH_S:g} s that the model misses most{fitted}. Both models get the "
        f"same commands and begin anew from the measured state every {ANEW_S:g} s; nothing else is fed back. "
        f"Error {rms[0]:.3g} {best.unit} before, {rms[1]:.3g} {best.unit} after."
    )
    return Stretch(png(figure), caption)


def _worst(
    flight: str, channel: str, unit: str, noise_std: float, stamps_s: Array, measured: Array,
    before: Array, after: Array,
) -> _Found | None:  # fmt: skip
    """The window of a channel that ``before`` misses most."""
    known = np.isfinite(measured) & np.isfinite(before) & np.isfinite(after)
    end = np.searchsorted(stamps_s, stamps_s + STRETCH_S)
    count = np.concatenate([[0], np.cumsum(known)])
    inside = count[end] - count[:-1]
    if inside.max(initial=0) < FEWEST_SAMPLES:
        return None
    off = np.where(known, np.abs(before - measured), 0.0) / (noise_std or 1.0)
    # One reading that is a second echo is not what the model misses.
    off = np.minimum(off, np.quantile(off[known], 1.0 - STRAY_SHARE))
    total = np.concatenate([[0.0], np.cumsum(off)])
    miss = np.where(inside >= 0.8 * inside.max(), (total[end] - total[:-1]) / np.maximum(inside, 1), -np.inf)
    k = int(np.argmax(miss))
    part = slice(k, int(end[k]))
    return _Found(
        float(miss[k]), flight, channel, unit, stamps_s[part], measured[part], before[part], after[part]
    )


def _ranges(flight: Flight) -> tuple[Array, Array]:
    assert flight.sonar is not None
    return flight.sonar.stamps_s, flight.sonar.range_m


def _picture_gaps(flight: Flight) -> tuple[Array, Array]:
    assert flight.frames is not None
    return flight.frames.stamps_s[1:], 1e3 * np.diff(flight.frames.stamps_s)


def _reading_gaps(flight: Flight) -> tuple[Array, Array]:
    stream = next(s for s in (flight.attitude, flight.velocity, flight.sonar, flight.imu) if s is not None)
    return stream.stamps_s[1:], 1e3 * np.diff(stream.stamps_s)


_RANGE = (_ranges, "sonar.range [m]", "What the sonar read")
SINGLE_READINGS = {
    "sonar_spikes": _RANGE,
    "sonar_quantisation": _RANGE,
    "sonar_dead_zone": _RANGE,
    "floor_steps": _RANGE,
    "dropped_frames": (_picture_gaps, "since the picture before [ms]", "How far pictures are apart"),
    "timestamp_jitter": (
        _reading_gaps,
        "since the reading before [ms]",
        "How far stamps are apart",
    ),
}
"""Terms that no roll-out shows -> what shows them, its axis, and the beginning of a caption."""


def single_readings_picture(term: str, flight: Flight) -> Stretch:
    """The ``STRETCH_S`` in which the readings that show a term differ most."""
    of_flight, label, what = SINGLE_READINGS[term]
    stamps_s, values = of_flight(flight)
    begins = np.arange(stamps_s[0], max(stamps_s[-1] - STRETCH_S, stamps_s[0]) + 1e-9, STRETCH_S / 2)
    inside = [(stamps_s >= begin) & (stamps_s <= begin + STRETCH_S) for begin in begins]
    spread = [float(np.nanstd(values[rows])) if np.isfinite(values[rows]).any() else -1.0 for rows in inside]
    rows = inside[int(np.argmax(spread))]
    figure, axes = canvas(7.2, 3.2)
    axes.plot(stamps_s[rows], values[rows], ".", color=VERMILLION, markersize=3)
    axes.set_xlabel(f"time in {flight.name} [s]")
    axes.set_ylabel(label)
    caption = (
        f"{what}, over the {STRETCH_S:g} s in which it differs most, in the flight that shows most of it."
    )
    return Stretch(png(figure), caption)


def covariate_picture(found: Covariate) -> bytes:
    """What is missed against what the leading cause makes of it, and against what its rival makes of it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.7 * len(found.against), 3.4), dpi=160, layout="constrained")
    for axes, misses in zip(np.ravel(figure.subplots(1, len(found.against))), found.against, strict=True):
        _draw_misses(axes, misses, found)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return png(figure)


def _draw_misses(axes: Axes, misses: Misses, found: Covariate) -> None:
    x, plain = misses.explained, misses.missed[""]
    some = np.unique(np.linspace(0, len(x) - 1, MOST_DOTS).astype(np.int64))
    axes.plot(x[some], plain[some], ".", color=GREY, markersize=3, alpha=0.5)
    low, high = np.quantile(x, [SHOWN_SHARE, 1.0 - SHOWN_SHARE])
    edges = np.linspace(low, high, COVARIATE_BINS + 1)
    bins = np.digitize(x, edges)
    full = [k for k in range(1, len(edges)) if np.sum(bins == k) >= FEWEST_IN_BIN]
    middle = [float(np.mean(x[bins == k])) for k in full]
    shown = [low, high, *np.quantile(plain, [SHOWN_SHARE, 1.0 - SHOWN_SHARE])]
    ways = (("", "without either", VERMILLION), (found.cause, f"with {_words(found.cause)}", BLUE),
            (found.rival, f"with {_words(found.rival)} instead", ORANGE))  # fmt: skip
    for name, label, colour in ways:
        if name in misses.missed and (name or colour == VERMILLION):
            means = [float(np.mean(misses.missed[name][bins == k])) for k in full]
            shown += means
            axes.plot(middle, means, "o-", color=colour, markersize=4, linewidth=1.4, label=label)
    axes.plot([low, high], [low, high], "--", color=GREY, linewidth=1, label="all of it explained")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_ylim(min(shown), max(shown))
    axes.locator_params(axis="x", nbins=4)
    unit = misses.unit
    axes.set_xlabel(f"what {_words(misses.cause)} says [{unit}]", fontsize=9)
    axes.set_ylabel(f"{_words(misses.channel)}: missed [{unit}]", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)


def _words(name: str) -> str:
    return name.replace("_", " ")


_IN_WORDS = {"nothing": "nothing is wrong", "unknown": "something unknown"}
"""Hypotheses that are no terms."""


def ranking_picture(result: Criticism) -> bytes:
    """Bars of probability and strength; ``nothing`` and ``unknown`` are always among them."""
    always = [r for r in result.ranking if r.name in _IN_WORDS]
    named = sorted((r for r in result.ranking if r not in always), key=lambda r: (-r.probability, -r.z))
    shown = (named[: MOST_BARS - len(always)] + always)[::-1]
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 0.6 + 0.28 * len(shown)), dpi=160, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = [_IN_WORDS.get(r.name, _words(r.name)) for r in shown]
    chosen = {cause.name for cause in result.causes}
    colours = [BLUE if r.name in chosen else ORANGE if r in always else GREY for r in shown]
    left.barh(names, [r.probability for r in shown], color=colours)
    left.set_xlim(0, 1)
    left.set_xlabel("probability")
    right.barh(names, [r.z for r in shown], color=colours)
    right.axvline(result.threshold, color=VERMILLION, linewidth=1, label=f"asked for: {result.threshold:.1f}")
    right.set_xlabel("stands out by [sigma]")
    right.legend(loc="lower right", frameon=False, fontsize=7)
    if max((r.z for r in shown), default=0.0) > 50:
        right.set_xscale("symlog", linthresh=5)
        right.xaxis.set_major_formatter("{x:g}")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    return png(figure)


def calibration_picture(checks: Sequence[ChannelCheck]) -> bytes:
    """For each channel, how many innovations lie in each tenth of what was told of them."""
    from matplotlib.figure import Figure

    rows = -(-len(checks) // CHECKS_A_ROW)
    figure = Figure(figsize=(7.2, 0.3 + 1.05 * rows), dpi=160, layout="constrained")
    all_axes = np.ravel(figure.subplots(rows, CHECKS_A_ROW, sharex=True, sharey=True, squeeze=False))
    for axes, check in zip(all_axes, checks, strict=False):
        tenths = np.array(check.tenths)
        axes.bar(np.arange(len(tenths)) + 0.5, len(tenths) * tenths, width=0.9, color=BLUE)
        axes.axhline(1.0, color=GREY, linewidth=0.8)
        axes.set_title(_words(check.channel), fontsize=7)
    for axes in all_axes:
        axes.set_ylim(0.0, 2.0)
        axes.tick_params(labelsize=6)
        axes.set_xticks([])
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_visible(bool(axes.patches))
    return png(figure)


def gain_picture(gain: Gain) -> bytes:
    """One dot for each part that was held out, or each flight."""
    figure, axes = canvas(3.6, 2.6)
    number = np.arange(1, len(gain.parts) + 1)
    colour = [GREEN if nats > 0 else VERMILLION for nats in gain.parts]
    axes.axhline(0.0, color=GREY, linewidth=1)
    axes.scatter(number, gain.parts, c=colour, s=28, zorder=3)
    axes.set_xticks(number)
    axes.set_xlabel(f"held-out {gain.by}" if gain.by else "flight")
    axes.set_ylabel("gain [nats]")
    return png(figure)
