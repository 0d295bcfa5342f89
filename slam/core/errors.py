"""The root class of all errors that a user can cause and correct, and system errors in plain words."""

import errno
from unicodedata import category


class InputError(Exception):
    """The input was refused; the message is one line: what, where, and what to do. Exit code 1."""


NO_CAMERA = "flights without a camera are for `slam estimate`"
"""Advice for flights without pictures, of which no map can be made."""


def one_line(text: str) -> str:
    """Return text with names from outside as one printable line, without invisible characters."""
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if category(letter) in _UNPRINTABLE else letter for letter in text
    )


_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def explain(error: OSError) -> str:
    """Say why the system refused and what to do; the file is left out, ``error.filename`` may name it."""
    message = _REFUSALS.get(error.errno or 0)
    return message or f"{error.strerror or error}; check the path and the disk"


MORE_PROCESSES = "end other programs, or raise the limit of processes and threads (ulimit -u, pids.max)"
"""Advice where the system starts no further process or thread."""
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSALS = {
    **dict.fromkeys(DISK_FULL, "the disk is full or a limit is reached; free some space"),
    **dict.fromkeys((errno.EACCES, errno.EPERM), "no permission; choose a place that you may read and write"),
    **dict.fromkeys(
        (errno.EEXIST, errno.ENOTDIR), "there is a file where a folder is needed; choose another place"
    ),
    errno.EROFS: "the file system is read-only; choose another place",
    errno.EISDIR: "there is a folder where a file is needed; choose another name",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.ENOENT: "does not exist; check the path",
    errno.EAGAIN: f"the system has no process or thread left; {MORE_PROCESSES}",
    errno.EIO: "the disk reports a fault; check it",
}
