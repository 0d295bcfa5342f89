"""Standard output and error of the command line: a failed write names its stream; libraries are silent."""

from __future__ import annotations

import fcntl
import io
import os
import select
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from typing_extensions import Buffer

STANDARD_OUTPUT = "standard output"
"""The name of standard output in error messages."""
_DESCRIPTORS = (1, 2)
"""Descriptors of standard output and error, to which libraries write."""


def separate_streams() -> None:
    """Separate the standard output and error of slam, where they are files, from those of libraries.

    A letter that the terminal lacks is printed as ``?``. A failed write to standard output raises an
    ``OSError`` whose file name is ``STANDARD_OUTPUT``, so that no other file is blamed. A failed write to
    standard error is ignored: it holds progress and messages, and nobody reads them there. What is written to
    a stream that the shell closed is dropped.

    Libraries write to the file descriptors 1 and 2: libtiff a line for each damaged picture, gtsam its own
    warnings. These lead nowhere from now on, until ``show_libraries``.
    """
    # The size of the terminal is asked from sys.__stdout__.
    sys.stdout = sys.__stdout__ = _own(sys.stdout, _Output)  # type: ignore[assignment, misc]
    sys.stderr = sys.__stderr__ = _own(sys.stderr, _Messages)  # type: ignore[assignment, misc]
    opened = os.open(os.devnull, os.O_WRONLY)
    nowhere = _above(opened)
    os.close(opened)
    for descriptor in _DESCRIPTORS:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def show_libraries() -> None:
    """Let messages of libraries appear on standard error again."""
    if sys.__stderr__ is not None:
        for descriptor in _DESCRIPTORS:
            os.dup2(sys.__stderr__.fileno(), descriptor)


def _own(stream: TextIO | None, kind: type[io.FileIO]) -> TextIO:
    if stream is None:  # closed by the shell (>&-): nobody wants to read it
        return open(os.devnull, "w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(kind(_above(stream.fileno()), "w")),
        encoding=stream.encoding,
        errors="replace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def _above(descriptor: int) -> int:
    """Return a copy of a descriptor with a number beyond the standard ones, of which one may be free."""
    return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, max(_DESCRIPTORS) + 1)


class _Output(io.FileIO):
    """Standard output without buffer; what a failed write left in a buffer above is dropped."""

    _failed = False

    def write(self, data: Buffer, /) -> int:
        if self._failed:  # the interpreter flushes once more at its end
            return len(memoryview(data))
        try:
            while (written := super().write(data)) is None:  # the other end set it to non-blocking
                select.select((), (self,), ())
            return written
        except OSError as error:
            self._failed = True
            error.filename = STANDARD_OUTPUT
            raise


class _Messages(io.FileIO):
    """Standard error without buffer; failed writes are ignored."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(memoryview(data))
