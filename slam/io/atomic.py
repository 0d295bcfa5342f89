"""Atomic outputs. They are built under a temporary name beside the target and then renamed.

The temporary name is fixed (``.NAME.partial``) and locked until the process ends. A killed run leaves it
unlocked, and the next run removes it. A second run on the same target finds it locked and is refused.
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
    """Write ``content`` to ``path`` in one step. An earlier file stays unchanged until then.

    Raises ``InputError`` if the place cannot be written or another run is writing there.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(content)


@contextmanager
def atomic_file(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` with its suffix. On success it replaces ``path`` in one step.

    On an exception the old file stays unchanged and nothing new remains. Missing parent folders are created.
    Raises ``InputError`` if the place cannot be written or another run is writing there.
    """
    target = Path(path)
    with _locked_partial(target, as_folder=False) as temporary:
        with _as_input_error(target):
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, "is a folder", str(target))
            os.truncate(temporary, 0)
        with _as_input_error(target, written=temporary):
            yield temporary
        with _as_input_error(target):
            _sync(temporary)
            os.replace(temporary, target)
            _sync(target.parent)


@contextmanager
def atomic_folder(path: Path | str, replace: bool = False) -> Iterator[Path]:
    """Yield an empty temporary folder beside ``path``. On success it becomes ``path`` in one step.

    A target that is not empty is refused, unless ``replace`` is set; then it stays unchanged until the new
    folder is complete. Raises ``InputError`` if the target is refused, cannot be written, or another run is
    writing there.
    """
    target = Path(path)
    with _locked_partial(target, as_folder=True) as temporary:
        old = temporary.with_name(f".{target.name}.old")
        with _as_input_error(target):
            _recover(target, old)
            if target.exists() and not (target.is_dir() and (replace or not any(target.iterdir()))):
                raise refusal(target, "exists already and is not empty", "name another place or remove it")
            _clear(temporary)
        with _as_input_error(target, written=temporary):
            yield temporary
        with _as_input_error(target):
            _sync_tree(temporary)
            if target.exists() and any(target.iterdir()):
                os.rename(target, old)
            os.rename(temporary, target)
            _sync(target.parent)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def locked(path: Path | str) -> Iterator[None]:
    """Keep other runs from replacing the folder ``path`` while files are added to it.

    Raises ``InputError`` if another run is writing it, or if nothing can be written beside it.
    """
    with _locked_partial(Path(path), as_folder=True) as temporary:
        yield
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _locked_partial(target: Path, as_folder: bool) -> Iterator[Path]:
    """Create and lock the temporary file or folder of ``target``.

    If the block fails, it is removed, together with parent folders that were created for it.
    """
    if not target.name:  # "." and "/"
        raise refusal(target, "has no name of its own", "name a file or folder to write")
    temporary = partial_path(target)
    created: list[Path] = []
    lock = -1
    try:
        with _as_input_error(target):
            created = [parent for parent in target.parents if not parent.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            if as_folder:
                temporary.mkdir(exist_ok=True)
            lock = _lock(temporary, target, os.O_RDONLY if as_folder else os.O_RDWR | os.O_CREAT)
        try:
            yield temporary
        except BaseException:
            # Only here: after the rename, the name may already belong to another run.
            _remove(temporary)
            raise
        finally:
            os.close(lock)
    except BaseException:
        for parent in created:
            with suppress(OSError):  # a folder that another run uses by now stays
                parent.rmdir()
        raise


def _lock(temporary: Path, target: Path, flags: int) -> int:
    descriptor = -1
    try:
        descriptor = os.open(temporary, flags | os.O_NOFOLLOW, 0o666)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The other run may have renamed the opened file just before this run got the lock.
        if not os.path.samestat(os.fstat(descriptor), temporary.stat()):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        if descriptor >= 0:
            os.close(descriptor)
        raise refusal(target, "another run is writing it", "wait for it or name another place") from None
    return descriptor


def _recover(target: Path, old: Path) -> None:
    """Restore or remove the old folder that a run left when it was killed between its two renames."""
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
def _as_input_error(target: Path, written: Path | None = None) -> Iterator[None]:
    """Turn an error of the operating system into one line about the target.

    With ``written`` the block is the caller's, who may also read other files. Then only a full or read-only
    disk, and errors that name the temporary file or folder, are the target's; others pass unchanged.
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
    paths = (error.filename, error.filename2)
    names = [Path(os.fsdecode(name)) for name in paths if isinstance(name, str | bytes)]
    return any(name == written or written in name.parents for name in names)
