"""Standard output and error of the command line: a failed write names its stream; libraries are silent."""

from __future__ import annotations

import io
import os
import select
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

STANDARD_OUTPUT = "standard output"
"""The name of standard output in error messages."""
_DESCRIPTORS = (1, 2)
"""Descriptors of standard output and error, to which libraries write."""


def own_streams() -> None:
    """Replace standard output and error, where they are files, by streams of slam alone that report failures.

    A letter that the terminal lacks is printed as ``?``. A failed write to standard output raises an
    ``OSError`` whose file name is ``STANDARD_OUTPUT``, so that no other file is blamed. A failed write to
    standard error is ignored: it holds progress and messages, and nobody reads them there.

    Libraries write to the file descriptors 1 and 2: libtiff a line for each damaged picture, gtsam its own
    warnings. These lead nowhere from now on, until ``show_libraries``.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # The size of the terminal is asked from sys.__stdout__.
        sys.stdout = sys.__stdout__ = _reopened(sys.stdout, _Output)  # type: ignore[misc]
    if isinstance(sys.stderr, io.TextIOWrapper):
        sys.stderr = sys.__stderr__ = _reopened(sys.stderr, _Messages)  # type: ignore[misc]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in _DESCRIPTORS:
        os.dup2(nowhere, descriptor)
    if nowhere not in _DESCRIPTORS:
        os.close(nowhere)


def show_libraries() -> None:
    """Let messages of libraries appear on standard error again."""
    if sys.__stderr__ is not None:
        for descriptor in _DESCRIPTORS:
            os.dup2(sys.__stderr__.fileno(), descriptor)


def _reopened(stream: io.TextIOWrapper, kind: type[io.FileIO]) -> io.TextIOWrapper:
    stream.flush()
    raw = kind(os.dup(stream.fileno()), "w")
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors="replace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


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
