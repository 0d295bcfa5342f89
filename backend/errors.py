"""The one root of all errors that the back end raises for a bad input: one line, what, where, what to do."""

import numpy as np


class BackendError(ValueError):
    """The input was refused or has no answer; the message is one line for a person."""


GTSAM_ERRORS = (RuntimeError, IndexError, UnicodeDecodeError)
"""What a singular system raises; the last where gtsam writes the letter of a key that has none."""


def first_line(error: BaseException, limit: int = 200) -> str:
    """The first line of an exception's message: gtsam's can hold the whole graph."""
    lines = str(error).strip().splitlines()
    text = lines[0].strip() if lines else type(error).__name__
    return text if len(text) <= limit else text[: limit - 3] + "..."


def runs(numbers: list[int], names: tuple[str, ...] = (), limit: int = 4) -> str:
    """Sorted numbers as a person writes them: ``0-57, 60, 62-70``; names replace the numbers."""
    ordered = np.sort(np.asarray(numbers, dtype=np.int64))
    breaks = np.flatnonzero(np.diff(ordered) != 1) + 1
    parts = [(int(run[0]), int(run[-1])) for run in np.split(ordered, breaks) if len(run)]
    said = [names[a] if names else str(a) for a, _ in parts]
    ends = [names[b] if names else str(b) for _, b in parts]
    text = [a if lo == hi else f"{a}-{b}" for a, b, (lo, hi) in zip(said, ends, parts, strict=True)]
    return ", ".join(text[:limit]) + (f" and {len(text) - limit} more" if len(text) > limit else "")
