"""Evidence for each certain cause: its size, when it acts, and a stretch with and without it alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import grid, png
from slam.report.criticism.certainty import by_certainty, changes
from slam.report.criticism.gains import better_parts
from slam.report.criticism.judged_data import judged_of
from slam.report.criticism.plain_names import quantity, title_of
from slam.report.criticism.prediction_errors import SHOWN_S, BeforeAndAfter, errors_by_channel
from slam.report.criticism.segment import (
    MOST_FLIGHTS,
    READINGS_OF,
    RESTART_S,
    draw_stick,
    telling_readings,
)
from slam.report.criticism.values import (
    NO_DIFFERENCE,
    before_and_after,
    change_of_size,
    compared,
    sized_interval,
)
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.criticism.cause import Cause
    from slam.simulation.model import Model

TITLE = "What shows each certain cause"
_BY_STICK = ("command", "force")
"""Places where a cause acts that shows by the stick."""
MOST_CAUSES = 6
"""Greatest number of causes with a panel: more are higher than a page."""
_CAPTION = (
    "Lines: error of the prediction of the reading that shows a cause best, started anew every "
    f"{RESTART_S:g} s, by the extended model without this cause alone (orange) and with it (blue); the other "
    "causes are in both, and all are fitted to the whole flights. Where one line is seen, both are the same; "
    "errors of both are not this cause's. The numbers above are root mean squares over the stretch."
)
_STICK, _DOTS = " Black: the stick, as a share of full deflection.", " Dots: single readings."


@dataclass(frozen=True)
class EvidenceRow:
    """Table row of one certain cause."""

    title: str
    size: str
    when: str
    shown: str
    """Place in the picture, with the stretch that it shows."""


@dataclass(frozen=True)
class CauseEvidence:
    """Table and picture of the certain causes."""

    rows: tuple[EvidenceRow, ...]
    picture: bytes | None
    """None where no flight shows any of them."""
    caption: str = ""


@dataclass(frozen=True)
class _Stretch:
    """Stretch of a flight in which a cause shows most."""

    flight: Flight
    begin_s: float
    pair: BeforeAndAfter | None
    """None where single readings show the cause."""


def evidence_of_causes(result: Criticism, flights: Sequence[Flight]) -> CauseEvidence | None:
    """Return the evidence for the certain causes; None where there is but one cause, which the whole page is
    about, or none that is certain."""
    sure = by_certainty(result)[0]
    if not sure or len(result.causes) < 2 or result.extended is None:
        return None
    judged = judged_of(result, flights)[:MOST_FLIGHTS]
    found = {cause.name: _stretch_of(cause.name, result.extended, judged) for cause in sure[:MOST_CAUSES]}
    shown = {name: stretch for name, stretch in found.items() if stretch is not None}
    rows = []
    for cause in sure:
        place = ""
        if (stretch := shown.get(cause.name)) is not None:
            times = f"{stretch.begin_s:.0f} to {_end_s(stretch):.0f} s"
            panel = f"panel {[*shown].index(cause.name) + 1}: " * (len(shown) > 1)
            place = f"{panel}{times} of {stretch.flight.name}"
        rows.append(
            EvidenceRow(title_of(cause.name), _size(cause, result), _when(cause, result), place or "–")
        )
    sticks = _STICK * any(_has_stick(name, stretch) for name, stretch in shown.items())
    dots = _DOTS * any(stretch.pair is None for stretch in shown.values())
    return CauseEvidence(tuple(rows), _drawn(shown) if shown else None, f"{_CAPTION}{sticks}{dots}")


def shown_in_short(evidence: CauseEvidence | None) -> list[str]:
    """Return a line for each certain cause: when it shows, and where the picture has it."""
    lines, picture = [], f"“{TITLE}”, "
    for row in evidence.rows if evidence is not None else ():
        place = f" ({picture}{row.shown})" if row.shown != "–" else ""
        lines.append(f"{row.title}: {row.when}{place}.")
        picture = "" if place else picture
    return lines


def _size(cause: Cause, result: Criticism) -> str:
    """Return the sizes of a cause that differ from none, with their intervals."""
    lines = []
    for name, found in cause.parameters.items():
        if compared(CATALOGUE[cause.name].parameter(name), found) == NO_DIFFERENCE:
            continue
        change = change_of_size(result, cause.name, name)
        lines.append(
            f"{quantity(cause.name, name)} {before_and_after(change) if change else sized_interval(found)}"
        )
    return "; ".join(lines) or "–"


def _when(cause: Cause, result: Criticism) -> str:
    if cause.gain.by is None:
        return "in single readings"
    lost = [-nats for nats in cause.gain.parts if nats < 0.0]
    who = "others lose up to" if len(lost) > 1 else "another loses"
    most = f"; {who} {max(lost):.1f} nats" if lost else ""
    steady = "; its size changes" * changes(cause, result)
    return f"wherever it acts: it predicts {better_parts(cause.gain)} better{most}{steady}"


def _has_stick(name: str, stretch: _Stretch) -> bool:
    """Return whether a cause acts by the stick, which then stands behind the errors."""
    return stretch.pair is not None and bool(stretch.pair.replayed) and CATALOGUE[name].acts_on in _BY_STICK


def _end_s(stretch: _Stretch) -> float:
    """Return the end of a stretch, which is that of a flight that is shorter."""
    from slam.report.criticism.segment import SEGMENT_S

    if stretch.pair is None:
        return stretch.begin_s + SEGMENT_S
    return min(stretch.begin_s + SHOWN_S, float(stretch.pair.before.stamps_s[-1]))


def _stretch_of(name: str, model: Model, flights: Sequence[Flight]) -> _Stretch | None:
    """Return the stretch in which a cause shows most; None where no flight shows it."""
    if name in READINGS_OF:
        stream = CATALOGUE[name].stream
        having = [flight for flight in flights if not stream or getattr(flight, stream) is not None]
        each = [(telling_readings(name, flight), flight) for flight in having]
        if not each:
            return None
        (stamps_s, _), flight = max(each, key=lambda one: float(np.nanstd(one[0][1])))
        return _Stretch(flight, float(stamps_s[0]), None)
    without = replace(
        model,
        terms={term: sizes for term, sizes in model.terms.items() if term != name},
        std={term: sizes for term, sizes in model.std.items() if term != name},
    )
    tried = [(pair, flight) for flight in flights for pair in _pairs(flight, without, model)]
    known = [(pair.falls_to, k) for k, (pair, _) in enumerate(tried) if pair.falls_to < 1.0]
    if not known:
        return None
    pair, flight = tried[min(known)[1]]
    return _Stretch(flight, _where_it_falls(pair), pair)


def _pairs(flight: Flight, without: Model, model: Model) -> list[BeforeAndAfter]:
    from slam.core.errors import InputError

    try:
        return errors_by_channel(flight, without, model)
    except InputError:
        return []  # too few readings to begin a replay from


def _where_it_falls(pair: BeforeAndAfter) -> float:
    """Return the begin of the stretch in which the error falls most. A clock that is corrected moves the
    stamps."""
    before, after = pair.before, pair.after
    left = np.interp(before.stamps_s, after.stamps_s, np.abs(after.off))
    fall = np.maximum(np.abs(before.off) - left, 0.0)
    return replace(before, off=fall).worst()[1]


def _drawn(shown: dict[str, _Stretch]) -> bytes:
    from matplotlib.figure import Figure

    each = 1.15 if len(shown) > 1 else 1.5  # one alone may be higher
    drawn = Figure(figsize=(7.2, 0.5 + each * len(shown)), dpi=160, layout="constrained")
    handles: dict[str, Artist] = {}
    panels = np.ravel(drawn.subplots(len(shown), 1))
    for k, (axes, (name, stretch)) in enumerate(zip(panels, shown.items(), strict=True)):
        what = _draw(axes, name, stretch)
        number = f"{k + 1}. " * (len(shown) > 1)
        axes.set_title(f"{number}{title_of(name)}: {what}", fontsize=9, loc="left")
        lines, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, lines, strict=True))
    drawn.axes[-1].set_xlabel("time in the flight [s]", fontsize=9)
    if handles:
        drawn.legend(
            [*handles.values()], [*handles], loc="outside lower center", ncols=3, frameon=False, fontsize=8
        )
    return png(drawn)


def _draw(axes: Axes, name: str, stretch: _Stretch) -> str:
    """Draw a stretch and return its title."""
    if stretch.pair is not None:
        sizes = stretch.pair.draw(axes, stretch.begin_s, ("without this cause, before", "with it, after"))
        if _has_stick(name, stretch):
            stick = axes.twinx()
            draw_stick(stick, stretch.pair.replayed, stretch.flight, stretch.begin_s, _end_s(stretch))
            stick.spines["top"].set_visible(False)
            stick.tick_params(labelsize=8)
            for of in (axes, stick):  # both are 0 at the same height
                most = max(map(abs, of.get_ylim()))
                of.set_ylim(-most, most)
        return f"{stretch.pair.channel}, {sizes}"
    stamps_s, values = telling_readings(name, stretch.flight)
    axes.plot(stamps_s, values, ".", color="black", markersize=2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    grid(axes)
    label, _, unit = READINGS_OF[name].label.partition(" [")
    axes.set_ylabel(f"[{unit}", fontsize=8)
    return label
