"""Segment of a flight that a criticism shows: the largest misfit of the model, or the readings as
evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREY, VERMILLION, grid, legend_below, new_figure, png
from slam.core.units import everyday
from slam.report.criticism.plain_names import reading

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.core.flight import Flight
    from slam.criticism.verdict.criticism import Criticism
    from slam.simulation.model import Model
    from slam.simulation.replay import Comparison

Array = NDArray[np.float64]

SEGMENT_S = 10.0
"""Length of the drawn part of a flight."""
RESTART_S = 2.0
"""Length of consecutive roll-outs."""
FEWEST_SAMPLES = 20
CLIPPED_SHARE = 0.02
"""Share of the largest errors that is clipped: a single second echo is no misfit of the model."""
STICK_SAMPLES = 2000
"""Samples of the drawn stick: more than the picture has columns."""
_STICKS = {
    **dict.fromkeys(("pitch", "x", "v_x"), (0, "ahead")),
    **dict.fromkeys(("roll", "y", "v_y"), (1, "to the left")),
    **dict.fromkeys(("range", "z", "v_z"), (2, "up")), "yaw": (3, "that turns"),
}  # fmt: skip
"""Quantity of a replay's channel -> the stick that moves it."""
MOST_FLIGHTS = 20
"""Number of flights that are searched for the worst segment."""


@dataclass(frozen=True)
class Segment:
    """A drawn segment of a flight."""

    title: str
    picture: bytes
    caption: str
    where: str
    """Sentence on the flight and the time that it shows."""


@dataclass(frozen=True)
class _Misfit:
    size: float
    """Misfit of the original model: its mean, in standard deviations of the noise."""
    flight: str
    channel: str
    unit: str
    stamps_s: Array
    measured: Array
    before: Array
    after: Array
    restarts_s: Array

    def line_of(self, predicted: Array) -> tuple[Array, Array]:
        """Return the times, and predictions, with a break at every restart."""
        at = np.searchsorted(self.stamps_s, self.restarts_s)
        at = at[(at > 0) & (at < len(self.stamps_s))]
        return np.insert(self.stamps_s, at, np.nan), np.insert(predicted, at, np.nan)


def evidence_segment(result: Criticism, flights: Sequence[Flight]) -> Segment | None:
    """Return the segment with the largest misfit, of the channel that gains most on held-out data, or the
    single readings that show the cause."""
    if result.model is None or result.extended is None:
        return None
    if not result.causes:
        return _unexplained_segment(result.model, result.extended, result, flights)
    lead = result.causes[0]
    if lead.name in READINGS_OF:
        parts = lead.gain.parts
        most = int(np.argmax(parts)) if len(parts) == len(flights) else 0
        return readings_picture(lead.name, flights[most]) if flights else None
    foremost = lead.gain.foremost
    channel = REPLAYED.get(foremost.channel) if foremost else None
    return before_after_picture(result.model, result.extended, flights, channel, result.unseen)


def _unexplained_segment(
    model: Model, extended: Model, result: Criticism, flights: Sequence[Flight]
) -> Segment | None:
    """Return the segment with the largest misfit of the reading that no effect explains; None where it is
    none of the replay, or where nothing is left over."""
    channels = (pattern.channel for pattern in result.patterns[:1] if result.findings)
    channel = REPLAYED.get(next(channels, ""))
    return before_after_picture(model, extended, flights, channel, result.unseen) if channel else None


REPLAYED = {
    "roll": "attitude.roll", "pitch": "attitude.pitch", "yaw": "attitude.yaw",
    "velocity_x": "velocity.v_x", "velocity_y": "velocity.v_y", "range": "sonar.range",
    "force ahead": "velocity.v_x", "force left": "velocity.v_y", "force up": "sonar.range",
}  # fmt: skip
"""Names of criticism's channels, and of what is forced, in a replay."""


