"""ZIP archives of recordings, unpacked into a temporary folder that disappears with the program."""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import Message, parsed
from slam.core.names import listed
from slam.core.progress import Progress
from slam.io.files import brief, refusal
from slam.io.photos.search import holds_photos
from slam.io.recordings.formats import format_of
from slam.io.recordings.readers import is_seek_error

STARTS = (b"PK\x03\x04", b"PK\x05\x06")
"""First bytes of a ZIP archive; the second of an empty one."""
_BLOCK_BYTES = 1 << 20
_MAX_NAMED = 6
_COMPANIONS = (".srt", ".csv")
"""Files that belong to a video of their name, or list photographs."""
_unpacked: list[tempfile.TemporaryDirectory[str]] = []
"""Folders that pictures are read from until the program ends."""


def is_archive(path: Path) -> bool:
    """Return whether a path is a ZIP archive, by its first bytes."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) in STARTS


@dataclass(frozen=True)
class Unpacked:
    """The source that an archive holds."""

    source: Path
    """A flight, a recording, or a folder of photographs."""
    warnings: tuple[Message, ...] = ()
    """A line for each damaged recording beside it."""

    def warned(self, flight: Flight) -> Flight:
        """Return the flight of the source with the warnings of the archive."""
        return replace(flight, messages=(*self.warnings, *flight.messages))


def unpacked(path: Path, progress: Progress, is_inner: bool = False) -> Unpacked:
    """Unpack an archive and return the flight, recording or folder of photographs in it.

    An archive that is all that another one holds is unpacked too, unless ``is_inner``. Raises ``InputError``
    for a name that leads out of the archive, for more bytes than declared or than the disk has room for, for
    a damaged or encrypted archive, and where several recordings, only damaged ones, or none are in it.
    """
    folder = tempfile.TemporaryDirectory(prefix="slam-")
    _unpacked.append(folder)
    root = Path(folder.name) / (path.stem or "archive")
    root.mkdir()
    try:
        with zipfile.ZipFile(path) as archive:
            _unpack(path, archive, root, progress)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        if isinstance(error, OSError) and not is_seek_error(error):
            raise
        raise refusal(
            path, f"is a ZIP archive that cannot be unpacked ({brief(error, 120)})", "unpack it yourself"
        ) from None
    return _source_in(root, path, progress, is_inner)


def _unpack(path: Path, archive: zipfile.ZipFile, root: Path, progress: Progress) -> None:
    entries = [entry for entry in archive.infolist() if not entry.is_dir()]
    needed, free = sum(entry.file_size for entry in entries), shutil.disk_usage(root).free
    if needed > free:
        raise refusal(
            path,
            f"needs {needed:,} bytes unpacked, and {root.parent.parent} has {free:,}",
            "free some space, or set TMPDIR to a larger disk",
        )
    for k, entry in enumerate(entries):
        name = PurePosixPath(entry.filename.replace("\\", "/"))
        if name.is_absolute() or ".." in name.parts or ":" in name.parts[0]:
            raise refusal(
                path, f"names the file {brief(entry.filename, 80)!r} outside of itself", "repair it"
            )
        target = root.joinpath(*name.parts)
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, target.open("xb") as file:
            left = entry.file_size
            while block := source.read(_BLOCK_BYTES):
                left -= len(block)
                if left < 0:
                    raise refusal(
                        path, f"holds more of {brief(name, 80)} than it declares", "do not trust it"
                    )
                file.write(block)
        progress("unpacking", k + 1, len(entries))


def _source_in(folder: Path, archive: Path, progress: Progress, is_inner: bool = False) -> Unpacked:
    """Return the one source in a folder that was unpacked, or raise ``InputError`` with what is there."""
    entries = [path for path in folder.iterdir() if not path.name.startswith((".", "__MACOSX"))]
    if len(entries) == 1 and entries[0].is_dir() and entries[0].name != "mav0":
        return _source_in(entries[0], archive, progress, is_inner)
    if any(path.name == "mav0" for path in entries) or format_of(folder) is not None:
        return Unpacked(folder)
    found, faults = recordings_in(folder, folder.rglob("*"))
    if len(found) > 1:
        names = ", ".join(os.path.relpath(path, folder) for path in found[:_MAX_NAMED])
        raise refusal(
            archive,
            f"holds {len(found)} recordings ({names})",
            "unpack it and name one of them, or give those of one flight to slam import",
        )
    lines = tuple(parsed(f"{archive.name} holds {str(fault).removeprefix(f'{folder}/')}") for fault in faults)
    if found:
        return Unpacked(found[0], lines)
    if holds_photos(folder) or any(folder.rglob("mav0")):
        return Unpacked(folder, lines)
    if faults:
        raise faults[0]
    inner = [path for path in folder.rglob("*") if is_archive(path)]
    if len(inner) == 1 and not is_inner:
        return unpacked(inner[0], progress, is_inner=True)
    names = listed([os.path.relpath(path, folder) for path in sorted(folder.rglob("*"))], _MAX_NAMED)
    what = "holds neither a recording, a flight folder nor photographs"
    raise refusal(
        archive, f"{what} (found: {brief(names, 200) or 'nothing'})", "docs/recordings.md lists what is read"
    )


def recordings_in(folder: Path, paths: Iterable[Path]) -> tuple[list[Path], list[InputError]]:
    """Return the recordings among the paths of a folder, without files that belong to another one.

    The second value is what is wrong with others that have the name of a recording.
    """
    files = sorted(path for path in paths if path.is_file())
    faults = {path: fault for path in files if (fault := _fault(path)) is not None}
    found = [path for path in files if path not in faults and format_of(path) is not None]
    stems = {path.with_suffix("") for path in found if path.suffix.lower() not in _COMPANIONS}
    found = [
        path
        for path in found
        if path.suffix.lower() not in _COMPANIONS
        or (path.with_suffix("") not in stems and not holds_photos(folder))
    ]
    return found, list(faults.values())


def _fault(path: Path) -> InputError | None:
    """Return what is wrong with a file that has the name of a recording; None where nothing is."""
    try:
        format_of(path)
    except InputError as fault:
        return fault
    return None
