"""Writes all files of one optimization into a folder that the caller moves into place."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted
from slam.core.checkpoints import NO_CHECKPOINTS, Checkpoints
from slam.core.errors import InputError
from slam.core.estimate import Estimate, GroundFacts
from slam.core.figure_table import FigureTable
from slam.core.flight import Flight
from slam.core.lost_pictures import REDUNDANT
from slam.core.messages import Message, joined, note, parsed, warning
from slam.core.names import listed
from slam.core.progress import Progress
from slam.core.summary import Summary, json_text, summarise
from slam.core.units import length, percent, unit
from slam.evaluation.aligned_maps import chain_on_result
from slam.io.estimate import write_estimate
from slam.report.facts import Facts, gather
from slam.report.mosaic_facts import MosaicFacts, mosaic_facts
from slam.report.optimize_report import Accuracy, Mosaics, write_report
from slam.report.tables.control import control_tables

if TYPE_CHECKING:
    from backend.pose_graph.graph import PoseGraph
    from slam.report.rasters.mosaic import MosaicFiles


@dataclass(frozen=True)
class MosaicOptions:
    """Options of the mosaic."""

    wanted: bool = True
    gsd_m: float | None = None
    """Metres per pixel; None for the resolution of the pictures."""
    previous_output: Path | None = None
    """An earlier output folder whose unchanged tiles are reused."""
    crs: str | None = None
    """Coordinate system, ``utm`` or ``EPSG:n``, in which the rasters are written too, or ``none``; None for
    ``utm`` where the map has a place on Earth."""


@dataclass(frozen=True)
class Results:
    """The figures that a command prints at its end."""

    facts: Facts
    summary: Summary
    tables: tuple[FigureTable, ...] = ()
    mosaic: MosaicFacts | None = None


def write_results(
    folder: Path,
    estimate: Estimate,
    flight: Flight,
    options: MosaicOptions,
    progress: Progress,
    accuracy: Accuracy = Accuracy(),
    mcap: bool = False,
    checkpoints: Checkpoints = NO_CHECKPOINTS,
) -> Results:
    """Write trajectory, graph, mosaics, summary and report of a flight, and ``map.mcap`` if wanted.

    Rasters that a wanted coordinate system cannot hold give a warning, as the map is whole without them.
    Raises ``InputError``.
    """
    from backend.pose_graph.graph import build_pose_graph
    from slam.report.rasters.elevation import write_elevation
    from slam.report.rasters.obstacles import with_all_obstacles

    write_solution(folder, estimate, build_pose_graph(estimate.w_T_b, estimate.relative_poses))
    start = time.perf_counter()
    mosaics, said, made = _write_mosaics(folder, estimate, flight, options, progress, checkpoints)
    heights = write_elevation(estimate, folder, made.ground if made else None)
    if mcap:
        _write_map_mcap(folder, estimate, flight, progress)
    said += _write_in_system(folder, estimate, options.crs)
    if options.wanted:
        estimate = replace(
            estimate,
            not_drawn=made.not_drawn if made else {},
            partly_drawn=made.partly_drawn if made else {},
            ground=made.ground.facts if made else None,
        )
        timing_s = {**estimate.timing_s, "mosaic": time.perf_counter() - start}
        estimate = replace(estimate, timing_s=timing_s, messages=joined(*estimate.messages, *said))
    estimate = with_all_obstacles(estimate, made.ground if made else None)
    tables = (*control_tables(estimate.control), *accuracy.tables)
    mosaics = replace(mosaics, elevation=heights)
    return write_summary_and_report(folder, estimate, flight, mosaics, replace(accuracy, tables=tables))


def _write_map_mcap(folder: Path, estimate: Estimate, flight: Flight, progress: Progress) -> None:
    """Write the map for Foxglove and Rerun beside its rasters, if any keyframe is placed.

    Raises ``InputError`` as `slam.io.exports.mcap.write` does.
    """
    from slam.cli.output_folder import MAP_MCAP
    from slam.io.exports.exported_map import ExportedMap
    from slam.io.exports.mcap import write

    exported = ExportedMap(estimate, progress=progress, folder=folder, flight=flight)
    if len(exported.keyframes):
        write(exported, folder / MAP_MCAP)


def _write_in_system(folder: Path, estimate: Estimate, wanted: str | None) -> tuple[Message, ...]:
    """Write the rasters in another coordinate system beside them, and return messages about them.

    ``wanted`` is `MosaicOptions.crs`. What the user did not ask for is left out silently where it cannot be.
    """
    from slam.cli.output_folder import RASTERS_IN_SYSTEM
    from slam.io.exports.geotiff import NO_SYSTEM, UTM, rasters_in, write_rasters

    system = wanted or UTM
    if system.lower() == NO_SYSTEM:
        return ()
    names = {name: RASTERS_IN_SYSTEM[name] for name in rasters_in(folder, estimate)}
    if not names:
        said = warning(f"--crs {system}: there are no rasters to write in it")
        return (said,) if wanted else ()
    if estimate.origin is None:
        said = warning(f"--crs {system}: no rasters in it, since the map was not placed on Earth")
        return (said,) if wanted else ()
    try:
        targets = {name: folder / written for name, written in names.items()}
        colours, *stretch, heights = write_rasters(estimate, folder, targets, system)
    except InputError as refusal:
        return (parsed(f"no rasters in another system: {refusal}"),)
    return (note(f"{', '.join(names.values())}: {colours}", heights), *map(parsed, stretch))


def write_solution(folder: Path, estimate: Estimate, graph: PoseGraph) -> None:
    """Write the files that need no pictures: trajectory, estimate, loops and graph. Raises ``InputError``."""
    from backend.g2o import write_g2o

    write_estimate(estimate, folder)
    with (folder / "graph.g2o").open("w", encoding="ascii") as stream:
        write_g2o(stream, graph)


def write_summary_and_report(
    folder: Path,
    estimate: Estimate,
    flight: Flight | None,
    mosaics: Mosaics = Mosaics(),
    accuracy: Accuracy = Accuracy(),
) -> Results:
    """Write summary.json, report.html and map.html; ``flight`` is None where the input was a graph."""
    from slam.report.map_page.write import write_map_page

    landmarks = len(flight.landmarks) if flight is not None else 0
    summary = summarise(estimate, landmarks, graph_alone=flight is None)
    facts = gather(estimate, flight)
    write_map_page(folder, estimate, flight, facts, summary.status)
    (folder / "summary.json").write_text(json_text(summary.to_json()), encoding="utf-8")
    # Last, as it links to the others.
    write_report(folder / "report.html", estimate, summary, flight, mosaics, accuracy)
    return Results(facts, summary, accuracy.tables, mosaic_facts(mosaics.after, mosaics.quality))


def _ground_messages(ground: GroundFacts, metric: bool) -> list[Message]:
    """Return the sentences about ground that is not flat, and about ground that pictures do not agree on."""
    return [*_relief_messages(ground, metric), *_unmatched_messages(ground, metric)]


def _unmatched_messages(ground: GroundFacts, metric: bool) -> list[Message]:
    if ground.unmatched_at_m is None:
        return []
    x, y = (f"{at:.1f}" for at in ground.unmatched_at_m)
    return [
        note(
            f"mosaic: on {percent(ground.unmatched_share)} of the ground the pictures do not agree, the "
            f"largest piece around x = {x}, y = {y} {unit(metric)}: water, what moves or a surface without "
            "texture",
            "nothing tells heights there",
        )
    ]


def _relief_messages(ground: GroundFacts, metric: bool) -> list[Message]:
    if ground.relief_share == 0:
        return []
    before, after = ground.over_floor_px[-1], ground.misregistration_px[-1]
    if not ground.is_measured:
        return [
            warning(
                f"mosaic: {percent(ground.relief_share)} of the ground is not flat, but no two pictures show "
                "its height",
                "it is drawn as if it were flat, and pictures of 95 % of the ground agree only "
                f"within {after:.2g} px",
                "take pictures that overlap by 60 to 95 %",
            )
        ]
    trusted = percent(ground.trusted_share)
    untrusted = f"trust those of {trusted} of all ground: {ground.untrusted}" if ground.untrusted else ""
    return [
        note(
            f"mosaic: {percent(ground.relief_share)} of the ground is not flat: heights were "
            f"measured, from {length(ground.lowest_m, metric)} to {length(ground.highest_m, metric)} over "
            "the floor",
            untrusted,
            f"pictures of 95 % of the ground agree within {after:.2g} px, on a flat floor it would be "
            f"{before:.2g} px",
        )
    ]


def _write_mosaics(
    folder: Path,
    estimate: Estimate,
    flight: Flight,
    options: MosaicOptions,
    progress: Progress,
    checkpoints: Checkpoints,
) -> tuple[Mosaics, tuple[Message, ...], MosaicFiles | None]:
    """Write the mosaics of the map and of the plain chain, and return warnings and what was made.

    A mosaic that cannot be drawn gives a warning.
    """
    from frontend.mosaic.canvas import MosaicError
    from slam.report.rasters.mosaic import write_chain_picture, write_mosaic

    if not options.wanted:
        return Mosaics(), (), None
    if not np.isfinite(estimate.w_T_b).all(axis=(1, 2)).any():
        return Mosaics(), (warning("no mosaic: no keyframe could be placed", "the status says why"),), None
    chain_picture: Path | None = None
    try:
        earlier = options.previous_output / "mosaic.tif" if options.previous_output else None
        made = write_mosaic(estimate, flight, folder, options.gsd_m, progress, earlier, checkpoints)
    except InputError as refusal:
        if not isinstance(refusal.__context__, MosaicError):
            raise
        return Mosaics(), (parsed(f"no mosaic: {refusal}"),), None
    names: dict[str, list[str]] = {}
    for name, reason in made.not_drawn.items():
        if reason != REDUNDANT:  # summary.json names these
            names.setdefault(reason, []).append(name)
    notes: list[Message] = [
        warning(f"mosaic: {counted(len(of), 'keyframe')} left out: {why} ({listed(of)})")
        for why, of in names.items()
    ]
    if made.partly_drawn:
        of = [f"{name}: {what}" for name, what in made.partly_drawn.items()]
        notes.append(note(f"mosaic: {counted(len(of), 'keyframe')} drawn in part ({listed(of)})"))
    if made.note:
        notes.append(note(f"mosaic: {made.note}"))
    notes += _ground_messages(made.ground.facts, estimate.metric)
    if made.kept:
        kept = (
            f"mosaic: {made.kept} of its {made.tiles} tiles did not change, and were taken over from the "
            "earlier run in this folder"
        )
        notes.append(note(kept))
    try:
        chain = chain_on_result(estimate)
        chain_picture = write_chain_picture(
            estimate, flight, folder, chain, made.png_gsd_m, progress, checkpoints
        )
    except InputError as refusal:
        if not isinstance(refusal.__context__, MosaicError):
            raise
        notes.append(parsed(f"no mosaic of the plain chain: {refusal}"))
    return Mosaics(made.png, chain_picture, made.quality.with_suffix(".png")), tuple(notes), made
