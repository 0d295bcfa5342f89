"""The base class of all errors that the back end raises for a bad input, and the format of its messages."""

import numpy as np


class BackendError(ValueError):
    """The input is invalid or has no solution. The message is one line: what, where, what to do."""


GTSAM_ERRORS = (RuntimeError, IndexError, UnicodeDecodeError)
"""gtsam raises these for a singular system; the last one when it prints a key that has no letter."""
_MAX_LENGTH = 200


def first_line(error: BaseException) -> str:
    """Return the first line of an exception's message; gtsam's can contain the whole graph."""
    lines = str(error).strip().splitlines()
    text = lines[0].strip() if lines else type(error).__name__
    return text if len(text) <= _MAX_LENGTH else text[: _MAX_LENGTH - 3] + "..."


_MAX_RANGES = 4


def format_ranges(numbers: list[int]) -> str:
    """Format numbers as ranges, ``0-57, 60, 62-70``; only the first few ranges are listed."""
    ordered = np.sort(np.asarray(numbers, dtype=np.int64))
    breaks = np.flatnonzero(np.diff(ordered) != 1) + 1
    parts = [(run[0], run[-1]) for run in np.split(ordered, breaks) if len(run)]
    text = [f"{first}" if first == last else f"{first}-{last}" for first, last in parts]
    more = len(text) - _MAX_RANGES
    return ", ".join(text[:_MAX_RANGES]) + (f" and {more} more" if more > 0 else "")
