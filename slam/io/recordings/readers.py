"""Guards around the libraries that read recordings: missing ones, and what they raise for damaged files."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slam.core.errors import InputError
from slam.io.files import brief, refusal


@contextmanager
def optional_reader(path: Path, description: str, extra: str) -> Iterator[None]:
    """Turn a failed import of a reader into one line with the command that installs it."""
    try:
        yield
    except ImportError as error:
        name = (error.name or str(error)).partition(".")[0]
        raise refusal(
            path,
            f"is {description}, and the package {name} that reads it is not installed",
            f"run: pip install 'lemniscate-slam[{extra}]'",
        ) from None


def is_seek_error(error: OSError) -> bool:
    """Return whether a place in the file is impossible: a damaged length, not a fault of the disk."""
    return error.errno == errno.EINVAL


@contextmanager
def damage_reported(path: Path, description: str) -> Iterator[None]:
    """Turn whatever a reader raises for a damaged file into one line.

    Readers let errors of their own and of Python through. Errors of this project and of the system pass.
    """
    try:
        yield
    except MemoryError:  # a reader checks no length
        raise refusal(
            path,
            f"is {description} that asks for more memory than there is: a length in it is damaged, or memory "
            "is short",
            "copy it again from the recorder, or close other programs",
        ) from None
    except Exception as error:  # a reader's errors have no common class
        if isinstance(error, InputError) or (isinstance(error, OSError) and not is_seek_error(error)):
            raise
        cause = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise refusal(
            path,
            f"is {description} that its reader cannot read ({brief(cause, 160)})",
            "copy it again from the recorder, or repair it with the recorder's own tools",
        ) from None
