"""Outputs appear whole or not at all: built under a temporary name beside the target, then renamed.

The temporary name is fixed (``.NAME.partial``) and held with a lock that dies with the process. What a
killed run leaves behind is unlocked, and the next run clears it; a second run on the same target finds it
locked and is refused.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from slam.core.errors import DISK_FULL, explain
from slam.io.files import refusal


def partial_path(target: Path) -> Path:
    """Return the hidden path beside ``target`` where it is built; it keeps the suffix."""
    return target.with_name(f".{target.stem}.partial{target.suffix}")


def write_whole(path: Path | str, content: bytes) -> None:
    """Put ``content`` at ``path`` in one step; until then an earlier file stays as it was.

    Raises ``InputError`` where the place cannot be written or another run is writing there.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(content)


@contextmanager
def atomic_file(path: Path | str) -> Iterator[Path]:
    """Give a temporary path beside ``path``, same suffix; on success it replaces ``path`` in one step.

    On any exception the old file stays as it was and nothing new is left. Missing parent folders are made.
    Raises ``InputError`` where the place cannot be written or another run is writing there.
    """
    target = Path(path)
    with _building(target, as_folder=False) as temporary:
        with _explained(target):
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, "is a folder", str(target))
            os.truncate(temporary, 0)
        with _explained(target, written=temporary):
            yield temporary
        with _explained(target):
            _sync(temporary)
            os.replace(temporary, target)
            _sync(target.parent)


@contextmanager
def atomic_folder(path: Path | str, replace: bool = False) -> Iterator[Path]:
    """Give an empty temporary folder beside ``path``; on success it becomes ``path`` in one step.

    A target that already holds something is refused, unless ``replace``: then it stands untouched until the
    new folder is complete. Raises ``InputError`` where the target is refused, cannot be written, or another
    run is writing there.
    """
    target = Path(path)
    with _building(target, as_folder=True) as temporary:
        old = temporary.with_name(f".{target.name}.old")
        with _explained(target):
            _recover(target, old)
            if target.exists() and not (target.is_dir() and (replace or not any(target.iterdir()))):
                raise refusal(target, "exists already and is not empty", "name another place or remove it")
            _clear(temporary)
        with _explained(target, written=temporary):
            yield temporary
        with _explained(target):
            _sync_tree(temporary)
            if target.exists() and any(target.iterdir()):
                os.rename(target, old)
            os.rename(temporary, target)
            _sync(target.parent)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def locked(path: Path | str) -> Iterator[None]:
    """Keep other runs from replacing the folder ``path`` while files are added to it.

    Raises ``InputError`` where another run is writing it, or where nothing can be written beside it.
    """
    with _building(Path(path), as_folder=True) as temporary:
        yield
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _building(target: Path, as_folder: bool) -> Iterator[Path]:
    """The temporary file or folder of ``target``, made and locked.

    Where the block fails it is removed, and so are parents that were made for it.
    """
    if not target.name:  # "." and "/"
        raise refusal(target, "has no name of its own", "name a file or folder to write")
    temporary = partial_path(target)
    made: list[Path] = []
    lock = -1
    try:
        with _explained(target):
            made = [parent for parent in target.parents if not parent.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            if as_folder:
                temporary.mkdir(exist_ok=True)
            lock = _lock(temporary, target, os.O_RDONLY if as_folder else os.O_RDWR | os.O_CREAT)
        try:
            yield temporary
        except BaseException:
            # Only here: after the rename the name may be another run's already.
            _remove(temporary)
            raise
        finally:
            os.close(lock)
    except BaseException:
        for parent in made:
            with suppress(OSError):  # another run's by now: stays
                parent.rmdir()
        raise


def _lock(temporary: Path, target: Path, flags: int) -> int:
    descriptor = -1
    try:
        descriptor = os.open(temporary, flags | os.O_NOFOLLOW, 0o666)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The other run may have renamed what we opened just before we got the lock.
        if not os.path.samestat(os.fstat(descriptor), temporary.stat()):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        if descriptor >= 0:
            os.close(descriptor)
        raise refusal(target, "another run is writing it", "wait for it or name another place") from None
    return descriptor


def _recover(target: Path, old: Path) -> None:
    """A run killed between its two renames left the old folder aside: put it back, or finish its removal."""
    if not old.exists():
        return
    if target.exists():
        shutil.rmtree(old, ignore_errors=True)
    else:
        os.rename(old, target)


def _clear(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _remove(temporary: Path) -> None:
    if temporary.is_dir():
        shutil.rmtree(temporary, ignore_errors=True)
    else:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_tree(folder: Path) -> None:
    for place, _, names in os.walk(folder, topdown=False):
        for name in names:
            _sync(Path(place, name))
        _sync(Path(place))


@contextmanager
def _explained(target: Path, written: Path | None = None) -> Iterator[None]:
    """Turn what the system refuses into one line about the target.

    With ``written`` the block is the caller's, who may also be reading: then only a disk that is full or
    read-only and what names the temporary file or folder is the target's fault; the rest passes.
    """
    try:
        yield
    except OSError as error:
        if written is not None and not _is_about(error, written):
            raise
        raise refusal(target, "cannot be written", explain(error)) from error


def _is_about(error: OSError, written: Path) -> bool:
    if error.errno in (*DISK_FULL, errno.EROFS):
        return True
    told = (error.filename, error.filename2)
    names = [Path(os.fsdecode(name)) for name in told if isinstance(name, str | bytes)]
    return any(name == written or written in name.parents for name in names)
