"""The one root of all errors that the back end raises for a bad input: one line, what, where, what to do."""


class BackendError(ValueError):
    """The input was refused or has no answer; the message is one line for a person."""


def one_line(error: BaseException, limit: int = 200) -> str:
    """The first line of an exception's message: gtsam's can hold the whole graph."""
    lines = str(error).strip().splitlines()
    text = lines[0].strip() if lines else type(error).__name__
    return text if len(text) <= limit else text[: limit - 3] + "..."


def runs(numbers: list[int], names: tuple[str, ...] = (), limit: int = 4) -> str:
    """Sorted numbers as a person writes them: ``0-57, 60, 62-70``; names replace the numbers."""
    parts: list[tuple[int, int]] = []
    for k in sorted(numbers):
        if parts and k == parts[-1][1] + 1:
            parts[-1] = (parts[-1][0], k)
        else:
            parts.append((k, k))
    said = [names[a] if names else str(a) for a, _ in parts]
    ends = [names[b] if names else str(b) for _, b in parts]
    text = [a if lo == hi else f"{a}-{b}" for a, b, (lo, hi) in zip(said, ends, parts, strict=True)]
    return ", ".join(text[:limit]) + (f" and {len(text) - limit} more" if len(text) > limit else "")
