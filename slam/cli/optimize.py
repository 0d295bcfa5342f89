"""``slam optimize``: make a map of a flight, or solve a pose graph with the back end alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from frontend.feature_kinds import FeatureKind
from slam.cli import options

if TYPE_CHECKING:
    from slam.cli.console import Screen
    from slam.cli.results import MosaicOptions, Results
    from slam.core.checkpoints import Checkpoints
    from slam.core.estimate import Estimate
    from slam.core.figure_table import FigureTable
    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.io.recordings.choice import Request
    from slam.mapping.config import PipelineConfig
    from slam.simulation.model import Model

_SOURCE = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a recording, a folder of photos, or a .g2o pose graph. Several flights of "
    "one camera over the same ground make one map.",
    show_default=False,
)
_INCREMENTAL = typer.Option(
    "--incremental",
    help="Also solve the pose graph keyframe by keyframe, as on board, and compare it with the batch.",
)
_MCAP = typer.Option(
    "--mcap",
    help="Also write map.mcap for Foxglove and Rerun: poses, pictures, ground and links.",
)
_GSD = typer.Option(
    metavar="M",
    min=1e-4,
    max=100.0,
    help="Metres per pixel of the mosaic; default: the resolution of the pictures.",
)
_CRS = typer.Option(
    "--crs",
    metavar="SYSTEM",
    help="Also write the rasters in this coordinate system: utm (the zone of the map's origin), EPSG: and a "
    "number, or none; default: utm for a map with a place on Earth.",
)
_GCP = typer.Option(
    "--gcp",
    metavar="FILE",
    help="Control points: gcp_list.txt of OpenDroneMap; default: the one in the folder of the flight.",
)
_CHECK = typer.Option(
    "--check",
    metavar="NAME",
    help="A control point to hold out and compare the map with. Can be repeated.",
)
_GCP_STD = typer.Option(
    metavar="M", min=1e-4, max=100.0, help="Standard deviation of the control points; default: 0.02."
)


@dataclass(frozen=True)
class _FlightOptions:
    """Options of flights, those of the mosaic apart."""

    settings: PipelineConfig
    model: str | None
    incremental: bool
    mcap: bool
    gcp: Path | None
    check: tuple[str, ...]
    gcp_std_m: float | None
    resume: bool


def optimize(
    context: typer.Context,
    sources: Annotated[list[Path], _SOURCE],
    out: Annotated[Path, options.OUT],
    gsd: Annotated[float | None, _GSD] = None,
    mosaic: Annotated[bool, typer.Option("--mosaic/--no-mosaic", help="Render the mosaic.")] = True,
    crs: Annotated[str | None, _CRS] = None,
    config: Annotated[Path | None, options.CONFIG] = None,
    features: Annotated[FeatureKind | None, options.FEATURES] = None,
    model: Annotated[str | None, options.MODEL] = None,
    incremental: Annotated[bool, _INCREMENTAL] = False,
    mcap: Annotated[bool, _MCAP] = False,
    gcp: Annotated[Path | None, _GCP] = None,
    check: Annotated[list[str] | None, _CHECK] = None,
    gcp_std: Annotated[float | None, _GCP_STD] = None,
    topic: Annotated[list[str] | None, options.TOPICS] = None,
    picture_rate: Annotated[float | None, options.PICTURE_RATE] = None,
    resume: Annotated[bool, options.RESUME] = True,
    cluster: Annotated[bool, options.CLUSTER] = False,
    scheduler: Annotated[str | None, options.SCHEDULER] = None,
    quiet: Annotated[bool, options.QUIET] = False,
    as_json: Annotated[bool, options.JSON] = False,
) -> None:
    """Make one consistent map of a flight, or of several: trajectory, graph, mosaic and a report."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import MAP_MCAP
    from slam.cli.results import MosaicOptions
    from slam.cli.source import kind_of
    from slam.cli.tables import outcome_table

    screen = Screen(quiet, as_json)
    if len(sources) == 1 and kind_of(sources[0]) == "graph":
        options.refuse_flight_options(sources[0], context)
        results = _graph(sources[0], out, screen)
    else:
        mosaics = MosaicOptions(mosaic, gsd, out, crs)
        settings = options.pipeline_config(config, features)
        wanted = _FlightOptions(settings, model, incremental, mcap, gcp, tuple(check or ()), gcp_std, resume)
        request = options.request_of(topic, picture_rate)
        with options.on_cluster(cluster, scheduler):
            results = _flights(sources, request, out, mosaics, wanted, screen)
    screen.json_file(out / "summary.json")
    screen.print(outcome_table(results.facts, results.summary, results.mosaic))
    for table in results.tables:
        screen.table(table)
    first = [out / name for name in ("report.html", "map.html", "mosaic.png", MAP_MCAP)]
    screen.files([path for path in first if path.exists()])


