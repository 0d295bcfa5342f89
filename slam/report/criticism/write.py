"""The page ``report.html`` of a criticism: the verdict's headline and details, then the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import either
from slam.core.units import sized, spaced
from slam.core.version import VERSION
from slam.report.criticism.answers import criticism_answers
from slam.report.criticism.changes import size_over_time
from slam.report.criticism.evidence import longer_bar
from slam.report.criticism.pictures import (
    calibration_picture,
    covariate_picture,
    gain_picture,
    panels_of,
    ranking_picture,
)
from slam.report.criticism.plain_names import TWO_SIDED, constant, figure, reading, title_of, with_titles
from slam.report.criticism.segment import evidence_segment
from slam.report.page import Item, embedded, render_page
from slam.report.tables.evaluation import map_gain_table

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
NOT_SHOWN = "not shown by these flights"
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

    title: str
    name: str
    equation: str
    parameter: str
    value: str
    interval: str
    probability: str


@dataclass(frozen=True)
class DetectableRow:
    """Table row of the smallest visible size of an effect."""

    title: str
    name: str
    size: str
    manoeuvre: str
    """Manoeuvre that shows a smaller one."""


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
    segments = [s for s in (evidence_segment(result, flights), size_over_time(result)) if s is not None]
    return render_page(
        "criticism/page.html.j2",
        title=VERDICTS[result.verdict],
        version=VERSION,
        model=result.model.name if result.model else "none",
        result=result,
        reading=reading,
        sentence=with_titles([result.sentence])[0],
        answers=criticism_answers(result, [segment.where for segment in segments]),
        tiles=_tiles(result),
        segments=[(s.title, embedded(s.picture), s.caption) for s in segments],
        covariate=embedded(covariate_picture(result.covariate)) if result.covariate else None,
        covariate_caption=covariate_caption(result),
        ranking=embedded(ranking_picture(result)) if result.ranking else None,
        ranking_caption=ranking_caption(result),
        alike=[title_of(name) for name in result.equivalence_set],
        causes=cause_rows(result),
        gains=gain_rows(result),
        maps=map_gain_table(maps) if maps else None,
        by=gain.by if gain else None,
        of_pictures=gain is not None and any(c.horizon_s == 0.0 for c in gain.channels),
        gain_caption=HELD_OUT_DOTS if gain and gain.by else IN_SAMPLE_DOTS,
        calibration=_calibration(result),
        dots=embedded(gain_picture(gain)) if gain and len(gain.parts) > 1 else None,
        nuisances=nuisance_rows(result),
        confusable=[
            Item(f"{title_of(a)} and {title_of(b)}", f"{c:+.2f}", (f"{a}, {b}",))
            for a, b, c in result.confusable
        ],
        detectable=detectable_rows(result),
    )


def _calibration(result: Criticism) -> str | None:
    checks = [check for check in result.checks if check.tenths]
    return embedded(calibration_picture(checks)) if checks else None


def _tiles(result: Criticism) -> list[Item]:
    tiles = [Item(f"{either(len(result.flights), 'flight', 'flights')} judged", str(len(result.flights)))]
    if result.causes:
        first = result.causes[0]
        tiles.append(Item(f"probability of {title_of(first.name)}", f"{first.probability:.3f}"))
        tiles.append(_gain_tile(first.gain))
    elif result.ranking:
        strongest = max(result.ranking, key=lambda r: r.z)
        tiles.append(Item(f"strongest of all ({title_of(strongest.name)})", f"{strongest.z:.1f} sigma"))
    return tiles


def _gain_tile(gain: Gain) -> Item:
    """Return the gain of the causes in the error that falls most, or else in the likelihood."""
    most = gain.foremost
    if gain.by and most:
        ahead = f"{most.horizon_s:g} s ahead" if most.horizon_s else "from picture to picture"
        change = f"{100 * (most.after / most.before - 1):+.0f} %"
        return Item(f"error of {reading(most.channel)} {ahead}, on held-out data", change)
    what = "log likelihood of held-out data" if gain.by else "log likelihood of its readings"
    return Item(what, f"{gain.nats:+.1f} nats")


def cause_rows(result: Criticism) -> list[CauseRow]:
    """One row a parameter; name, equation and probability stand in the first row of each cause."""
    from slam.simulation.terms import CATALOGUE

    rows = []
    for cause in result.causes:
        term = CATALOGUE.get(cause.name)
        for k, (name, p) in enumerate(cause.parameters.items()):
            equation = term.equation if term else ""
            first = (title_of(cause.name), cause.name, equation, f"{cause.probability:.3f}")
            shown = first if k == 0 else ("", "", "", "")
            value = f"{figure(p.value)}{spaced(p.unit)}"
            interval = f"{figure(p.low)} to {figure(p.high)}"
            rows.append(CauseRow(*shown[:3], name, value, interval, shown[3]))
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
                    reading(error.channel), SHOWN_HORIZONS[error.horizon_s], sized(error.before, error.unit),
                    sized(error.after, error.unit), f"{change:+.0f} %",
                )
            )  # fmt: skip
    return rows


def nuisance_rows(result: Criticism) -> list[Item]:
    """Return the constants of this vehicle with their intervals; one that the flights do not show is marked.

    It is one of which they tell less than the range of healthy vehicles does.
    """
    from slam.criticism.kalman.filter_parameters import filter_parameters_of
    from slam.criticism.search.fitted_parameters import NUISANCES

    assert result.model is not None or not result.nuisances
    model = filter_parameters_of(result.model) if result.model else None
    rows = []
    for nuisance in NUISANCES:
        found = result.nuisances.get(nuisance.name)
        if found is None or model is None:
            continue
        ends = np.array([found.low, found.high])
        reach = float(np.ptp(np.log(ends) if nuisance.form == "log" else ends)) / 2.0
        unseen = (reach / TWO_SIDED) ** 2 * nuisance.prior_precision(model) > 0.5
        value = f"{figure(found.value)}{spaced(found.unit)} ({figure(found.low)} to {figure(found.high)})"
        rows.append(Item(constant(nuisance.name), value, (NOT_SHOWN,) if unseen else ()))
    return rows + [
        Item(f"{reading(name)}: noise of one sample with the next", figure(share))
        for name, share in result.noise_correlation.items()
    ]


def detectable_rows(result: Criticism) -> list[DetectableRow]:
    """Return the smallest visible size of each effect, with the manoeuvre that shows a smaller one."""
    from slam.simulation.terms import CATALOGUE

    return [
        DetectableRow(title_of(name), name, sized(size, unit), CATALOGUE[name].excitation)
        for name, (size, unit) in result.detectable.items()
    ]


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
        f"Vertical axis: {what}. Horizontal axis: the error that the cause predicts. The means without "
        "it follow the dashed line as far as it explains the error; those with it should be flat, and a "
        "slope of these is left unexplained."
    )
    if len(panels_of(found)) < 2:
        return text
    return f"{text} The other panel is the same for {title_of(found.rival)}, the most probable alternative."


def ranking_caption(result: Criticism) -> str:
    """Caption of the line in the figure of the ranking."""
    why = longer_bar(result)
    return f"the line ({result.threshold:.1f}) is {result.threshold_means}.{' ' if why else ''}{why}"
