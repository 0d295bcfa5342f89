"""The page ``report.html`` of a criticism: the verdict's headline and details, then the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from backend.wording import either
from slam.core.version import VERSION
from slam.report.accuracy import map_gain_table
from slam.report.criticism_answers import criticism_answers
from slam.report.criticism_pictures import (
    calibration_picture,
    covariate_picture,
    gain_picture,
    ranking_picture,
)
from slam.report.criticism_segment import evidence_segment
from slam.report.page import Item, embedded, render_page

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.criticism.cause import Gain
    from slam.evaluation.map_gain import MapGain

VERDICTS = {
    "nothing_wrong": "Nothing wrong",
    "named": "Found",
    "ambiguous": "Two causes or more fit",
    "named_with_remainder": "Found, and something is left over",
    "unknown": "Something that the catalogue does not hold",
    "unusable": "Cannot be judged",
}
SHOWN_HORIZONS = {0.0: "picture to picture", 0.5: "0.5 s", 2.0: "2 s", 10.0: "10 s"}
_MOST_IN_FIGURES = 999.5
"""Larger values with three significant figures would have an exponent."""
HELD_OUT_DOTS = (
    "Log likelihood gained on each part when it was held out, in nats (5 nats are odds of 150 to 1); above 0 "
    "the extension predicts it better."
)
IN_SAMPLE_DOTS = (
    "Log likelihood that each flight's odd readings tell for the cause, in nats (5 nats are odds of 150 "
    "to 1). Each of them tells by itself; no size is fitted that could be held out."
)


@dataclass(frozen=True)
class CauseRow:
    """Table row of one parameter of one cause."""

    name: str
    equation: str
    parameter: str
    value: str
    interval: str
    probability: str


@dataclass(frozen=True)
class GainRow:
    """Table row of one channel over one horizon."""

    channel: str
    horizon: str
    before: str
    after: str
    change: str


def write_criticism_report(
    path: Path, result: Criticism, flights: Sequence[Flight], maps: Sequence[MapGain] = ()
) -> None:
    """Write the page to ``path``; ``flights`` are those that were judged, ``maps`` those that were mapped."""
    path.write_text(render_criticism(result, flights, maps), encoding="utf-8", errors="replace")


def render_criticism(result: Criticism, flights: Sequence[Flight], maps: Sequence[MapGain] = ()) -> str:
    """Return the page as HTML with everything embedded."""
    gain = result.causes[0].gain if result.causes else None
    segment = evidence_segment(result, flights)
    return render_page(
        "criticism_page.html.j2",
        title=VERDICTS[result.verdict],
        version=VERSION,
        model=result.model.name if result.model else "none",
        result=result,
        answers=criticism_answers(result),
        tiles=_tiles(result),
        segment=segment,
        segment_image=embedded(segment.picture) if segment else None,
        covariate=embedded(covariate_picture(result.covariate)) if result.covariate else None,
        covariate_caption=covariate_caption(result),
        ranking=embedded(ranking_picture(result)) if result.ranking else None,
        ranking_caption=ranking_caption(result),
        causes=cause_rows(result),
        gains=gain_rows(result),
        maps=map_gain_table(maps) if maps else None,
        by=gain.by if gain else None,
        of_pictures=gain is not None and any(c.horizon_s == 0.0 for c in gain.channels),
        gain_caption=HELD_OUT_DOTS if gain and gain.by else IN_SAMPLE_DOTS,
        calibration=_calibration(result),
        dots=embedded(gain_picture(gain)) if gain and len(gain.parts) > 1 else None,
        nuisances=[
            Item(name, f"{_figure(n.value)} {_unit(n.unit)} ({_figure(n.low)} to {_figure(n.high)})")
            for name, n in result.nuisances.items()
        ]
        + [
            Item(f"{name}: noise of one sample with the next", f"{_figure(share)}")
            for name, share in result.noise_correlation.items()
        ],
        confusable=[Item(f"{a} and {b}", f"{c:+.2f}") for a, b, c in result.confusable],
        detectable=[Item(n, f"{_figure(size)} {_unit(u)}") for n, (size, u) in result.detectable.items()],
    )


def _calibration(result: Criticism) -> str | None:
    checks = [check for check in result.checks if check.tenths]
    return embedded(calibration_picture(checks)) if checks else None


def _tiles(result: Criticism) -> list[Item]:
    tiles = [Item(f"{either(len(result.flights), 'flight', 'flights')} judged", str(len(result.flights)))]
    if result.causes:
        first = result.causes[0]
        tiles.append(Item(f"probability of {first.name}", f"{first.probability:.3f}"))
        tiles.append(_gain_tile(first.gain))
    elif result.ranking:
        strongest = max(result.ranking, key=lambda r: r.z)
        tiles.append(Item(f"strongest of all ({strongest.name})", f"{strongest.z:.1f} sigma"))
    return tiles


def _gain_tile(gain: Gain) -> Item:
    """Return the gain of the causes in the error that falls most, or else in the likelihood."""
    most = gain.foremost
    if gain.by and most:
        ahead = f"{most.horizon_s:g} s ahead" if most.horizon_s else "from picture to picture"
        change = f"{100 * (most.after / most.before - 1):+.0f} %"
        return Item(f"error of {most.channel} {ahead}, on held-out data", change)
    what = "log likelihood of held-out data" if gain.by else "log likelihood of its readings"
    return Item(what, f"{gain.nats:+.1f} nats")


def cause_rows(result: Criticism) -> list[CauseRow]:
    """One row a parameter; name, equation and probability stand in the first row of each cause."""
    from slam.simulation.terms import CATALOGUE

    rows = []
    for cause in result.causes:
        term = CATALOGUE.get(cause.name)
        for k, (name, p) in enumerate(cause.parameters.items()):
            first = (cause.name, term.equation if term else "", f"{cause.probability:.3f}")
            shown = first if k == 0 else ("", "", "")
            rows.append(
                CauseRow(
                    shown[0], shown[1], name, _sized(p.value, p.unit),
                    f"{_figure(p.low)} to {_figure(p.high)}", shown[2],
                )
            )  # fmt: skip
    return rows


def gain_rows(result: Criticism) -> list[GainRow]:
    """Errors of roll-outs by channel and horizon, on held-out data."""
    if not result.causes:
        return []
    rows = []
    for error in result.causes[0].gain.channels:
        if error.horizon_s in SHOWN_HORIZONS and error.before > 0:
            change = 100 * (error.after / error.before - 1)
            rows.append(
                GainRow(
                    error.channel, SHOWN_HORIZONS[error.horizon_s], _sized(error.before, error.unit),
                    _sized(error.after, error.unit), f"{change:+.0f} %",
                )
            )  # fmt: skip
    return rows


def covariate_caption(result: Criticism) -> str:
    """Caption of the covariate's figure; empty where there is none."""
    found = result.covariate
    if found is None:
        return ""
    first = found.against[0]
    what = (
        "disagreement of the instruments, in its standard deviations"
        if first.unit == "sigma"
        else "error of the model's prediction over two seconds"
    )
    text = (
        f"Vertical axis: {what}. Horizontal axis: the error that {found.cause} predicts. The means without "
        "it follow the dashed line as far as it explains the error; those with it should be flat, and a "
        "slope of these is left unexplained."
    )
    if not found.rival:
        return text
    return f"{text} The other panel is the same for {found.rival}, the most probable alternative."


def ranking_caption(result: Criticism) -> str:
    """Caption of the line in the figure of the ranking."""
    return f"the line ({result.threshold:.1f}) is {result.threshold_means}"


def _figure(value: float) -> str:
    return f"{value:.3g}" if abs(value) < _MOST_IN_FIGURES else f"{value:.0f}"


def _sized(value: float, unit: str) -> str:
    return f"{_figure(value)} {_unit(unit)}".strip()


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit
