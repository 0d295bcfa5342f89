"""The one root of all errors that a user can cause and mend; the system's own refusals in plain words."""

import errno
from unicodedata import category


class InputError(Exception):
    """The input was refused: one line that says what, where, and what to do. Exit code 1."""


NO_CAMERA = "flights without a camera are for `slam estimate`"
"""What to do where there is no picture to make a map of."""


def one_line(text: str) -> str:
    """Text that holds names from outside, safe to print: no line breaks, nothing invisible."""
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if category(letter) in _UNPRINTABLE else letter for letter in text
    )


_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def explain(error: OSError) -> str:
    """What the system refused, and what to do; without the place, which ``error.filename`` may name."""
    known = _REFUSALS.get(error.errno or 0)
    return known or f"{error.strerror or error}; check the path and the disk"


DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSALS = {
    **dict.fromkeys(DISK_FULL, "the disk is full or a limit is reached; free some space"),
    **dict.fromkeys((errno.EACCES, errno.EPERM), "no permission; choose a place that you may read and write"),
    **dict.fromkeys(
        (errno.EEXIST, errno.ENOTDIR), "a file stands where a folder is needed; choose another place"
    ),
    errno.EROFS: "the file system is read-only; choose another place",
    errno.EISDIR: "a folder stands where a file is needed; choose another name",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.ENOENT: "does not exist; check the path",
    errno.EIO: "the disk reports a fault; check it",
}