def _flights(
    sources: list[Path],
    request: Request,
    out: Path,
    mosaic: MosaicOptions,
    wanted: _FlightOptions,
    screen: Screen,
) -> Results:
    from slam.cli.checkpoints import checkpoints_beside
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.sources_table import show_sources
    from slam.io.exports.foxglove.foxglove_file import require_packages

    instruments = options.read_model(wanted.model)
    if wanted.mcap:
        require_packages()
    if mosaic.crs is not None:
        _refuse_system(mosaic.crs, mosaic.wanted)
    with output_folder(out) as folder, screen.progress() as progress:
        flights = []
        for source in sources:
            flight, kind = open_flight(source, progress, request)
            flights.append(flight)
            if kind != "flight":
                screen.line(f"{source}: {kind}, imported on the fly")
            show_sources(flight, screen)
        flight = _joined(flights, wanted)
        if mosaic.crs is not None:
            _refuse_place(mosaic.crs, flight)
        with checkpoints_beside(folder, flight, wanted.settings, wanted.resume, screen.note) as checkpoints:
            if instruments is not None:
                return _corrected(instruments, flights, flight, folder, mosaic, wanted, progress, checkpoints)
            estimate, tables = _mapped(flight, wanted, progress, checkpoints)
            return _written(folder, estimate, flight, mosaic, wanted, progress, tables, checkpoints)


def _refuse_system(system: str, has_mosaic: bool) -> None:
    """Raise ``InputError`` for a coordinate system that no raster can have, before flights are read."""
    from slam.core.errors import InputError
    from slam.io.exports.geotiff import NO_SYSTEM, named_system

    if system.lower() == NO_SYSTEM:
        return
    if not has_mosaic:
        raise InputError(f"--crs {system}: with --no-mosaic there are no rasters to write in it")
    named_system(system)


def _refuse_place(system: str, flight: Flight) -> None:
    """Raise ``InputError`` for a flight whose map cannot lie in the system, before it is mapped."""
    from slam.core.errors import InputError
    from slam.io.exports.geotiff import NO_SYSTEM, coordinate_system

    if system.lower() == NO_SYSTEM:
        return
    origin = flight.geo_origin()
    if origin is None:
        raise InputError(
            f"--crs {system}: the flight has no place on Earth; give positions (gps0, or photographs that "
            "have them) or control points, or leave --crs out"
        )
    coordinate_system(system, origin)


def _joined(flights: list[Flight], wanted: _FlightOptions) -> Flight:
    """Return the flights as one, with the control points that the options give."""
    from slam.core.control_points import SurveyedPoint
    from slam.core.join_flights import join_flights
    from slam.core.surveyed_flight import with_surveyed
    from slam.io.gcp_list import read_gcp_list, without_own_points

    if wanted.gcp is not None:
        flights = [without_own_points(flight) for flight in flights]
    flight, points = join_flights(flights), tuple[SurveyedPoint, ...]()
    if wanted.gcp is not None:
        points, notes = read_gcp_list(wanted.gcp, flight)
        flight = flight.with_warning(*notes)
    return with_surveyed(flight, points, wanted.check, wanted.gcp_std_m)


def _written(
    folder: Path,
    estimate: Estimate,
    flight: Flight,
    mosaic: MosaicOptions,
    wanted: _FlightOptions,
    progress: Progress,
    tables: tuple[FigureTable, ...],
    checkpoints: Checkpoints,
) -> Results:
    """Write all files of the map."""
    from slam.cli.results import write_results
    from slam.report.optimize_report import Accuracy

    return write_results(
        folder, estimate, flight, mosaic, progress, Accuracy(tables), wanted.mcap, checkpoints
    )


def _mapped(
    flight: Flight, wanted: _FlightOptions, progress: Progress, checkpoints: Checkpoints
) -> tuple[Estimate, tuple[FigureTable, ...]]:
    """Return the map, and the table that ``--incremental`` asks for."""
    from slam.core.heap import trim_heap
    from slam.evaluation.keyframe_by_keyframe import keyframe_by_keyframe
    from slam.mapping.pipeline import optimize_with_observations
    from slam.report.tables.evaluation import keyframe_by_keyframe_table

    estimate, observations = optimize_with_observations(
        flight, wanted.settings, progress, checkpoints=checkpoints
    )
    tables: tuple[FigureTable, ...] = ()
    if wanted.incremental:
        compared = keyframe_by_keyframe(flight, observations, wanted.settings, progress)
        tables = (keyframe_by_keyframe_table(compared),)
    del observations
    trim_heap()
    return estimate, tables


def _corrected(
    model: Model,
    flights: list[Flight],
    recorded: Flight,
    folder: Path,
    mosaic: MosaicOptions,
    wanted: _FlightOptions,
    progress: Progress,
    checkpoints: Checkpoints,
) -> Results:
    """Map corrected readings; with truth, compare the map with that of the readings as ``recorded``."""
    from slam.cli.output_folder import MODEL_NAME
    from slam.evaluation.map_gain import can_be_compared, map_gain
    from slam.report.tables.evaluation import map_gain_table
    from slam.simulation.inverse import correct_flight
    from slam.simulation.model import save_model

    save_model(model, folder / MODEL_NAME)
    results = [correct_flight(flight, model) for flight in flights]
    flight = _joined([each.flight.with_warning(each.summary(model)) for each in results], wanted)
    estimate, tables = _mapped(flight, wanted, progress, checkpoints)
    if any(each.corrected_terms for each in results) and can_be_compared(recorded):
        tables = (map_gain_table([map_gain(recorded, flight, estimate, wanted.settings, progress)]), *tables)
    return _written(folder, estimate, flight, mosaic, wanted, progress, tables, checkpoints)


def _graph(source: Path, out: Path, screen: Screen) -> Results:
    from slam.cli.graph import solve_graph
    from slam.cli.output_folder import output_folder
    from slam.cli.results import write_solution, write_summary_and_report

    with output_folder(out, [source]) as folder, screen.progress() as progress:
        estimate, solved = solve_graph(source, progress)
        write_solution(folder, estimate, solved)
        return write_summary_and_report(folder, estimate, None)
