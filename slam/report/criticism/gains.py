"""Gain of a criticism: errors of the prediction before and after its causes, and the parts that show
it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import either
from slam.core.units import everyday
from slam.report.criticism.plain_names import figure, reading, title_of
from slam.report.page import Item

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.cause import ChannelError, Gain

SHOWN_HORIZONS = {0.0: "picture to picture", 0.5: "0.5 s", 2.0: "2 s", 10.0: "10 s"}
HELD_OUT_DOTS = (
    "Log likelihood gained on each part when it was held out{beside}, in nats; above 0, it is predicted "
    "better."
)
IN_SAMPLE_DOTS = (
    "Log likelihood that each flight's odd readings tell for {cause}, in nats. Each of them tells by itself; "
    "no size is fitted that could be held out."
)


@dataclass(frozen=True)
class GainRow:
    """Table row of one channel over one horizon."""

    channel: str
    horizon: str
    before: str
    after: str
    change: str


def where_it_shows(result: Criticism, drawn: Sequence[str], each: Sequence[str] = ()) -> list[str]:
    """Return in how many flights the leading cause shows, in which most, and what the page shows of it; or
    the lines on ``each`` certain cause."""
    if each or not result.causes:
        return [*each, *drawn]
    gain, names = result.causes[0].gain, result.flights
    parts, better = np.array(gain.parts), better_parts(gain)
    text = f"{'in' if len(result.causes) > 1 else 'In'} {better}"
    if len(parts) < 2:
        text = f"In {names[0]}" if len(names) == 1 else ""
    elif len(parts) == len(names) and gain.by != "segment":
        most, least = names[int(np.argmax(parts))], names[int(np.argmin(parts))]
        text += f"; most in {most} ({parts.max():.0f} nats), least in {least} ({parts.min():.0f} nats)"
    elif len(names) == 1:
        text += f" of {names[0]}"
    who = f"{result.causes[0].name}: " if len(result.causes) > 1 and text else ""
    return [f"{who}{text}." if text else "", *drawn]


def better_parts(gain: Gain) -> str:
    """Return how many of the held-out parts a cause predicts better."""
    better, count = int(np.sum(np.array(gain.parts) > 0)), len(gain.parts)
    of = f"each of the {count}" if better == count > 1 else f"{better} of {count}"
    return f"{of} {'held-out parts' if gain.by == 'segment' else 'flights'}"


def what_changes(result: Criticism) -> list[str]:
    """Return the error before and after of the channel that gains most, and of those that became worse."""
    if not result.causes:
        return []
    gain = result.causes[0].gain
    if gain.by is None:
        return ["Single readings, not the prediction of the motion: see “What shows it”."]
    most = gain.foremost
    first = (
        f"{change_of(most)}, on held-out data, {together(result)}."
        if most
        else "No error of the prediction falls."
    )
    return [first, *_others(gain), _worse(gain)]


def _others(gain: Gain) -> list[str]:
    """Return the changes of the other judged errors, from the greatest gain to the least."""
    others = sorted(
        (e for e in gain.judged if e is not gain.foremost and e.before), key=lambda e: e.after / e.before
    )
    lines = [f"{reading(e.channel)} {percent_of(e.after / e.before)}" for e in others]
    return [f"The others change by: {', '.join(lines)}."] if lines else []


def percent_of(ratio: float) -> str:
    """Return a change as percent with its sign; one that rounds to nothing has none."""
    change = round(100 * (ratio - 1))
    return f"{change:+d} %" if change else "0 %"


def _worse(gain: Gain) -> str:
    from slam.criticism.search.thresholds import MISFIT

    worse = [change_of(error) for error in gain.judged if error.after > (1.0 + MISFIT) * error.before]
    if not worse:
        return f"Over all flights, no channel's error grows by more than {100 * MISFIT:.0f} %."
    return f"{either(len(worse), 'One', 'Some')} became worse: {'; '.join(worse)}."


def change_of(error: ChannelError) -> str:
    """Return the error of a channel over a horizon, after and before, in one unit."""
    factor, unit = everyday(error.before, error.unit)
    change = percent_of(error.after / error.before) if error.before else "0 %"
    return (
        f"{_error_of(error)} is {figure(factor * error.after)} {unit} instead of "
        f"{figure(factor * error.before)} ({change})"
    )


def _error_of(error: ChannelError) -> str:
    ahead = f"{error.horizon_s:g} s ahead" if error.horizon_s else "from picture to picture"
    return f"the error of {reading(error.channel)} {ahead}"


def together(result: Criticism) -> str:
    """Return the words for the causes that a gain includes."""
    count = len(result.causes)
    return f"with all {count} causes together" if count > 1 else "with this cause"


def gain_tile(result: Criticism) -> Item:
    """Return the gain of the causes in the error that falls most, or else in the likelihood."""
    gain = result.causes[0].gain
    most = gain.foremost
    if gain.by and most:
        what = f"change of {_error_of(most)}, held out, {together(result)}"
        return Item(what, percent_of(most.after / most.before))
    what = "log likelihood of held-out data" if gain.by else "log likelihood of its readings"
    return Item(what, f"{gain.nats:+.1f} nats")


def gain_rows(result: Criticism) -> list[GainRow]:
    """Errors of roll-outs by channel and horizon, on held-out data."""
    if not result.causes:
        return []
    rows = []
    for error in result.causes[0].gain.channels:
        if error.horizon_s in SHOWN_HORIZONS and error.before > 0:
            factor, unit = everyday(error.before, error.unit)
            rows.append(
                GainRow(
                    f"{reading(error.channel)} [{unit}]", SHOWN_HORIZONS[error.horizon_s],
                    figure(factor * error.before), figure(factor * error.after),
                    percent_of(error.after / error.before),
                )
            )  # fmt: skip
    return rows


def gain_caption(result: Criticism) -> str:
    """Caption of the figure of the gain by part, which is that of the leading cause alone."""
    from slam.criticism.search.information import SEGMENT_S

    if not result.causes:
        return ""
    first, more = result.causes[0], len(result.causes) > 1
    title = title_of(first.name)
    if first.gain.by is None:
        return IN_SAMPLE_DOTS.format(cause=title)
    beside = f", by {title} alone, beside the other causes (the table is with all of them)" if more else ""
    begin = f" Part 2 begins {SEGMENT_S:g} s after part 1, and so on." * (first.gain.by == "segment")
    return f"{HELD_OUT_DOTS.format(beside=beside)}{begin}"
