"""Before and after for flights without commands: what gyro and accelerometer predict of other instruments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import png
from slam.report.criticism.prediction_errors import SHOWN_S, BeforeAndAfter, errors_by_channel
from slam.report.criticism.segment import RESTART_S, Segment

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism

MOST_PANELS = 3


def compared_segment(result: Criticism, flights: Sequence[Flight]) -> Segment | None:
    """Return the segment in which the channel that gains most has its largest error as recorded, with the
    other kinds of channels that gain; None for flights with commands, or where nothing gains."""
    names = _channels(result)
    judged = [f for f in flights if f.name in result.flights and f.command is None]
    if not names or not judged or result.extended is None:
        return None
    each = []
    for flight in judged:
        known = {pair.channel: pair for pair in errors_by_channel(flight, None, result.extended)}
        if names[0] in known:
            pairs = [known[name] for name in names if name in known]
            each.append((*pairs[0].before.worst(), flight, pairs))
    if not each:
        return None
    _, begin_s, flight, pairs = max(each, key=lambda one: one[0])
    return _drawn(flight, pairs, begin_s)


def _channels(result: Criticism) -> list[str]:
    """Return the judged channels that gain by more than a misfit, the best of each kind, the best first."""
    from slam.criticism.search.thresholds import MISFIT
    from slam.data_quality.inertial_comparison import CHANNELS

    kinds = {name: kind for kind, channels in CHANNELS.items() for name, _ in channels}
    gain = result.causes[0].gain if result.causes else None
    best: dict[str, str] = {}
    for error in sorted(gain.judged if gain else (), key=lambda e: e.after / e.before if e.before else 1.0):
        if error.channel in kinds and error.after < (1.0 - MISFIT) * error.before:
            best.setdefault(kinds[error.channel], error.channel)
    return list(best.values())[:MOST_PANELS]


def _drawn(flight: Flight, pairs: Sequence[BeforeAndAfter], begin_s: float) -> Segment:
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(7.2, 0.8 + 1.0 * len(pairs)), dpi=160, layout="constrained")
    parts = []
    for axes, pair in zip(np.ravel(drawn.subplots(len(pairs), 1, sharex=True)), pairs, strict=True):
        sizes = pair.draw(axes, begin_s, ("as recorded", "corrected by the extended model"))
        axes.set_title(pair.channel, fontsize=9, loc="left")
        parts.append(f"{pair.channel} {sizes}")
    drawn.axes[-1].set_xlabel(f"time in {flight.name} [s]", fontsize=9)
    handles, labels = drawn.axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    caption = (
        f"Error of what gyro or accelerometer alone predicts of another instrument's reading, started anew "
        f"from that reading every {RESTART_S:g} s, where the lines break. The corrections are those of all "
        f"causes together, fitted to the whole flight, this stretch among it. Root mean square over the "
        f"{SHOWN_S:g} s: {'; '.join(parts)}."
    )
    return Segment(
        "Before and after", png(drawn), caption,
        f"“Before and after” shows {begin_s:.0f} to {begin_s + SHOWN_S:.0f} s of {flight.name}, where the "
        f"error of {pairs[0].channel} is largest.",
    )  # fmt: skip