def before_after_picture(
    model: Model,
    extended: Model,
    flights: Sequence[Flight],
    channel: str | None = None,
    unseen: Mapping[str, Model] | None = None,
) -> Segment | None:
    """Return the segment with the largest misfit, as measured and as both models predict it.

    It is that of one ``channel`` of the replay, or of all that are the vehicle's own instruments. ``unseen``
    gives, by the flight's name, the extension as fitted on the other flights.
    """
    from slam.core.errors import InputError
    from slam.simulation.replay import replay

    best: _Misfit | None = None
    for flight in flights[:MOST_FLIGHTS]:
        try:
            after = (unseen or {}).get(flight.name, extended)
            pair = replay(flight, model, (RESTART_S,)), replay(flight, after, (RESTART_S,))
        except InputError:
            continue  # a flight without commands has no replay
        for old, new in zip(pair[0].channels, pair[1].channels, strict=True):
            if channel is not None and old.name != channel:
                continue
            if old.name.startswith("imu.") or (channel is None and old.noise_std <= 0):
                continue  # the noise of an imu hides the effect; a truth has no noise to scale by
            found = _worst(flight.name, old, new, pair[0].restarts_s)
            if found is not None and (best is None or found.size > best.size):
                best = found
    return None if best is None else _drawn_misfit(best, model.name, flights, best.flight in (unseen or {}))


def _drawn_misfit(best: _Misfit, model: str, flights: Sequence[Flight], is_unseen: bool) -> Segment:
    """Draw a segment as measured and as both models predict it, above the stick that moves it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.6), dpi=160, layout="constrained")
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    factor, unit = everyday(1.0, best.unit)
    axes.plot(best.stamps_s, factor * best.measured, ".", color=GREY, markersize=5, label="measured")
    for side, name, colour, width in (
        (best.before, f"model {model}", VERMILLION, 2.6),
        (best.after, "extended model", BLUE, 1.3),
    ):
        axes.plot(*best.line_of(factor * side), "-", color=colour, linewidth=width, label=name)
    axes.set_ylabel(f"{reading(best.channel)} [{unit}]", fontsize=9)
    own = next(flight for flight in flights if flight.name == best.flight)
    draw_stick(below, best.channel, own, best.stamps_s[0], best.stamps_s[-1])
    below.set_xlabel(f"time in {best.flight} [s]", fontsize=9)
    for panel in (axes, below):
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8)
        grid(panel)
    legend_below(axes)
    rms = [
        factor * float(np.sqrt(np.nanmean((side - best.measured) ** 2))) for side in (best.before, best.after)
    ]
    fitted = "on the other flights" if is_unseen else "to all data, this stretch among it"
    shown, length_s = reading(best.channel), float(np.ptp(best.stamps_s))
    caption = (
        f"{shown[0].upper()}{shown[1:]} over the {length_s:.1f} s with the model's largest error, above the "
        f"stick. The extended model has all causes; it was fitted {fitted}. Both models get the same "
        f"commands and restart from the measured state every {RESTART_S:g} s, where the lines break. Where "
        "one line is seen, both predict the same. Root mean square error over this stretch alone: "
        f"{rms[0]:.3g} {unit} before, {rms[1]:.3g} {unit} after."
    )
    between = f"{best.stamps_s[0]:.1f} to {best.stamps_s[-1]:.1f} s of {best.flight}"
    return Segment(
        "Before and after", png(figure), caption,
        f"“Before and after” shows {between}, where the model's error is largest.",
    )  # fmt: skip


def draw_stick(axes: Axes, channel: str, flight: Flight, begin_s: float, end_s: float) -> None:
    """Draw the stick that moves a channel of the replay between two times, as a share of full deflection."""
    k, way = _STICKS[channel.rpartition(".")[2]]
    command = flight.command
    assert command is not None
    time = np.linspace(begin_s, end_s, STICK_SAMPLES)
    place = np.searchsorted(command.stamps_s, time, side="right")
    axes.plot(time, np.append(0.0, command.stick[:, k])[place], color="black", linewidth=1.0)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.set_ylabel(f"stick {way}", fontsize=9)


def _worst(flight: str, old: Comparison, new: Comparison, restarts_s: Array) -> _Misfit | None:
    """The window of a channel in which the ``old`` model's prediction has its largest misfit."""
    stamps_s, measured, before, after = old.stamps_s, old.measured, old.restarted, new.restarted
    known = np.isfinite(measured) & np.isfinite(before) & np.isfinite(after)
    end = np.searchsorted(stamps_s, stamps_s + SEGMENT_S)
    count = np.concatenate([[0], np.cumsum(known)])
    inside = count[end] - count[:-1]
    if inside.max(initial=0) < FEWEST_SAMPLES:
        return None
    off = np.where(known, np.abs(before - measured), 0.0) / (old.noise_std or 1.0)
    # A single second echo is not a misfit of the model.
    off = np.minimum(off, np.quantile(off[known], 1.0 - CLIPPED_SHARE))
    total = np.concatenate([[0.0], np.cumsum(off)])
    error = np.where(inside >= 0.8 * inside.max(), (total[end] - total[:-1]) / np.maximum(inside, 1), -np.inf)
    # It begins with a roll-out, at the first reading after a restart.
    begins = np.unique(np.searchsorted(stamps_s, restarts_s))
    begins = begins[begins < len(stamps_s)]
    k = int(begins[np.argmax(error[begins])]) if len(begins) else int(np.argmax(error))
    # Behind the last whole roll-out there is no prediction to compare.
    shown = np.flatnonzero(known[k : end[k]])
    part = slice(k, k + int(shown[-1]) + 1)
    return _Misfit(
        size=float(error[k]), flight=flight, channel=old.name, unit=old.unit, stamps_s=stamps_s[part],
        measured=measured[part], before=before[part], after=after[part], restarts_s=restarts_s,
    )  # fmt: skip


