"""The one root of all errors that the back end raises for a bad input: one line, what, where, what to do."""

import numpy as np


class BackendError(ValueError):
    """The input was refused or has no answer; the message is one line for a person."""


GTSAM_ERRORS = (RuntimeError, IndexError, UnicodeDecodeError)
"""What a singular system raises; the last where gtsam writes the letter of a key that has none."""
_MOST_LETTERS = 200


def first_line(error: BaseException) -> str:
    """The first line of an exception's message: gtsam's can hold the whole graph."""
    lines = str(error).strip().splitlines()
    text = lines[0].strip() if lines else type(error).__name__
    return text if len(text) <= _MOST_LETTERS else text[: _MOST_LETTERS - 3] + "..."


_MOST_RUNS = 4


def runs(numbers: list[int]) -> str:
    """Sorted numbers as a person writes them: ``0-57, 60, 62-70``, the first few runs of them."""
    ordered = np.sort(np.asarray(numbers, dtype=np.int64))
    breaks = np.flatnonzero(np.diff(ordered) != 1) + 1
    parts = [(run[0], run[-1]) for run in np.split(ordered, breaks) if len(run)]
    text = [f"{first}" if first == last else f"{first}-{last}" for first, last in parts]
    more = len(text) - _MOST_RUNS
    return ", ".join(text[:_MOST_RUNS]) + (f" and {more} more" if more > 0 else "")
