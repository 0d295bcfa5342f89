"""``slam estimate``: estimate a flight's motion from its instruments; no camera is needed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam.cli.options import JSON, MODEL, OUT, QUIET, TOPICS, pipeline_config, read_model, request_of

if TYPE_CHECKING:
    from slam.core.figure_table import FigureTable
    from slam.core.flight import Flight
    from slam.inertial.navigate import Navigation

_SOURCE = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder or a recording, with imu0, or velocity0 and attitude0.",
    show_default=False,
)
_RATE = typer.Option("--rate", metavar="HZ", min=0.01, max=2000, help="Poses per second.")
_WITHOUT = typer.Option(
    "--without",
    metavar="STREAM",
    help="A stream to leave out, such as gps0, for a comparison with it. Can be repeated.",
)
_CONFIG = typer.Option(metavar="FILE.toml", help="Settings; those of \\[inertial] count here.")

_USED_STREAMS = ("imu", "attitude", "velocity", "sonar", "gps", "barometer")
"""Fields of ``Flight`` that the filter reads; leaving out another would change nothing."""


def estimate(
    source: Annotated[Path, _SOURCE],
    out: Annotated[Path, OUT],
    rate: Annotated[float, _RATE] = 20.0,
    without: Annotated[list[str] | None, _WITHOUT] = None,
    config: Annotated[Path | None, _CONFIG] = None,
    model: Annotated[str | None, MODEL] = None,
    topic: Annotated[list[str] | None, TOPICS] = None,
    quiet: Annotated[bool, QUIET] = False,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Estimate where a vehicle was from IMU, attitude, range, velocity, GPS and barometer alone."""
    from slam.cli.console import Screen
    from slam.cli.output_folder import output_folder
    from slam.cli.source import open_flight
    from slam.cli.sources_table import show_sources
    from slam.inertial.navigate import navigate

    screen = Screen(quiet, as_json)
    settings = pipeline_config(config, None)
    instruments = read_model(model)
    with output_folder(out) as folder, screen.progress() as progress:
        opened, _ = open_flight(source, progress, request_of(topic))
        show_sources(opened, screen)
        flight = _without(opened, without or [])
        if instruments is not None:
            from slam.simulation.inverse import correct_flight

            result = correct_flight(flight, instruments)
            flight = result.flight.with_warning(result.summary(instruments))
        navigation = navigate(flight, settings.inertial, rate, progress)
        write_navigation(folder, navigation)
    screen.json_file(out / "summary.json")
    screen.table(figures(navigation))
    screen.files([out / "estimate.png", out / "trajectory.tum"])


def _without(flight: Flight, names: list[str]) -> Flight:
    """Return the flight without some streams. Raises ``InputError`` for an unknown stream."""
    from dataclasses import replace

    from slam.core.errors import InputError
    from slam.core.streams import FIELD_BY_FOLDER, STREAMS

    folders = [STREAMS[field].folder for field in _USED_STREAMS]
    for name in names:
        if name not in folders:
            near = [folder for folder in folders if folder.rstrip("0") == name.rstrip("0123456789")]
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"--without {name}: no such stream; {hint}there are {', '.join(folders)}")
        nothing: dict[str, Any] = {FIELD_BY_FOLDER[name]: None}
        flight = replace(flight, **nothing)
    return flight


def write_navigation(folder: Path, navigation: Navigation) -> None:
    """Write trajectory, estimate, picture and summary. Raises ``InputError`` where the disk refuses."""
    from slam.core.summary import json_text
    from slam.inertial.summary import summary_record
    from slam.io.atomic import write_whole
    from slam.io.estimate import write_estimate
    from slam.report.pictures.estimate import estimate_picture

    write_estimate(navigation.estimate, folder, loops=False)
    write_whole(folder / "estimate.png", estimate_picture(navigation.estimate, navigation.track))
    write_whole(folder / "summary.json", json_text(summary_record(navigation)).encode())


def figures(navigation: Navigation) -> FigureTable:
    """Return the table that is printed at the end."""
    import numpy as np

    from slam.cli.tables import warning_rows
    from slam.core.figure_table import FigureTable
    from slam.core.units import length
    from slam.inertial.navigate import downweight_counts, rejection_counts
    from slam.report.facts import position_sigma_m

    found, track = navigation.estimate, navigation.track
    sigma = position_sigma_m(found.covariances)
    way_m = float(np.linalg.norm(np.diff(found.w_T_b[:, :3, 3], axis=0), axis=1).sum())
    seconds = float(found.stamps_s[-1] - found.stamps_s[0])
    rows = [
        ("status", found.status),
        ("poses", f"{len(found.stamps_s)} over {seconds:.1f} s, {length(way_m)} of way"),
        (
            "position, 1σ",
            f"typically {length(float(np.median(sigma)))}, {length(float(sigma.max()))} where least certain",
        ),
    ]
    for name, channel in track.channels.items():
        mean = "–" if channel.mean_nis is None else f"{channel.mean_nis:.2f}"
        used = f"{channel.accepted.any(axis=1).sum()} of {len(channel.stamps_s)} readings"
        rows.append((f"{name}, mean NIS (1 is right)", f"{mean} over {used}"))
    for name, counted in (("left out", rejection_counts(track)), ("weighed less", downweight_counts(track))):
        rows.append((name, ", ".join(f"{n} x {why}" for why, n in counted.items()) or "nothing"))
    if found.accuracy_basis:
        rows.append(("accuracy", found.accuracy_basis))
    rows.append(("time", f"{sum(found.timing_s.values()):.1f} s"))
    rows += warning_rows(found.messages)
    return FigureTable(found.name, (), tuple(rows))