def _ranges(flight: Flight) -> tuple[Array, Array]:
    assert flight.sonar is not None
    return flight.sonar.stamps_s, flight.sonar.range_m


def _range_changes(flight: Flight) -> tuple[Array, Array]:
    stamps_s, range_m = _ranges(flight)
    return stamps_s[1:], 1e3 * np.diff(range_m)


def _picture_gaps(flight: Flight) -> tuple[Array, Array]:
    assert flight.frames is not None
    return flight.frames.stamps_s[1:], 1e3 * np.diff(flight.frames.stamps_s)


def _reading_gaps(flight: Flight) -> tuple[Array, Array]:
    stream = next(s for s in (flight.attitude, flight.velocity, flight.sonar, flight.imu) if s is not None)
    return stream.stamps_s[1:], 1e3 * np.diff(stream.stamps_s)


@dataclass(frozen=True)
class _Readings:
    """Quantity of single readings that shows a term."""

    of: Callable[[Flight], tuple[Array, Array]]
    label: str
    """Label of its axis."""
    what: str
    """Beginning of a caption."""
    shown: float = 1.0
    """Quantile of the windows, by their scatter, that is shown: what is in all readings shows in the median
    one, where no rare large reading hides it."""


_RANGE = _Readings(_ranges, "height reading [m]", "What the height sensor read")
READINGS_OF = {
    "sonar_spikes": _RANGE,
    "sonar_quantisation": _Readings(
        _range_changes, "height reading less the one before [mm]",
        "How far height readings in a row are apart", 0.5,
    ),
    "sonar_dead_zone": _RANGE,
    "floor_steps": _RANGE,
    "dropped_frames": _Readings(_picture_gaps, "since the picture before [ms]", "How far pictures are apart"),
    "timestamp_jitter": _Readings(_reading_gaps, "since the reading before [ms]", "How far stamps are apart"),
}  # fmt: skip
"""Terms that no roll-out shows -> the quantity that shows them."""


def telling_readings(term: str, flight: Flight) -> tuple[Array, Array]:
    """Return stamps and values over ``SEGMENT_S`` of what shows a term, where they scatter most or as they
    mostly do."""
    stamps_s, values = READINGS_OF[term].of(flight)
    begins = np.arange(stamps_s[0], max(stamps_s[-1] - SEGMENT_S, stamps_s[0]) + 1e-9, SEGMENT_S / 2)
    inside = [(stamps_s >= begin) & (stamps_s <= begin + SEGMENT_S) for begin in begins]
    spread = [float(np.nanstd(values[rows])) if np.isfinite(values[rows]).any() else -1.0 for rows in inside]
    order = np.argsort(spread, kind="stable")
    rows = inside[int(order[round(READINGS_OF[term].shown * (len(order) - 1))])]
    return stamps_s[rows], values[rows]


def readings_picture(term: str, flight: Flight) -> Segment:
    """Draw the readings of a flight that show a term, over ``SEGMENT_S``."""
    stamps_s, values = telling_readings(term, flight)
    figure, axes = new_figure(7.2, 3.2)
    axes.plot(stamps_s, values, ".", color=VERMILLION, markersize=3)
    axes.set_xlabel(f"time in {flight.name} [s]")
    axes.set_ylabel(READINGS_OF[term].label)
    most = READINGS_OF[term].shown == 1.0
    where = "in which it differs most" if most else "that scatter as most of the flight does"
    caption = f"{READINGS_OF[term].what}, over {SEGMENT_S:g} s {where}, in the flight that shows most of it."
    begin, end = stamps_s[[0, -1]]
    return Segment(
        "What shows it", png(figure), caption,
        f"“What shows it” has {begin:.1f} to {end:.1f} s of {flight.name}{', where it shows most' * most}.",
    )  # fmt: skip
