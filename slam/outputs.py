"""An output folder that appears whole or not at all, and belongs to one run at a time.

``slam.io.atomic`` makes the folder appear in one step; here is decided whether it may. The lock is the
kernel's (``flock``) on a file beside the folder: it dies with the process that holds it, so that a lock file
left over by a kill locks nothing. It also guards a finished output that ``slam evaluate`` adds files to.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from slam.errors import InputError
from slam.io.atomic import atomic_folder

OPTIMIZE_NAMES = (
    "trajectory.tum",
    "graph.g2o",
    "estimate.npz",
    "loops.csv",
    "mosaic.tif",
    "mosaic.png",
    "mosaic.pgw",
    "mosaic_chain.png",
    "report.html",
    "summary.json",
)
"""Files that ``slam optimize`` writes."""

EVALUATE_NAMES = ("evaluation.json", "evaluation_trajectory.png", "evaluation_error.png")
"""Files that ``slam evaluate`` adds."""

_BYSTANDERS = (
    ".DS_Store",
    "Thumbs.db",
    "desktop.ini",
    "mosaic.png.aux.xml",
    "mosaic.tif.aux.xml",
    "mosaic.tif.ovr",
)
"""What viewers leave beside pictures; may go with them."""

_MARK = "summary.json"
"""Every finished output holds it; a folder without it is not ours to replace."""

_UNTOUCHED = "an earlier output is as it was"

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def output_folder(target: str | Path) -> Iterator[Path]:
    """Give an empty folder to write into; it becomes ``target`` when the block ends without an error.

    An earlier output of ours in ``target`` stays until the new one is complete. Raises ``InputError`` where
    ``target`` is a file, holds something that slam did not write, is being written by another run, or cannot
    be written.
    """
    target = _checked(Path(target))
    made = _make_parents(target)
    try:
        with locked(target):
            _refuse_foreign(target)
            with atomic_folder(target, replace=True) as folder:
                try:
                    yield folder
                except OSError as error:  # its own file is to be named, not the target
                    raise InputError(explain(error)) from None
    finally:
        for parent in made:
            with suppress(OSError):  # holds the finished output: stays
                parent.rmdir()


@contextmanager
def locked(target: Path) -> Iterator[None]:
    """Hold the one lock of an output folder; raises ``InputError`` where another run holds it."""
    path = target.with_name(f".{target.name}.lock")
    try:
        handle = _lock(path)
    except BlockingIOError:
        raise InputError(
            f"{target}: another run is writing there at this moment; wait for it or choose another --out"
        ) from None
    except OSError as error:
        raise InputError(explain(error, path)) from None
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(handle)


def explain(error: OSError, path: str | Path | None = None) -> str:
    """One line for a person: what the system refused, where, and what to do."""
    place = error.filename if error.filename is not None else path
    where = f"{place}: " if place is not None else ""
    if error.errno in _FULL:
        return f"{where}the disk is full or a limit is reached; free some space, {_UNTOUCHED}"
    if error.errno == errno.EROFS:
        return f"{where}the file system is read-only; choose another --out, {_UNTOUCHED}"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{where}no permission; choose a place that you may read and write"
    if error.errno == errno.ENOENT:
        return f"{where}does not exist; check the path"
    return f"{where}{error.strerror or error}; check the path and the disk"


def is_output(folder: Path) -> bool:
    """Whether a folder is a finished output of ``slam optimize``."""
    return (folder / _MARK).is_file()


def _checked(target: Path) -> Path:
    target = Path(os.path.realpath(target))
    here = Path.cwd()
    if target == here or target in here.parents:
        raise InputError(f"{target}: --out is the folder you are in or holds it; name a folder of its own")
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: --out is a file; name a folder")
    return target


def _refuse_foreign(target: Path) -> None:
    try:
        entries = sorted(os.scandir(target), key=lambda entry: entry.name)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(explain(error, target)) from None
    ours = {*OPTIMIZE_NAMES, *EVALUATE_NAMES, *_BYSTANDERS}
    foreign = [
        entry.name for entry in entries if entry.name not in ours or entry.is_dir(follow_symlinks=False)
    ]
    if not is_output(target):
        foreign = foreign or [entry.name for entry in entries]
    if foreign:
        raise InputError(
            f"{target}: holds {foreign[0]!r}, which slam did not write; choose another --out or move it away"
        )


def _lock(path: Path) -> int:
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The holder before us may have removed the file after we opened it: then it guards nothing.
            if os.path.exists(path) and os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _make_parents(target: Path) -> list[Path]:
    """Create missing parents; gives them back, innermost first, to be removed if nothing comes of it."""
    missing = [parent for parent in target.parents if not parent.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(explain(error, target.parent)) from None
    return missing
