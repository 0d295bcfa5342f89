"""``slam live``: map a flight while its pictures arrive."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli import options

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.mapping.live.mapper import LiveMapper
    from slam.report.rasters.live_mosaic import LiveMosaic

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
_PREVIEW_S = 1.0
_POLL_S = 0.1
"""Time between two looks at a growing folder, at least."""


def live(
    source: Annotated[Path, _SOURCE],
    out: Annotated[Path, options.OUT],
    speed: Annotated[float, _SPEED] = 1.0,
    follow: Annotated[float | None, _FOLLOW] = None,
    preview: Annotated[Path | None, _PREVIEW] = None,
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
    from slam.cli.output_folder import output_folder
    from slam.cli.results import MosaicOptions, write_results
    from slam.cli.source import open_flight
    from slam.cli.tables import outcome_table
    from slam.core.errors import InputError
    from slam.evaluation.live_error import live_error
    from slam.mapping.live.mapper import LiveMapper
    from slam.mapping.live.narrow_pictures import with_narrow_pictures
    from slam.report.accuracy import live_table

    if preview is not None and preview.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{preview}: --preview writes PNG or JPEG; end the name with .png or .jpg")
    screen = Screen(quiet, as_json)
    settings = options.pipeline_config(config, None)
    with output_folder(out) as folder, screen.progress() as progress:
        request = options.request_of(topic, picture_rate)
        flight = open_flight(source, progress, request)[0] if follow is None else _begun(source, follow)
        if flight.all_keyframes:
            raise InputError(f"{source}: photographs have no times in flight; use slam optimize")
        flight = with_narrow_pictures(flight, width)
        with LiveMapper(flight, settings) as mapper:
            with _preview(mapper, flight, preview):
                if follow is None:
                    _replay(mapper, flight, speed, progress)
                else:
                    flight = _follow(mapper, source, follow, width, progress)
                mapper.close()
            state = mapper.state()
            frames, poses = mapper.keyframes()
            estimate = mapper.finish(progress)
        tables = (live_table(state, live_error(frames, poses, estimate), estimate.metric),)
        results = write_results(folder, estimate, flight, MosaicOptions(mosaic, None, out), progress, tables)
    screen.json_file(out / "summary.json")
    screen.print(outcome_table(results.facts, results.summary))
    for table in tables:
        screen.table(table)
    screen.files([out / name for name in ("report.html", "map.html", "mosaic.png") if (out / name).exists()])


def _replay(mapper: LiveMapper, flight: Flight, speed: float, progress: Progress) -> None:
    """Give the pictures at the pace of the recording; those that cannot be read in time are dropped."""
    frames = flight.frames
    if frames is None:
        return
    stamps_s = frames.stamps_s
    begin = time.perf_counter()
    for k, stamp_s in enumerate(stamps_s.tolist()):
        late_s = time.perf_counter() - begin - (stamp_s - stamps_s[0]) / speed
        if late_s < 0:
            time.sleep(-late_s)
        next_s = (stamps_s[min(k + 1, len(stamps_s) - 1)] - stamp_s) / speed
        # The reader itself is too slow where the next picture is due already.
        image = frames.load(k) if k + 1 == len(stamps_s) or late_s < next_s else None
        mapper.add(image, stamp_s)
        progress("live", k + 1, len(stamps_s))


def _begun(folder: Path, idle_s: float) -> Flight:
    """Return a growing flight once it has a picture, or after ``idle_s``. Raises ``InputError`` where it
    cannot be read then."""
    from slam.core.errors import InputError
    from slam.io.flight_folder import read_flight

    begin = time.perf_counter()
    while True:
        in_time = time.perf_counter() - begin < idle_s
        try:
            flight = read_flight(folder)
            if flight.camera is not None or not in_time:
                return flight
        except InputError:
            if not in_time:
                raise
        time.sleep(_POLL_S)


def _follow(mapper: LiveMapper, folder: Path, idle_s: float, width_px: int, progress: Progress) -> Flight:
    """Give the pictures of a growing flight folder as they appear, and return the flight at its end."""
    from slam.io.flight_folder import read_flight
    from slam.mapping.live.narrow_pictures import with_narrow_pictures

    given, newest_s, behind = 0, time.perf_counter(), True
    while True:
        begin = time.perf_counter()
        flight = with_narrow_pictures(read_flight(folder), width_px)
        mapper.refresh(flight)
        frames = flight.frames
        count = 0 if frames is None else len(frames)
        while frames is not None and given < count:
            image = frames.load(given)
            if image is None and given + 1 == count and begin - newest_s < idle_s:
                break  # it may still be written
            # What was there before this command began is no reason to drop pictures.
            mapper.add(image, float(frames.stamps_s[given]), wait=behind)
            given, newest_s = given + 1, time.perf_counter()
            progress("live", given, 0)
        behind = False
        if time.perf_counter() - newest_s > idle_s:
            return flight
        time.sleep(max(_POLL_S, time.perf_counter() - begin))


@contextmanager
def _preview(mapper: LiveMapper, flight: Flight, path: Path | None) -> Iterator[None]:
    """Write the mosaic so far to a picture in a thread until the block ends."""
    if path is None:
        yield
        return
    from slam.report.rasters.live_mosaic import LiveMosaic

    assert flight.camera is not None
    drawn, ended = LiveMosaic(flight.camera, mapper.picture), threading.Event()

    def run() -> None:
        while not ended.wait(_PREVIEW_S):
            _draw(drawn, mapper, path)
        _draw(drawn, mapper, path)

    with ThreadPoolExecutor(1, "preview") as pool:
        job = pool.submit(run)
        try:
            yield
        finally:
            ended.set()
        job.result()


def _draw(drawn: LiveMosaic, mapper: LiveMapper, path: Path) -> None:
    import cv2

    from slam.io.atomic import write_whole

    picture = drawn.update(*mapper.keyframes())
    if picture is not None:
        write_whole(path, cv2.imencode(path.suffix.lower(), picture)[1].tobytes())
