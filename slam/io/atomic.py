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
from contextlib import contextmanager
from pathlib import Path

from slam.io.files import refusal

_DISK_FAULTS = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some space or choose another disk",
    errno.EFBIG: "choose another disk",
    errno.EROFS: "choose a folder that can be written",
    errno.EIO: "check the disk",
}
_PLACE_FAULTS = {
    errno.EACCES: "choose a folder that can be written",
    errno.EPERM: "choose a folder that can be written",
    errno.ENOTEMPTY: "another run is writing it; wait for it",
    errno.EEXIST: "a file stands where a folder is needed; choose another place",
    errno.ENOTDIR: "a file stands where a folder is needed; choose another place",
    errno.EISDIR: "a folder stands where a file is needed; choose another name",
    errno.ENAMETOOLONG: "choose a shorter name",
}


@contextmanager
def atomic_file(path: Path | str) -> Iterator[Path]:
    """Give a temporary path beside ``path``, same suffix; on success it replaces ``path`` in one step.

    On any exception the old file stays as it was and nothing new is left. Missing parent folders are made.
    Raises ``InputError`` where the place cannot be written or another run is writing there.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.partial{target.suffix}")
    with _explained(target):
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder", str(target))
        target.parent.mkdir(parents=True, exist_ok=True)
        lock = _lock(temporary, target, os.O_RDWR | os.O_CREAT)
        try:
            os.truncate(temporary, 0)
            yield temporary
            _sync(temporary)
            os.replace(temporary, target)
            _sync(target.parent)
        except BaseException:
            # Only here: after the rename the name may be another run's already.
            temporary.unlink(missing_ok=True)
            raise
        finally:
            os.close(lock)


@contextmanager
def atomic_folder(path: Path | str, replace: bool = False) -> Iterator[Path]:
    """Give an empty temporary folder beside ``path``; on success it becomes ``path`` in one step.

    A target that already holds something is refused, unless ``replace``: then it stands untouched until the
    new folder is complete. Raises ``InputError`` where the target is refused, cannot be written, or another
    run is writing there.
    """
    target = Path(path)
    temporary, old = target.with_name(f".{target.name}.partial"), target.with_name(f".{target.name}.old")
    with _explained(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir(exist_ok=True)
        lock = _lock(temporary, target, os.O_RDONLY)
        try:
            _recover(target, old)
            if target.exists() and not (target.is_dir() and (replace or not any(target.iterdir()))):
                raise refusal(target, "exists already and is not empty", "name another place or remove it")
            _clear(temporary)
            yield temporary
            _sync_tree(temporary)
            if target.exists() and any(target.iterdir()):
                os.rename(target, old)
            os.rename(temporary, target)
            _sync(target.parent)
            shutil.rmtree(old, ignore_errors=True)
        except BaseException:
            # Only here: after the rename the name may be another run's already.
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        finally:
            os.close(lock)


def _lock(temporary: Path, target: Path, flags: int) -> int:
    descriptor = -1
    try:
        descriptor = os.open(temporary, flags, 0o666)
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
def _explained(target: Path) -> Iterator[None]:
    """Turn what the disk or the place refuses into one line about the target; other errors pass.

    A full disk tells no file name; the faults of a place count only where the name is one of ours, since the
    writer may also have been reading something.
    """
    try:
        yield
    except OSError as error:
        ours = str(error.filename or "").startswith(str(target.parent)) or error.filename == str(target)
        todo = _DISK_FAULTS.get(error.errno or 0) or (_PLACE_FAULTS.get(error.errno or 0) if ours else None)
        if todo is None:
            raise
        raise refusal(target, f"cannot be written ({error.strerror})", todo) from error
