"""The short tables that a command prints at its end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table
from rich.text import Text

from backend.wording import counted
from slam.core.errors import one_line
from slam.core.messages import CHECKED_BY_ONE_DISTANCE, Message, by_kind
from slam.core.units import percent
from slam.report.answers.left_out import counted_by_kind, left_out
from slam.report.facts import Facts
from slam.report.mosaic_facts import MosaicFacts

if TYPE_CHECKING:
    from slam.core.figure_table import FigureTable
    from slam.core.summary import Summary

_MOST_WARNINGS = 8
"""Warnings shown on the terminal; summary.json and the report hold all."""
_COMPARED = "The distances between landmarks below check them."
"""Words in place of the request for a distance where known ones were compared."""


def rich_table(figures: FigureTable) -> Table:
    """Return a table for the terminal; names and units in brackets are printed as text, never as markup."""
    made = Table(
        title=Text(one_line(figures.title)),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        show_header=bool(figures.columns),
    )
    for k in range(max((len(row) for row in figures.rows), default=1)):
        heading = figures.columns[k] if figures.columns else ""
        made.add_column(Text(heading), justify="left" if k == 0 else "right", overflow="fold")
    for row in figures.rows:
        made.add_row(*(Text(one_line(cell)) for cell in row))
    return made


def outcome_table(
    facts: Facts, summary: Summary, mosaic: MosaicFacts | None = None, compared: bool = False
) -> Table:
    """Return the table of an optimization's result.

    ``compared``: a table with known distances on the ground follows, so that none has to be measured.
    """
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_header=False)
    made.add_column(style="bold")
    made.add_column(overflow="fold")
    for name, value in _outcome_rows(facts, summary, mosaic, compared):
        made.add_row(name, Text(one_line(value)))
    return made


def path_list(paths: Sequence[Path]) -> Text:
    """Return the paths of files, one per line."""
    return Text("\n".join(one_line(str(path)) for path in paths))


def _position_sigma(facts: Facts) -> str:
    if not math.isfinite(facts.sigma_median_m):
        return "not known"
    worst = facts.length(facts.sigma_max_m)
    text = f"typically {facts.length(facts.sigma_median_m)}, {worst} where least certain"
    if facts.relative_to:
        text += f", relative to {facts.relative_to}"
    return text + (f"; mostly the common scale ({percent(facts.scale_std)})" if facts.mostly_scale else "")


def _outcome_rows(
    facts: Facts, summary: Summary, mosaic: MosaicFacts | None, compared: bool
) -> list[tuple[str, str]]:
    placed = f"{facts.placed} of {facts.keyframes} placed"
    if not facts.is_graph:
        placed += f", from {counted(facts.frames, 'picture')}"
    if facts.maps > 1:
        placed += f", in {facts.maps} separate maps"
    rejected = (
        f"{counted_by_kind(left_out(summary.rejected))}; the report says why" if summary.rejected else ""
    )
    if facts.is_graph:  # a person who has a graph knows its rows
        rejected = ", ".join(f"{count} x {reason}" for reason, count in summary.rejected.items())
    rows = [
        ("status", summary.status),
        ("poses" if facts.is_graph else "keyframes", placed),
        (
            "edges",
            f"{summary.odometry_edges} between neighbours, {counted(summary.loop_edges, 'loop closure')}",
        ),
        ("left out", rejected or "nothing"),
        ("position, 1σ", _position_sigma(facts)),
        ("lengths from", facts.scale_source),
        ("time, memory", f"{sum(summary.timing_s.values()):.1f} s, {summary.peak_rss_mb:.0f} MB"),
    ]
    if summary.accuracy_basis:
        basis = summary.accuracy_basis
        rows.insert(
            -1, ("accuracy", basis.replace(CHECKED_BY_ONE_DISTANCE, _COMPARED) if compared else basis)
        )
    if summary.error is not None:
        rows.insert(
            3, ("error", f"{summary.error:.6g} after {counted(summary.iterations or 0, 'iteration')}")
        )
    if summary.error is not None and summary.certificate is not None:
        rows.insert(4, ("optimum", summary.certificate.sentence(summary.error)))
    return [*rows, *_place_rows(facts, mosaic), *warning_rows(summary.messages)]


def _place_rows(facts: Facts, mosaic: MosaicFacts | None) -> list[tuple[str, str]]:
    """Return the size of a pixel and the coordinate systems of a mosaic; none without one."""
    if mosaic is None:
        return []
    size = f"{mosaic.width} x {mosaic.height} pixels of {facts.length(mosaic.pixel_m)}"
    return [("mosaic.tif", f"{size}; {facts.plane}"), ("heights", facts.datum)]


def warning_rows(messages: Sequence[Message]) -> list[tuple[str, str]]:
    """Return the first messages with their kind, warnings first, and how many are left out."""
    found = by_kind(messages)
    rows = [*(("warning", m.text) for m in found.warnings), *(("note", m.text) for m in found.notes)]
    if (more := len(rows) - _MOST_WARNINGS) > 0:
        rows[_MOST_WARNINGS:] = [("", f"and {counted(more, 'more message')} in summary.json")]
    return rows
