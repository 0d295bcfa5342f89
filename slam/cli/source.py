"""Recognises the kind of a path on the command line by its content, not by its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from slam.core.errors import InputError
from slam.core.names import listed
from slam.io.content import HEAD_BYTES, content_name

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.progress import Progress
    from slam.io.recordings.choice import Request

Kind = Literal["flight", "euroc", "photos", "recording", "archive", "graph"]

_GRAPH_WORDS = (b"VERTEX_", b"EDGE_", b"FIX ")
_GIVE = "give a flight folder, a folder of photos, a recording (docs/recordings.md) or a .g2o graph"
_ALSO = {
    "optimize": "; to slam optimize and info its graph can be given, {path}/graph.g2o",
    "criticise": "; as --model give its {path}/extended.toml",
}
"""Files of an output that other commands accept: command -> advice."""


def kind_of(path: Path) -> Kind:
    """Return whether a path is a flight folder, EuRoC, photos, a recording, an archive or a g2o graph.

    Raises ``InputError`` that names what was found instead.
    """
    if not path.exists():
        raise InputError(f"{path}: does not exist; {_GIVE}")
    if path.is_dir():
        _refuse_output(path)
        return "recording" if _is_recording(path) else _kind_of_folder(path)
    if not path.is_file():
        raise InputError(f"{path}: neither a file nor a folder; {_GIVE}")
    found = _content_of(path)
    if _reads_like_graph(path) or (path.suffix.lower() == ".g2o" and found in ("", "an empty file")):
        return "graph"
    if _is_recording(path):
        return "recording"
    if _is_archive(path):
        return "archive"
    what = f"is {found}, which slam does not read" if found else "a file of another kind"
    raise InputError(f"{path}: {what}; {_GIVE}")


def open_flight(path: Path, progress: Progress, request: Request | None = None) -> tuple[Flight, Kind]:
    """Read the flight at ``path``; import photos, EuRoC and other recordings.

    ``request`` says what to take from a recording. Raises ``InputError``.
    """
    kind = kind_of(path)
    if kind == "archive":
        from slam.io.recordings.archive import unpacked

        found = unpacked(path, progress)
        return found.warned(open_flight(found.source, progress, request)[0]), kind
    if kind == "flight" and (request is None or request.is_empty):
        from slam.io.flight_folder import read_flight

        return read_flight(path), kind
    return import_source(path, progress, request), kind


def import_source(
    path: Path, progress: Progress, request: Request | None = None, band: str | None = None
) -> Flight:
    """Import photos, a EuRoC recording or another one as a flight.

    ``band`` selects the photographs of a multispectral camera. Raises ``InputError``.
    """
    kind = kind_of(path)
    if kind == "archive":
        from slam.io.recordings.archive import unpacked

        # A flight folder in an archive is converted too, into one that can be read at once.
        if band is None:
            return open_flight(path, progress, request)[0]
        found = unpacked(path, progress)
        return found.warned(import_source(found.source, progress, request, band))
    if kind == "graph":
        raise InputError(f"{path}: a pose graph holds no flight; give a flight folder or a folder of photos")
    if band is not None and kind != "photos":
        raise InputError(f"--band: {path} is no folder of photographs; leave --band out")
    if kind == "recording":
        from slam.io.recordings.assemble import flight_of
        from slam.io.recordings.choice import Request
        from slam.io.recordings.formats import open_recording

        return flight_of(open_recording(path), request or Request(), progress)
    if request is not None and not request.is_empty:
        raise InputError(f"{path}: --topic and --picture-rate are for recordings; leave them out")
    if kind == "photos":
        from slam.io.photos.import_photos import import_photos

        return import_photos(path, progress, band)
    if (path / "flight.yaml").exists():
        raise InputError(f"{path}: is a flight folder already; use it as it is")
    from slam.io.euroc import import_euroc

    return import_euroc(path)


def _is_recording(path: Path) -> bool:
    from slam.io.recordings.formats import format_of

    return format_of(path) is not None


def _is_archive(path: Path) -> bool:
    from slam.io.recordings.archive import is_archive

    return is_archive(path)


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
    from slam.io.files import is_inside
    from slam.io.photos.search import holds_photos
    from slam.io.recordings.archive import recordings_in

    root = path.resolve().parent if path.resolve().name == "mav0" else path
    if (root / "mav0").is_dir():
        return "euroc" if is_euroc(root) else "flight"
    # A link may lead to a folder above, whose flights are not those of this folder.
    holds_flights = any(
        is_inside(found, path) for depth in ("*", "*/*") for found in path.glob(f"{depth}/mav0")
    )
    if not holds_flights and holds_photos(path):
        return "photos"
    if not holds_flights and (found := recordings_in(path, path.iterdir())[0]):
        names = listed([each.name for each in found])
        advice = "give it itself" if len(found) == 1 else "give one, or those of one flight to slam import"
        raise InputError(f"{path}: is a folder of recordings ({names}); {advice}")
    # The reader of flights refuses a folder of another kind and names what it found.
    return "flight"


def _content_of(path: Path) -> str:
    with path.open("rb") as stream:
        return content_name(stream.read(HEAD_BYTES))


def _reads_like_graph(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(200).lstrip().startswith(_GRAPH_WORDS)
