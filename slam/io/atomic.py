"""Outputs appear whole or not at all: built in a working folder beside the target, then renamed.

The working folder has a fixed name (``.NAME.partial``) and holds a marker file, and a lock that dies with the
process. What a killed run leaves behind is unlocked and marked, and the next run clears it. A second run on
the same target finds the lock and is refused. A folder of that name without the marker belongs to somebody
else: it is refused and stays as it is.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from slam.core.errors import DISK_FULL, InputError, explain
from slam.io.files import refusal

_MARKER = "slam-working-folder.txt"
_MARKER_TEXT = b"Working folder of slam. It may be deleted if no slam runs.\n"
_NEW = "new"
"""Subfolder of the working folder: what is being built."""
_OLD = "old"
"""Subfolder of the working folder: the earlier folder, moved aside and not yet checked again."""
_REPLACED = "replaced"
"""Subfolder of the working folder: the earlier folder, checked; it goes when its successor is in place."""
_CHECKPOINT = "checkpoint"
"""File of the working folder: results with which the next run goes on, if this one is ended from outside."""
_FLUSHED_AT_ONCE = 8
"""Files that are flushed at the same time."""


def partial_path(target: Path) -> Path:
    """Return the hidden working folder beside ``target`` in which it is built."""
    return target.with_name(f".{target.name}.partial")


def is_working_folder(folder: Path) -> bool:
    """Return whether a folder was made here for building, and not by somebody else."""
    marker = folder / _MARKER
    try:
        if folder.is_symlink() or marker.is_symlink() or not marker.is_file():
            return False
        return marker.read_bytes() == _MARKER_TEXT and {*os.listdir(folder)} <= {
            _MARKER,
            _NEW,
            _OLD,
            _REPLACED,
            _CHECKPOINT,
        }
    except OSError:
        return False


def checkpoint_path(new: Path) -> Path:
    """Return the file beside a folder that `atomic_folder` gives, which stays until a run has finished."""
    return new.parent / _CHECKPOINT


def was_killed(target: Path) -> bool:
    """Return whether a run that wrote ``target`` was killed, or still runs."""
    work = partial_path(target)
    return is_working_folder(work) and {*os.listdir(work)} != {_MARKER, _CHECKPOINT}


def write_whole(path: Path | str, content: bytes) -> None:
    """Put ``content`` at ``path`` in one step; until then an earlier file stays as it was.

    Raises ``InputError`` where the place cannot be written or another run is writing there.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(content)


@contextmanager
def atomic_file(path: Path | str) -> Iterator[Path]:
    """Give a temporary path of the same name; on success it replaces ``path`` in one step.

    On any exception the old file stays as it was and nothing new is left. Missing parent folders are made.
    Raises ``InputError`` where the place cannot be written or another run is writing there.
    """
    target = Path(path)
    with _working_folder(target) as work:
        with _as_input_error(target):
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, "is a folder", str(target))
            temporary = work / _NEW / target.name
            temporary.touch()
        with _as_input_error(target, written=work):
            yield temporary
        with _as_input_error(target):
            _sync(temporary)
            os.replace(temporary, target)
            _sync(target.parent)


