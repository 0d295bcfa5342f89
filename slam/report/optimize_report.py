"""The page ``report.html`` of one optimization: a pilot's questions answered, tables for an engineer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.measurements import CONTRADICTED, Rejection
from backend.wording import counted, either
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.messages import by_kind
from slam.core.summary import Summary
from slam.core.units import area, percent, unit
from slam.core.version import VERSION
from slam.report.answers.advice import limit_sentence
from slam.report.answers.checked_lengths import basis, settled
from slam.report.answers.headline import sentence, what_ok_means
from slam.report.answers.left_out import check_in_words, figures_in_words
from slam.report.answers.left_out_here import ground_is_missing, left_out_here
from slam.report.answers.questions import PLACE, pilots_answers
from slam.report.answers.streams import STREAM_WORDS
from slam.report.facts import Facts, gather, median_height_m
from slam.report.mosaic_facts import MosaicFacts, mosaic_facts
from slam.report.output_files import output_files
from slam.report.page import Item, embedded, render_page
from slam.report.pictures.heights import heights_figure, heights_figure_words
from slam.report.pictures.map import map_picture, picture, shown_area, surveyed_marks
from slam.report.pictures.mosaic_marks import MapMarks
from slam.report.pictures.path import altitude_picture, trajectory_picture
from slam.report.pictures.path_over_time import laps, path_over_time
from slam.report.tables.evaluation import NOT_EVALUATED, Evaluated, not_evaluated
from slam.report.tables.instrument_errors import (
    accelerometer_text,
    antenna_text,
    arm_text,
    attitude_text,
    barometer_text,
    heading_text,
    lag_text,
    lengths_text,
    lens_text,
    mount_text,
    shutter_text,
    velocity_text,
)
from slam.report.tables.instruments import instrument_table, unused_instruments

if TYPE_CHECKING:
    from slam.core.figure_table import FigureTable
    from slam.core.flight import Flight

_LAPS = "Each panel shows one lap over the whole path. "
_MOST_REJECTED = 5
"""Largest number of rejected loops listed on the page for one reason; loops.csv has all of them."""


@dataclass(frozen=True)
class RejectedLoop:
    """One row of the table of rejected loops."""

    keyframes: str
    pictures: str
    figures: str
    """Figures of the check that it failed."""


@dataclass(frozen=True)
class RejectedLoops:
    """The rows of the table for one reason."""

    verdict: str
    """Verdict on the matches by `slam.report.answers.left_out`."""
    reason: str
    rows: tuple[RejectedLoop, ...]
    count: int
    """Number of matches with this reason; the table has some of them."""


@dataclass(frozen=True)
class Mosaics:
    """Figures of the map that were written; None where there is none."""

    after: Path | None = None
    before: Path | None = None
    quality: Path | None = None
    elevation: Path | None = None
    """Picture of the heights of the ground."""


@dataclass(frozen=True)
class Accuracy:
    """Errors of a map, as references outside of it show them."""

    tables: tuple[FigureTable, ...] = ()
    evaluated: Evaluated = NOT_EVALUATED


def write_report(
    path: Path,
    estimate: Estimate,
    summary: Summary,
    flight: Flight | None = None,
    mosaics: Mosaics = Mosaics(),
    accuracy: Accuracy = Accuracy(),
) -> None:
    """Write the page to ``path``, with links to the files beside it; ``flight`` is None for a graph."""
    page = render(estimate, summary, flight, mosaics, accuracy, path.parent)
    path.write_text(page, encoding="utf-8", errors="replace")


def render(
    estimate: Estimate,
    summary: Summary,
    flight: Flight | None = None,
    mosaics: Mosaics = Mosaics(),
    accuracy: Accuracy = Accuracy(),
    folder: Path | None = None,
) -> str:
    """Return the page as HTML; ``folder`` is where it will lie, for links to the files there."""
    facts = gather(estimate, flight)
    drawable = facts.placed > 0
    before = "as given" if facts.is_graph else ""  # the path over time shows the chain
    timed = facts.placed > 1 and not facts.is_graph
    marks = MapMarks(unit(facts.metric), estimate.origin is not None, surveyed_marks(estimate.control))
    ground = mosaic_facts(mosaics.after, mosaics.quality, facts.gaps)
    result = accuracy.evaluated
    result = not_evaluated(flight, estimate.control) if result == NOT_EVALUATED else result
    left_out = (*left_out_here(estimate, facts, summary), *unused_instruments(estimate, flight))
    said = by_kind(summary.messages)
    page = render_page(
        "page.html.j2",
        name=estimate.name,
        version=VERSION,
        facts=facts,
        unit=marks.unit,
        on_earth=marks.on_earth,
        surveyed=marks.points,
        sentence=sentence(facts, summary.status, ground),
        summary=summary,
        reasons=[message.sentences for message in said.reasons],
        warnings=[message.sentences for message in said.others],
        notes=[message.sentences for message in said.notes],
        ok_means=what_ok_means(summary.messages, ground_is_missing(facts, summary)),
        limit=limit_sentence(estimate.information_shares, facts.metric, ground is not None),
        answers=pilots_answers(estimate, summary, facts, ground, left_out),
        place=PLACE,
        tiles=_tiles(facts, ground),
        chain_drift=facts.length(facts.chain_moved_m) if np.isfinite(facts.chain_moved_m) else "",
        mosaic=map_picture(mosaics.after, marks, result),
        chain_mosaic=map_picture(mosaics.before, marks, result),
        covered=_covered(mosaics.after, marks),
        elevation=heights_figure(mosaics.elevation),
        elevation_words=heights_figure_words(estimate, facts, flight),
        quality=picture(mosaics.quality),
        over_time=embedded(path_over_time(estimate, facts.gaps)) if timed else None,
        panels=_LAPS if timed and laps(estimate.w_T_b[estimate.placed, :2, 3]) > 1 else "",
        trajectory=embedded(trajectory_picture(estimate, facts.gaps, before)) if drawable else None,
        altitude=embedded(altitude_picture(estimate, facts.gaps))
        if drawable and not facts.is_graph
        else None,
        left_out=left_out,
        rejected_loops=_rejected_loops(estimate),
        verdicts={loop.finding for loop in estimate.loops if loop.verdict == "rejected"},
        figures=_figures(estimate, summary, facts),
        accuracy=(*accuracy.tables, *instrument_table(estimate, flight)),
        evaluated=result,
        streams=_streams(summary),
        files={file.name: file for file in output_files(folder)},
    )
    return settled(page, result.checks_lengths)


def _tiles(facts: Facts, mosaic: MosaicFacts | None) -> tuple[Item, ...]:
    if mosaic is not None and np.isfinite(mosaic.typical_std_m):
        of, std_m = "point on the mosaic", mosaic.typical_std_m
    else:
        of, std_m = "pose" if facts.is_graph else "place of the camera", facts.sigma_median_m
    tiles = [
        Item("poses placed" if facts.is_graph else "keyframes placed", f"{facts.placed} / {facts.keyframes}"),
        Item(f"loop {either(facts.loops_kept, 'closure', 'closures')} kept", str(facts.loops_kept)),
        Item(f"typical uncertainty of a {of} (1σ)", facts.error(std_m)),
        Item("length of the path", facts.length(facts.path_m)),
    ]
    if mosaic is not None and mosaic.missing_m2 > 0:
        tiles.append(Item("of ground are missing", area(mosaic.missing_m2, facts.metric)))
    if not facts.is_graph and facts.loops_kept and (change := facts.loop_change) is not None:
        by = "loop closures and the fit after them" if facts.is_refined else "loop closures"
        tiles.append(Item(f"drift that {by} took out, at most", facts.length(change.largest_m)))
    return tuple(tiles)


def _figures(estimate: Estimate, summary: Summary, facts: Facts) -> tuple[Item, ...]:
    one = "pose" if facts.is_graph else "keyframe"
    rows = [
        Item("Keyframes, of pictures read", f"{facts.keyframes} of {facts.frames}"),
        Item("Separate maps", str(facts.maps)),
        Item("Extent of the path", " x ".join(facts.length(side) for side in facts.extent_m)),
        Item("Flight time", f"{facts.duration_s:.1f} s"),
        Item("Links between neighbours", str(summary.odometry_edges)),
        Item("Loop closures kept, rejected", f"{facts.loops_kept}, {facts.loops_rejected}"),
        Item("Lengths come from", facts.scale_source),
        Item("Accuracy", basis(estimate.accuracy_basis)),
        Item("Gain of the height sensor", facts.sensor_gain),
        Item("Zero of the height sensor", facts.sensor_zero),
        Item("Attitude sensor against the map", attitude_text(estimate.instruments.attitude)),
        Item("Attitude sensor's heading drifts by", heading_text(estimate.instruments.attitude)),
        Item("Camera's mount is off by", mount_text(estimate.instruments.mount)),
        Item("Lens, estimated", lens_text(estimate.instruments.lens)),
        Item("Lens, known mostly from before the flight", lens_text(estimate.instruments.lens, False)),
        Item("Shutter", shutter_text(estimate.instruments.rolling_shutter)),
        Item("GPS antenna's place on the body, estimated", antenna_text(estimate.instruments.antenna)),
        Item("Accelerometer's offset", accelerometer_text(estimate.instruments.accelerometer)),
        Item("Accelerometer's place on the body", arm_text(estimate.instruments.accelerometer)),
        Item("Accelerometer lags the gyro by", lag_text(estimate.instruments.accelerometer)),
        Item("Lengths by the accelerometer", lengths_text(estimate.instruments.accelerometer)),
        Item("Vehicle's own velocity", velocity_text(estimate.instruments.velocity)),
        Item("Barometer", barometer_text(estimate.instruments.barometer)),
        Item("Scale that all lengths share, 1σ", percent(facts.scale_std) if facts.scale_std else ""),
        Item(f"Position of a {one}, 1σ: typical", facts.error(facts.sigma_median_m)),
        Item(f"Position of a {one}, 1σ: largest", facts.error(facts.sigma_max_m)),
        Item("Error of the graph", _graph_error(estimate) if facts.is_graph else ""),
        Item("Global optimum", _optimum(estimate) if facts.is_graph else ""),
        Item("Computing time", f"{sum(summary.timing_s.values()):.1f} s" if summary.timing_s else ""),
        *(
            Item(f"of it: {_STAGES.get(stage, stage)}", f"{seconds:.2f} s")
            for stage, seconds in summary.timing_s.items()
        ),
        Item("Peak memory", f"{summary.peak_rss_mb:.0f} MB"),
    ]
    return tuple(row for row in rows if row.value and not (facts.is_graph and row.label in _FLIGHT_ONLY))


def _graph_error(estimate: Estimate) -> str:
    return f"{estimate.graph_error:.6g} after {counted(estimate.iterations, 'iteration')}"


def _optimum(estimate: Estimate) -> str:
    return "" if estimate.certificate is None else estimate.certificate.sentence(estimate.graph_error)


_STAGES = {
    "track": "follow the ground from picture to picture (track)",
    "graph": "place the pictures by their links (graph)",
    "loops": "find places seen again (loops)",
    "refine": "fit pictures and instruments together (refine)",
    "mosaic": "draw the map (mosaic)",
}
"""Name of a stage among the computing times -> in words."""
_FLIGHT_ONLY = ("Keyframes, of pictures read", "Flight time")


def _streams(summary: Summary) -> tuple[Item, ...]:
    """Return the streams that a message names, with their words."""
    named = " ".join(map(str, summary.messages))
    return tuple(Item(name, words) for name, words in STREAM_WORDS.items() if name in named)


def _rejected_loops(estimate: Estimate) -> tuple[RejectedLoops, ...]:
    """Return the rejected loops by their reasons, those that the map contradicts first."""
    found = dict[str, list[tuple[LoopVerdict, Rejection]]]()
    for loop in estimate.loops:
        if loop.rejection:
            found.setdefault(check_in_words(loop.rejection), []).append((loop, loop.rejection))
    names, height_m = estimate.frame_names, median_height_m(estimate)
    groups = [
        RejectedLoops(
            loops[0][0].finding,
            reason,
            tuple(
                RejectedLoop(
                    f"{loop.i} – {loop.j}",
                    f"{names[loop.i]} – {names[loop.j]}",
                    figures_in_words(rejection, height_m),
                )
                for loop, rejection in loops[:_MOST_REJECTED]
            ),
            len(loops),
        )
        for reason, loops in found.items()
    ]
    return tuple(sorted(groups, key=lambda group: (group.verdict != CONTRADICTED, -group.count)))


def _covered(path: Path | None, marks: MapMarks) -> str:
    """Return between which coordinates the picture of a mosaic lies, in one sentence; empty where it has no
    world file."""
    if path is None or not path.with_suffix(".pgw").exists():
        return ""
    area, (x, y) = shown_area(path), marks.axes
    return (
        f" From the left edge to the right one {x} = {area.left:.1f} to {area.right:.1f} {marks.unit}, "
        f"from the"
        f" lower edge to the upper one {y} = {area.bottom:.1f} to {area.top:.1f} {marks.unit}."
    )
