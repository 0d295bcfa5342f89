"""Files that ``slam live`` writes while pictures arrive: a picture of the mosaic, and messages."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from backend.measurements import CONTRADICTED
from slam.core.errors import InputError, explain

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.mapping.live.mapper import LiveMapper

_INTERVAL_S = 1.0
_CHUNK_BYTES = 1 << 16
"""Part of the file that is lost if the program is killed: some pictures."""


def check_outputs(preview: Path | None, mcap: Path | None) -> None:
    """Raise ``InputError`` for places and kinds of files that cannot be written."""
    from slam.io.exports.foxglove.foxglove_file import require_packages
    from slam.io.files import refusal

    if preview is not None and preview.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{preview}: --preview writes PNG or JPEG; end the name with .png or .jpg")
    if mcap is not None:
        require_packages()
        if mcap.exists() or mcap.is_symlink():
            raise refusal(mcap, "exists already", "name another place with --mcap, or remove it")


@contextmanager
def live_outputs(
    mapper: LiveMapper, flight: Flight, preview: Path | None, mcap: Path | None
) -> Iterator[None]:
    """Write the files every second until the block ends, and once more then. Raises ``InputError``."""
    with ExitStack() as outputs:
        if preview is not None:
            outputs.enter_context(_repeated(_preview(mapper, flight, preview)))
        if mcap is not None:
            outputs.enter_context(_messages(mapper, flight, mcap))
        yield


@contextmanager
def _repeated(update: Callable[[bool], None]) -> Iterator[None]:
    """Call ``update(False)`` every second in a thread until the block ends, and then ``update(True)``."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(_INTERVAL_S):
            update(False)
        update(True)

    with ThreadPoolExecutor(1, "live output") as pool:
        job = pool.submit(run)
        try:
            yield
        finally:
            ended.set()
        job.result()


def _preview(mapper: LiveMapper, flight: Flight, path: Path) -> Callable[[bool], None]:
    import cv2

    from slam.io.atomic import write_whole
    from slam.report.rasters.live_mosaic import LiveMosaic

    assert flight.camera is not None
    drawn = LiveMosaic(flight.camera, mapper.picture)

    def draw(is_end: bool) -> None:
        picture = drawn.update(*mapper.keyframes())
        if picture is not None:
            write_whole(path, cv2.imencode(path.suffix.lower(), picture)[1].tobytes())

    return draw


@contextmanager
def _messages(mapper: LiveMapper, flight: Flight, path: Path) -> Iterator[None]:
    """Write new keyframes, path and links to an MCAP file."""
    import numpy as np

    from slam.io.exports.foxglove.foxglove_file import new_mcap
    from slam.io.exports.foxglove.live_map import LiveMap

    assert flight.camera is not None
    facts = {"name": flight.name, "status": "in flight: poses are relative to the first keyframe"}
    try:
        with new_mcap(path, facts, _CHUNK_BYTES) as file:
            grown = LiveMap(file, flight.camera, mapper.picture)

            def update(is_end: bool) -> None:
                found = mapper.links()  # before the keyframes, so that these have all its ends
                frames, w_T_b = mapper.keyframes()
                stamps = mapper.flight().frames
                assert stamps is not None
                stamps_ns = flight.epoch_ns + np.round(stamps.stamps_s[frames] * 1e9).astype(np.int64)
                links = {
                    "neighbours": [(e.i, e.j) for e in found if e.is_kept and e.kind == "odometry"],
                    "kept": [(e.i, e.j) for e in found if e.is_kept and e.kind == "loop"],
                    CONTRADICTED: [(e.i, e.j) for e in found if not e.is_kept],
                }
                pairs = {name: np.array(ends, dtype=np.int64).reshape(-1, 2) for name, ends in links.items()}
                grown.update(frames, stamps_ns, w_T_b, pairs, is_end)

            with _repeated(update):
                yield
    except OSError as error:
        if error.filename is not None and Path(error.filename) != path:
            raise
        raise InputError(f"{path}: cannot be written: {explain(error)}") from error