@contextmanager
def atomic_folder(path: Path | str, may_replace: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Give an empty temporary folder beside ``path``; on success it becomes ``path`` in one step.

    A target that already holds something is refused, unless ``may_replace`` is given: it raises
    ``InputError`` for a folder that may not be replaced. It is asked at the start and again at the end, after
    the old folder was moved aside; until then the old folder stays as it is. Raises ``InputError`` where the
    target is refused, cannot be written, or another run is writing there.

    The file at `checkpoint_path`, which the caller may write, stays where the block ends by another
    exception, or by a full disk. A refused input removes it, since the next run would end like this one.
    """
    target = Path(path)
    with _working_folder(target) as work:
        new, old = work / _NEW, work / _OLD
        check_free(target, may_replace)
        with _as_input_error(target, written=work):
            try:
                yield new
            except InputError as error:
                if not _is_of_full_disk(error):
                    _drop_checkpoint(work)
                raise
        with _as_input_error(target):
            _sync_tree(new)
            if target.exists() and any(target.iterdir()):
                os.rename(target, old)
                _check_free(old, may_replace)
                os.rename(old, work / _REPLACED)
            os.rename(new, target)
            _sync(target.parent)
            _drop_checkpoint(work)


@contextmanager
def locked(path: Path | str) -> Iterator[None]:
    """Keep other runs from replacing the folder ``path`` while files are added to it.

    Raises ``InputError`` where another run is writing it, or where nothing can be written beside it.
    """
    with _working_folder(Path(path)):
        yield


def check_free(target: Path, may_replace: Callable[[Path], None] | None = None) -> None:
    """Raise ``InputError`` where ``atomic_folder`` would refuse the target, before anything is computed."""
    with _as_input_error(target):
        _check_free(target, may_replace)


def _check_free(target: Path, may_replace: Callable[[Path], None] | None) -> None:
    if not target.exists() or (target.is_dir() and not any(target.iterdir())):
        return
    if may_replace is None or not target.is_dir():
        raise refusal(target, "exists already and is not empty", "name another place or remove it")
    may_replace(target)


@contextmanager
def _working_folder(target: Path) -> Iterator[Path]:
    """Make and lock the working folder of ``target``, with an empty folder for what is built.

    It is removed at the end. Where the block fails, parents that were made for it are removed too.
    """
    if not target.name:  # "." and "/"
        raise refusal(target, "has no name of its own", "name a file or folder to write")
    work = partial_path(target)
    made: list[Path] = []
    try:
        with _as_input_error(target):
            made = [parent for parent in target.parents if not parent.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            lock = _lock(work, target)
        try:
            with _as_input_error(target):
                _recover(target, work)
                (work / _NEW).mkdir()
            yield work
        finally:
            _remove(work, target)
            os.close(lock)
    except BaseException:
        for parent in made:
            with suppress(OSError):  # another run's by now: stays
                parent.rmdir()
        raise


def _lock(work: Path, target: Path) -> int:
    """Return the locked descriptor of the working folder, which is made and marked where it is missing."""
    try:
        work.mkdir()
        is_new = True
    except FileExistsError:
        is_new = False
    descriptor = -1
    try:
        descriptor = os.open(work, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
        # Another run may hold what we have just made: until it sees that the marker is missing, and gives up.
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if is_new else fcntl.LOCK_NB))
        # The other run may have removed what we opened just before we got the lock.
        if not os.path.samestat(os.fstat(descriptor), work.stat()):
            raise BlockingIOError
        if is_new:
            (work / _MARKER).write_bytes(_MARKER_TEXT)
        elif not is_working_folder(work):
            raise NotADirectoryError
    except OSError as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, BlockingIOError | FileNotFoundError):
            raise refusal(target, "another run is writing it", "wait for it or name another place") from None
        if not is_new and (isinstance(error, NotADirectoryError) or error.errno == errno.ELOOP):
            raise refusal(
                work,
                "slam needs this name to write beside it, and did not write what is there",
                f"move it away, or name another place than {target.name}",
            ) from None
        if is_new:
            with suppress(OSError):
                (work / _MARKER).unlink(missing_ok=True)
                work.rmdir()
        raise
    return descriptor


def _recover(target: Path, work: Path) -> None:
    """Clear what a killed run left; killed between its two renames, it left the old folder: put it back."""
    _put_back(target, work)
    if (work / _OLD).exists():
        raise refusal(work / _OLD, "was moved aside by a run that was killed", "move it out of there")
    for name in (_NEW, _REPLACED):
        if (work / name).exists():
            shutil.rmtree(work / name)


def _put_back(target: Path, work: Path) -> None:
    for aside in (work / _REPLACED, work / _OLD):
        if aside.exists() and not target.exists():
            os.rename(aside, target)


def _remove(work: Path, target: Path) -> None:
    """Remove the working folder, but neither an unchecked old folder nor what somebody else put into it."""
    with suppress(OSError):
        _put_back(target, work)
    if target.exists():
        shutil.rmtree(work / _REPLACED, ignore_errors=True)
    shutil.rmtree(work / _NEW, ignore_errors=True)
    with suppress(OSError):
        if os.listdir(work) == [_MARKER]:
            (work / _MARKER).unlink()
            work.rmdir()


def _is_of_full_disk(error: InputError) -> bool:
    cause = error.__context__
    return isinstance(cause, OSError) and cause.errno in DISK_FULL


def _drop_checkpoint(work: Path) -> None:
    with suppress(OSError):
        (work / _CHECKPOINT).unlink()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_tree(folder: Path) -> None:
    """Flush all files, then the folders; a disk flushes files together that are asked for at once."""
    places = list(os.walk(folder, topdown=False))
    files = [Path(place, name) for place, _, names in places for name in names]
    with ThreadPoolExecutor(_FLUSHED_AT_ONCE) as pool:
        list(pool.map(_sync, files))
    for place, _, _ in places:
        _sync(Path(place))


@contextmanager
def _as_input_error(target: Path, written: Path | None = None) -> Iterator[None]:
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
    paths = (error.filename, error.filename2)
    names = [Path(os.fsdecode(name)) for name in paths if isinstance(name, str | bytes)]
    if not names:  # a write into an open file does not name it
        return error.errno in (*DISK_FULL, errno.EROFS)
    return any(name == written or written in name.parents for name in names)
