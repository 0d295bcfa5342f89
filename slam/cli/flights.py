"""``slam import`` and ``slam info``: convert recordings into flight folders, and show what a flight holds."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import FLIGHT_OUT, JSON, PICTURE_RATE, QUIET, TOPICS, refuse_flight_options, request_of
from slam.core.errors import InputError

if TYPE_CHECKING:
    from slam.cli.console import Screen
    from slam.core.flight import Flight
    from slam.core.flight_info import FlightInfo

_IMPORTED = typer.Argument(
    metavar="SOURCE",
    help="A recording (log, bag or video), a EuRoC folder, or a folder of geotagged photos. Several sources "
    "of one flight, such as a video and a log, are brought onto one clock.",
    show_default=False,
)
_SHOWN = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a recording, a folder of photos, or a .g2o pose graph.",
    show_default=False,
)
_OFFSETS = typer.Option(
    metavar="STREAM=SECONDS",
    help="Seconds by which the source of a stream, such as cam0, begins after the vehicle's log; default: "
    "estimated. Can be repeated.",
    show_default=False,
)
_BAND = typer.Option(
    metavar="NAME",
    help="Band of a multispectral camera, such as green or nir; default: colour, else the largest.",
    show_default=False,
)


_WIDTH = typer.Option(
    "--width",
    metavar="PX",
    min=32,
    help="Reduce wider pictures to this width, which takes less time and disk; default: as recorded.",
    show_default=False,
)


def import_flight(
    sources: Annotated[list[Path], _IMPORTED],
    out: Annotated[Path, FLIGHT_OUT],
    topic: Annotated[list[str] | None, TOPICS] = None,
    picture_rate: Annotated[float | None, PICTURE_RATE] = None,
    offset: Annotated[list[str] | None, _OFFSETS] = None,
    band: Annotated[str | None, _BAND] = None,
    width: Annotated[int | None, _WIDTH] = None,
    quiet: Annotated[bool, QUIET] = False,
) -> None:
    """Convert a recording or photos into a flight folder; pictures keep their names."""
    from slam.cli.console import Screen
    from slam.cli.one_flight import offsets_of, open_one_flight
    from slam.cli.source import import_source
    from slam.io.atomic import check_free
    from slam.io.flight_folder import write_flight
    from slam.io.narrow_pictures import with_narrow_pictures

    screen, request, offsets_s = Screen(quiet), request_of(topic, picture_rate), offsets_of(offset)
    if len(sources) == 1 and offsets_s:
        raise InputError("--offset: there is one source, and so one clock; leave --offset out")
    if len(sources) > 1 and band is not None:
        raise InputError("--band: several sources are no folder of photographs; leave --band out")
    check_free(out)
    with screen.progress() as progress:
        flight = (
            import_source(sources[0], progress, request, band)
            if len(sources) == 1
            else open_one_flight(sources, progress, request, offsets_s)
        )
        if width is not None:
            flight = with_narrow_pictures(flight, width, ", as --width asks")
        write_flight(flight, out, progress)
    show(flight, screen)
    screen.files([out])


def info(
    context: typer.Context,
    source: Annotated[Path, _SHOWN],
    topic: Annotated[list[str] | None, TOPICS] = None,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Show what a flight holds: sensors, rates, gaps, missing streams and anomalies."""
    from slam.cli.console import Screen
    from slam.cli.source import kind_of, open_flight
    from slam.core.progress import silent
    from slam.core.summary import json_text

    screen = Screen(as_json=as_json)
    if kind_of(source) == "graph":
        from slam.cli.graph import graph_record, graph_table

        refuse_flight_options(source, context)
        record = graph_record(source)
        screen.json(json_text(record))
        screen.table(graph_table(record))
        return
    flight, _ = open_flight(source, silent, request_of(topic))
    screen.json(json_text(asdict(_described(flight))))
    show(flight, screen)


def show(flight: Flight, screen: Screen) -> None:
    """Print what a flight holds."""
    from slam.cli.console import console
    from slam.cli.flight_tables import print_info
    from slam.cli.sources_table import show_sources

    if screen.shows_tables:
        print_info(_described(flight), console())
        show_sources(flight, screen)


def _described(flight: Flight) -> FlightInfo:
    """Describe a flight, with the anomalies of its readings."""
    from slam.core.flight_info import describe
    from slam.data_quality import readings_in_words

    info = describe(flight)
    return replace(info, anomalies=(*info.anomalies, *readings_in_words(flight)))
