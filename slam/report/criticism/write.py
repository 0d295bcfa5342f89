"""The page ``report.html`` of a criticism: the verdict's headline and details, then the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted, either
from slam.core.names import enumerated
from slam.core.version import VERSION
from slam.report.criticism.answers import criticism_answers
from slam.report.criticism.cause_evidence import TITLE, evidence_of_causes
from slam.report.criticism.certainty import by_certainty, certainty_rows, changes
from slam.report.criticism.changes import size_over_time
from slam.report.criticism.detectable import detectable_rows
from slam.report.criticism.findings import distinct_findings
from slam.report.criticism.gains import gain_caption, gain_rows, gain_tile
from slam.report.criticism.headline import lead
from slam.report.criticism.inertial_segment import compared_segment
from slam.report.criticism.pictures import (
    calibration_picture,
    covariate_caption,
    covariate_picture,
    fair_covariate,
    gain_picture,
    ranking_caption,
    ranking_picture,
)
from slam.report.criticism.plain_names import figure, reading, title_of
from slam.report.criticism.segment import evidence_segment
from slam.report.criticism.values import unshown_constants, value_rows
from slam.report.page import Item, embedded, render_page
from slam.report.tables.evaluation import map_gain_table
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.criticism import Criticism
    from slam.evaluation.map_gain import MapGain

VERDICTS = {
    "nothing_wrong": "Nothing wrong",
    "named": "Found",
    "ambiguous": "Two causes or more fit",
    "named_with_remainder": "Found, and something is left over",
    "unknown": "Something that the catalogue does not hold",
    "unusable": "Cannot be judged",
}
STATUS_MEANS = {
    "nothing_wrong": "No effect that these flights can show stands out beyond chance.",
    "named": "The causes that are named explain what is wrong, and nothing is left over.",
    "ambiguous": "Several effects explain what is wrong equally well.",
    "named_with_remainder": "The causes that are named explain a part of what is wrong, not all of it.",
    "unknown": "Something is wrong beyond chance, and no effect of the catalogue is a probable cause.",
    "unusable": "The data do not allow a verdict.",
}
"""Verdict -> what its title says."""


@dataclass(frozen=True)
class EquationRow:
    """Table row of one cause as the extended model has it."""

    title: str
    name: str
    equation: str
    parameters: str


@dataclass(frozen=True)
class NoiseRow:
    """Table row of the scatter of one channel."""

    channel: str
    samples: str
    variance: str
    correlation: str
    ratio: str
    """Size of the errors over the predicted size."""


def write_criticism_report(
    path: Path, result: Criticism, flights: Sequence[Flight], maps: Sequence[MapGain] = ()
) -> None:
    """Write the page to ``path``; ``flights`` are those that were judged, ``maps`` those that were mapped."""
    path.write_text(render_criticism(result, flights, maps), encoding="utf-8", errors="replace")


def render_criticism(result: Criticism, flights: Sequence[Flight], maps: Sequence[MapGain] = ()) -> str:
    """Return the page as HTML with everything embedded."""
    gain = result.causes[0].gain if result.causes else None
    result = replace(result, covariate=fair_covariate(result))
    drawn = (
        size_over_time(result),
        evidence_segment(result, flights),
        compared_segment(result, flights),
    )
    segments = [segment for segment in drawn if segment is not None]
    evidence = evidence_of_causes(result, flights)
    return render_page(
        "criticism/page.html.j2",
        title=VERDICTS[result.verdict],
        status_means=STATUS_MEANS[result.verdict],
        version=VERSION,
        model=result.model.name if result.model else "none",
        result=result,
        reading=reading,
        sentence=lead(result),
        answers=criticism_answers(result, [segment.where for segment in segments], flights, evidence),
        evidence=evidence,
        evidence_picture=embedded(evidence.picture) if evidence and evidence.picture else None,
        evidence_title=TITLE,
        evidence_caption=evidence.caption if evidence else "",
        tiles=_tiles(result),
        segments=[(s.title, embedded(s.picture), s.caption) for s in segments],
        covariate=embedded(covariate_picture(result.covariate)) if result.covariate else None,
        covariate_caption=covariate_caption(result),
        ranking=embedded(ranking_picture(result)) if result.ranking else None,
        ranking_caption=ranking_caption(result),
        alike=[title_of(name) for name in result.equivalence_set],
        certainty=certainty_rows(result),
        values=value_rows(result),
        unshown=unshown_constants(result),
        equations=equation_rows(result),
        corrected=corrected(result),
        gains=gain_rows(result),
        maps=map_gain_table(maps) if maps else None,
        by=gain.by if gain else None,
        of_pictures=gain is not None and any(c.horizon_s == 0.0 for c in gain.channels),
        gain_caption=gain_caption(result),
        calibration=_calibration(result),
        noise=noise_rows(result),
        noise_caption=noise_caption(result),
        noise_answer=noise_answer(result),
        of_rotation=not any(f.attitude or f.imu for f in flights if f.name in result.flights),
        dots=embedded(gain_picture(gain)) if gain and len(gain.parts) > 1 else None,
        confusable=[
            Item(f"{title_of(a)} and {title_of(b)}", f"{c:+.3f}", (f"{a}, {b}",))
            for a, b, c in result.confusable
        ],
        detectable=detectable_rows(result, flights),
    )


def _calibration(result: Criticism) -> str | None:
    checks = [check for check in result.checks if check.tenths]
    return embedded(calibration_picture(checks)) if checks else None


def _tiles(result: Criticism) -> list[Item]:
    tiles = [Item(f"{either(len(result.flights), 'flight', 'flights')} judged", str(len(result.flights)))]
    if result.causes:
        left, (sure, *_) = distinct_findings(result), by_certainty(result)
        tiles.append(Item(f"certain of {counted(len(result.causes), 'cause')} found", str(len(sure))))
        tiles.append(gain_tile(result))
        tiles.append(
            Item(
                either(len(left), "finding not explained", "findings not explained"),
                str(len(left)),
            )
        )
    elif result.ranking:
        strongest = max(result.ranking, key=lambda r: r.z)
        tiles.append(Item(f"strongest of all ({title_of(strongest.name)})", f"{strongest.z:.1f} sigma"))
    return tiles


def corrected(result: Criticism) -> str:
    """Return which causes ``slam optimize`` corrects in a recording, as the end of a sentence."""
    names = [
        f"{title_of(c.name)}{' (the mean of its size)' * changes(c, result)}"
        for c in result.causes
        if CATALOGUE[c.name].undo is not None
    ]
    return enumerated(names) or "none of the causes"


def equation_rows(result: Criticism) -> list[EquationRow]:
    """Return each cause with its equation and parameters, as extended.toml has them."""
    return [
        EquationRow(title_of(c.name), c.name, CATALOGUE[c.name].equation, ", ".join(c.parameters))
        for c in result.causes
        if c.name in CATALOGUE
    ]


def noise_rows(result: Criticism) -> list[NoiseRow]:
    """Return how the scatter of each reading agrees with what the extended model predicts."""
    rows = []
    for check in result.checks:
        rows.append(
            NoiseRow(
                reading(check.channel), f"{check.count}", f"{check.variance:.3f}",
                f"{check.autocorrelation:+.3f}", f"{float(np.sqrt(check.variance)):.2f}",
            )
        )  # fmt: skip
    return rows


def noise_caption(result: Criticism) -> str:
    """Caption of the noise that is correlated, which the whitened innovations no longer hold."""
    lines = [f"{reading(name)} by {figure(share)}" for name, share in result.noise_correlation.items()]
    if not lines:
        return ""
    return (
        f"The model has noise that is like that of the sample before ({enumerated(lines)}, which is "
        "healthy); the correlation here is what is left once that is taken out."
    )


def noise_answer(result: Criticism) -> str:
    """Return whether the readings scatter as the extended model predicts, in a sentence for each way."""
    from slam.criticism.search.thresholds import MISFIT

    ratios = {reading(check.channel): float(np.sqrt(check.variance)) for check in result.checks}
    less = [f"{name} ({ratio:.2f})" for name, ratio in ratios.items() if ratio < 1.0 - MISFIT]
    more = [f"{name} ({ratio:.2f})" for name, ratio in ratios.items() if ratio > 1.0 + MISFIT]
    if not less and not more:
        return f"Yes: errors have the predicted size within {100 * MISFIT:.0f} %."
    lines = [
        f"errors are {way} than predicted: {enumerated(of)}"
        for way, of in (("smaller", less), ("larger", more))
        if of
    ]
    return f"Not quite: by more than {100 * MISFIT:.0f} %, {'; '.join(lines)}."
