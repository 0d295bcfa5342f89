"""Recognises the kind of a path on the command line by its content, not by its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from slam.core.errors import InputError

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.progress import Progress

Kind = Literal["flight", "euroc", "photos", "graph"]

_GRAPH_WORDS = (b"VERTEX_", b"EDGE_", b"FIX ")
_GIVE = "give a flight folder, a folder of photos or a .g2o graph"
_ALSO = {
    "optimize": "; to slam optimize and info its graph can be given, {path}/graph.g2o",
    "criticise": "; as --model give its {path}/extended.toml",
}
"""Files of an output that other commands accept: command -> advice."""
_NOT_READ = {
    ".bag": "a ROS 1 bag",
    ".db3": "a ROS 2 bag",
    ".mcap": "an MCAP recording",
    ".ulg": "a PX4 log",
    ".mp4": "a video",
    ".zip": "an archive",
}


def kind_of(path: Path) -> Kind:
    """Return whether a path is a flight folder, a EuRoC folder, a folder of photos or a g2o graph.

    Raises ``InputError`` that names what was found instead.
    """
    if not path.exists():
        raise InputError(f"{path}: does not exist; {_GIVE}")
    if path.is_dir():
        _refuse_output(path)
        return _kind_of_folder(path)
    if not path.is_file():
        raise InputError(f"{path}: neither a file nor a folder; {_GIVE}")
    if path.suffix.lower() == ".g2o" or _reads_like_graph(path):
        return "graph"
    if found := _NOT_READ.get(path.suffix.lower()):
        raise InputError(
            f"{path}: {found}, which slam does not read; make a flight folder of it (docs/flight-format.md)"
        )
    raise InputError(f"{path}: a file of another kind; {_GIVE}")


def open_flight(path: Path, progress: Progress) -> tuple[Flight, Kind]:
    """Read the flight at ``path``; import photos and EuRoC recordings. Raises ``InputError``."""
    kind = kind_of(path)
    if kind == "flight":
        from slam.io.flight_folder import read_flight

        return read_flight(path), kind
    return import_source(path, progress), kind


def import_source(path: Path, progress: Progress) -> Flight:
    """Import photos or a EuRoC recording as a flight. Raises ``InputError``."""
    kind = kind_of(path)
    if kind == "graph":
        raise InputError(f"{path}: a pose graph holds no flight; give a flight folder or a folder of photos")
    if kind == "photos":
        from slam.io.photos import import_photos

        return import_photos(path, progress)
    if (path / "flight.yaml").exists():
        raise InputError(f"{path}: is a flight folder already; use it as it is")
    from slam.io.euroc import import_euroc

    return import_euroc(path)


def _refuse_output(path: Path) -> None:
    """Raise ``InputError`` for an output folder: its pictures are not photographs."""
    from slam.cli.output_folder import writer_of

    if command := writer_of(path):
        also = _ALSO.get(command, "").format(path=path)
        raise InputError(
            f"{path}: is the output of slam {command}, no flight; give the flight that it was made of{also}"
        )


def _kind_of_folder(path: Path) -> Kind:
    from slam.io.euroc import is_euroc
    from slam.io.photo_set import holds_photos

    root = path.resolve().parent if path.resolve().name == "mav0" else path
    if (root / "mav0").is_dir():
        return "euroc" if is_euroc(root) else "flight"
    holds_flights = any(True for depth in ("*", "*/*") for _ in path.glob(f"{depth}/mav0"))
    # The reader of flights refuses a folder of another kind and names what it found.
    return "photos" if not holds_flights and holds_photos(path) else "flight"


def _reads_like_graph(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(200).lstrip().startswith(_GRAPH_WORDS)
