"""``slam live``: map a flight while its pictures arrive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli import options

if TYPE_CHECKING:
    from slam.core.flight import Flight

_SOURCE = typer.Argument(
    metavar="FLIGHT", help="A flight folder or a recording with a camera.", show_default=False
)
_SPEED = typer.Option(
    "--speed",
    metavar="X",
    min=0.01,
    max=1000.0,
    help="Pace of a recorded flight; 1 is that of the recording.",
)
_FOLLOW = typer.Option(
    "--follow",
    metavar="S",
    min=0.1,
    help="The flight folder still grows: map its pictures as they appear, until none came for S seconds.",
)
_PREVIEW = typer.Option(
    "--preview",
    metavar="PICTURE",
    help="Write the mosaic so far to this PNG or JPEG every second.",
    show_default=False,
)
_WIDTH = typer.Option(
    "--width",
    metavar="PX",
    min=64,
    help="Reduce wider pictures to this width, so that tracking keeps pace; the final map has them too.",
)
_WHY_NARROW = ", so that tracking keeps pace; slam optimize uses the whole ones"
_MCAP = typer.Option(
    "--mcap",
    metavar="FILE",
    help="Write poses, pictures and links to this MCAP file in flight, for Foxglove and Rerun.",
    show_default=False,
)

_ENDED = "slam: the flight ends here, and its map is made; press Ctrl-C again to stop without a map"


def live(
    source: Annotated[Path, _SOURCE],
    out: Annotated[Path, options.OUT],
    speed: Annotated[float, _SPEED] = 1.0,
    follow: Annotated[float | None, _FOLLOW] = None,
    preview: Annotated[Path | None, _PREVIEW] = None,
    mcap: Annotated[Path | None, _MCAP] = None,
    width: Annotated[int, _WIDTH] = 320,
    mosaic: Annotated[bool, typer.Option("--mosaic/--no-mosaic", help="Render the mosaic.")] = True,
    config: Annotated[Path | None, options.CONFIG] = None,
    topic: Annotated[list[str] | None, options.TOPICS] = None,
    picture_rate: Annotated[float | None, options.PICTURE_RATE] = None,
    quiet: Annotated[bool, options.QUIET] = False,
    as_json: Annotated[bool, options.JSON] = False,
) -> None:
    """Map a flight while its pictures arrive; after the last one, write what slam optimize writes."""
    from slam.cli.console import Screen
    from slam.cli.live_outputs import check_outputs, live_outputs
    from slam.cli.output_folder import output_folder
    from slam.cli.results import MosaicOptions, write_results
    from slam.cli.signals import noted_interrupt
    from slam.cli.source import open_flight
    from slam.cli.tables import outcome_table
    from slam.core.errors import InputError
    from slam.evaluation.live_error import live_error
    from slam.io.flight_folder import read_flight
    from slam.io.narrow_pictures import with_narrow_pictures
    from slam.mapping.live.arrival import first_state, follow_flight, replay_flight
    from slam.mapping.live.mapper import LiveMapper
    from slam.report.optimize_report import Accuracy
    from slam.report.tables.evaluation import live_table

    check_outputs(preview, mcap)
    screen = Screen(quiet, as_json)
    settings = options.pipeline_config(config, None)
    with output_folder(out) as folder, screen.progress() as progress:

        def read() -> Flight:
            request = options.request_of(topic, picture_rate)
            flight = read_flight(source) if follow is not None else open_flight(source, progress, request)[0]
            if flight.all_keyframes:
                raise InputError(f"{source}: photographs have no times in flight; use slam optimize")
            return with_narrow_pictures(flight, width, _WHY_NARROW)

        flight = read() if follow is None else first_state(read, follow)
        screen.line("Ctrl-C ends the flight, and the map is made of what was flown until then.")
        with LiveMapper(flight, settings) as mapper:
            with live_outputs(mapper, flight, preview, mcap), noted_interrupt(_ENDED) as is_ended:
                if follow is None:
                    replay_flight(mapper, flight, speed, progress, is_ended)
                else:
                    follow_flight(mapper, read, follow, progress, is_ended)
                mapper.close()
            state = mapper.state()
            frames, poses = mapper.keyframes()
            estimate = mapper.finish(progress)
            tables = (live_table(state, live_error(frames, poses, estimate), estimate.metric),)
            # The pictures of the map are those that were mapped; the folder may have changed since.
            choice, accuracy = MosaicOptions(mosaic, None, out), Accuracy(tables)
            results = write_results(folder, estimate, mapper.flight(), choice, progress, accuracy)
    screen.json_file(out / "summary.json")
    screen.print(outcome_table(results.facts, results.summary, results.mosaic))
    for table in tables:
        screen.table(table)
    screen.files([out / name for name in ("report.html", "map.html", "mosaic.png") if (out / name).exists()])
