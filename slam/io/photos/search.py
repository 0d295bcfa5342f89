"""Search for the photographs in a folder and its subfolders."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from backend.wording import counted, either
from slam.core.messages import Message, warning
from slam.core.names import listed
from slam.io.files import OUTPUT_MARKER, is_inside, refusal, shown

SUFFIXES = frozenset({".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff"})
NOT_READ = {
    **dict.fromkeys(
        (".heic", ".heif", ".avif", ".webp", ".bmp", ".jp2", ".jxl"), "convert them to JPEG with their tags"
    ),
    **dict.fromkeys(
        (
            *(".dng", ".gpr", ".arw", ".cr2", ".cr3", ".nef", ".nrw", ".orf", ".raf", ".rw2", ".rwl", ".raw"),
            *(".pef", ".srw", ".iiq", ".3fr", ".x3f"),
        ),
        "develop them to JPEG or TIFF with their tags",
    ),
}
"""Suffixes of pictures of cameras that are not read, and what to do."""
BESIDE = frozenset(
    {".txt", ".csv", ".tsv", ".gpx", ".kml", ".geojson", ".json", ".mrk", ".pos", ".nmea", ".srt", ".xml"}
)
"""Suffixes of texts beside photographs that may hold positions, times or a calibration."""
_LINK_ADVICE = "give the folder that one leads to, or copy it into the folder"


@dataclass(frozen=True)
class FoundPhotos:
    """Photographs of a folder."""

    photos: tuple[tuple[str, Path], ...]
    """Name and path of each, in the natural order of the names."""
    left_out: dict[str, list[str]]
    """Reason -> names of files that are not used."""
    remarks: tuple[Message, ...]
    beside: tuple[Path, ...] = ()
    """Texts in the folder and its subfolders that may tell something about the photographs."""


def holds_photos(folder: Path) -> bool:
    """Return whether a folder or its subfolders contain a photograph, of a kind that is read or not."""
    return any(_suffix(path) in SUFFIXES | NOT_READ.keys() for path in _files(folder))


def find_photos(folder: Path) -> FoundPhotos:
    """Return the photographs in a folder and its subfolders, without hidden files, outputs of slam, links out
    of the folder, and copies.

    Raises ``InputError`` if there is no folder or no photograph in it.
    """
    if not folder.exists():
        raise refusal(folder, "no such folder", "give the folder that holds the photographs")
    if not folder.is_dir():
        raise refusal(folder, "a file, not a folder of photographs", "unpack it if it is an archive")
    files = sorted(_files(folder), key=lambda path: _natural(str(path.relative_to(folder))))
    paths = [path for path in files if _suffix(path) in SUFFIXES]
    others = [path for path in files if _suffix(path) in NOT_READ]
    links = [shown(str(path.relative_to(folder))) for path in files if _is_folder_link(path)]
    if not paths:
        raise _no_photos(folder, others, links)
    left_out: dict[str, list[str]] = defaultdict(list)
    for path in others:
        left_out[f"{_kind(path)} pictures are not read; {NOT_READ[_suffix(path)]}"].append(shown(path.name))
    same = Counter(path.name for path in paths)
    copies = _copies([path for path in paths if is_inside(path, folder)])
    photos, below = [], 0
    for path in paths:
        inner = path.relative_to(folder)
        name = shown(path.name if same[path.name] == 1 else "_".join(inner.parts))
        if not is_inside(path, folder):
            left_out["a link that leads out of the folder; copy the file into it"].append(name)
        elif path in copies:
            left_out["the same file as another photograph"].append(name)
        else:
            photos.append((name, path))
            below += len(inner.parts) > 1
    remarks = (
        [warning(f"{below} of {len(photos)} photographs {either(below, 'is', 'are')} in subfolders")]
        if below
        else []
    )
    if links:
        remarks.append(
            warning(
                f"{counted(len(links), 'link to a folder is', 'links to folders are')} not followed",
                f"{_LINK_ADVICE} ({listed(links)})",
            )
        )
    beside = tuple(path for path in files if _suffix(path) in BESIDE and is_inside(path, folder))
    return FoundPhotos(tuple(photos), left_out, tuple(remarks), beside)


def _files(folder: Path) -> Iterator[Path]:
    """Yield all files that are not hidden, and links to folders, which are not followed."""

    def refuse(error: OSError) -> None:
        raise refusal(error.filename or folder, f"cannot be read ({error.strerror})", "check its permissions")

    for root, folders, names in os.walk(folder, onerror=refuse):
        if OUTPUT_MARKER in names:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(root, name) for name in names if not name.startswith("."))
        yield from filter(_is_folder_link, (Path(root, name) for name in folders))


def _is_folder_link(path: Path) -> bool:
    return path.is_symlink() and path.is_dir()


def _copies(paths: list[Path]) -> set[Path]:
    """Return the files that are the same as another one; the one with the shortest path is no copy."""
    sizes = Counter(map(_size, paths))
    known: set[object] = set()
    copies: set[Path] = set()
    for path in sorted(paths, key=lambda path: len(str(path))):
        marks = _marks(path, _size(path) > 0 and sizes[_size(path)] > 1)
        if known & marks:
            copies.add(path)
        known |= marks
    return copies


def _size(path: Path) -> int:
    """Return the bytes of a file; -1 where they cannot be told."""
    try:
        return path.stat().st_size
    except OSError:
        return -1


def _marks(path: Path, compares_content: bool) -> set[object]:
    """Return what two entries for one photograph have in common: the file itself, or equal content."""
    try:
        status = path.stat()
        marks: set[object] = {(status.st_dev, status.st_ino)}
        if compares_content and path.is_file():
            marks.add(blake2b(path.read_bytes()).digest())
    except OSError:
        return set()  # the reader names the reason
    return marks


def _no_photos(folder: Path, others: list[Path], links: list[str]) -> Exception:
    if not others and links:
        what = f"no photographs in it, only links to folders, which are not followed ({listed(links)})"
        return refusal(folder, what, _LINK_ADVICE)
    if not others:
        return refusal(
            folder, "no photographs in it", f"give a folder that holds {', '.join(sorted(SUFFIXES))} files"
        )
    kinds = Counter(_kind(path) for path in others)
    what = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    do = " and ".join(dict.fromkeys(NOT_READ[_suffix(path)] for path in others))
    return refusal(folder, f"its photographs are of kinds that are not read ({what})", do)


def _kind(path: Path) -> str:
    return _suffix(path)[1:].upper()


def _suffix(path: Path) -> str:
    return path.suffix.casefold()


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that places IMG_9 before IMG_10."""
    return [(int(part) if part.isdecimal() else -1, part.casefold()) for part in re.split(r"(\d+)", name)]
