"""The stretch of a flight that a criticism shows: what the model misses most, or the readings that tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, VERMILLION, legend_below, new_figure, png

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism.verdict.criticism import Criticism
    from slam.simulation.model import Model

Array = NDArray[np.float64]

STRETCH_S = 10.0
ANEW_S = 2.0
"""Roll-outs of this length, one after the other."""
FEWEST_SAMPLES = 20
STRAY_SHARE = 0.02
"""Of the readings: what the model misses is no more than in all others."""
MOST_FLIGHTS = 20
"""Flights that are searched for the worst stretch."""


@dataclass(frozen=True)
class Stretch:
    """A drawn stretch of a flight."""

    title: str
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


def telling_stretch(result: Criticism, flights: Sequence[Flight]) -> Stretch | None:
    """The stretch that the model misses most, of the channel that gains most on held-out data; or the single
    readings that show the cause."""
    if not result.causes or result.model is None or result.extended is None:
        return None
    lead = result.causes[0]
    if lead.name in READINGS_OF:
        parts = lead.gain.parts
        most = int(np.argmax(parts)) if len(parts) == len(flights) else 0
        return single_readings_picture(lead.name, flights[most]) if flights else None
    foremost = lead.gain.foremost
    channel = REPLAYED.get(foremost.channel) if foremost else None
    return before_after_picture(result.model, result.extended, flights, channel, result.unseen)


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
    from slam.core.errors import InputError
    from slam.simulation.replay import replay

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
    figure, axes = new_figure(7.2, 3.2)
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
    return Stretch("Before and after", png(figure), caption)


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
READINGS_OF = {
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
    of_flight, label, what = READINGS_OF[term]
    stamps_s, values = of_flight(flight)
    begins = np.arange(stamps_s[0], max(stamps_s[-1] - STRETCH_S, stamps_s[0]) + 1e-9, STRETCH_S / 2)
    inside = [(stamps_s >= begin) & (stamps_s <= begin + STRETCH_S) for begin in begins]
    spread = [float(np.nanstd(values[rows])) if np.isfinite(values[rows]).any() else -1.0 for rows in inside]
    rows = inside[int(np.argmax(spread))]
    figure, axes = new_figure(7.2, 3.2)
    axes.plot(stamps_s[rows], values[rows], ".", color=VERMILLION, markersize=3)
    axes.set_xlabel(f"time in {flight.name} [s]")
    axes.set_ylabel(label)
    caption = (
        f"{what}, over the {STRETCH_S:g} s in which it differs most, in the flight that shows most of it."
    )
    return Stretch("What shows it", png(figure), caption)
