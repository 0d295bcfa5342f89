"""Safe reading of untrusted files: regular, inside the folder and of bounded size, else a one-line error."""

from __future__ import annotations

import os
import stat
from dataclasses import replace
from pathlib import Path

from slam.core.errors import InputError, one_line
from slam.core.messages import Message, clauses_of, parsed, warning
from slam.io.content import HEAD_BYTES, content_name

OUTPUT_MARKER = ".slam-output"
"""Name of the file that marks a folder as an output of slam."""


def shown(name: str) -> str:
    r"""Return a file name as text that can be written and printed: bytes that are not UTF-8 become \xNN."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def brief(text: object, limit: int = 200) -> str:
    """Return external text for a message: on one line, at most ``limit`` characters."""
    shown = one_line(str(text))
    return shown if len(shown) <= limit else shown[: limit - 3] + "..."


def brief_message(message: Message, limit: int = 600) -> Message:
    """Return a message of external text on one line, with at most ``limit`` characters."""
    if len(message.text) > limit:
        return replace(message, clauses=clauses_of(brief(message.text, limit)))
    return replace(message, clauses=tuple(brief(clause, limit) for clause in message.clauses))


def refused_file(refused: InputError, folder: Path, effect: str) -> Message:
    """Return the warning that a file in a folder is refused, and its effect."""
    return parsed(str(refused).removeprefix(f"{folder}/")).extended(effect)


def refusal(
    path: Path | str, what: str, do: str, line: int | None = None, row_word: str = "line"
) -> InputError:
    """Return the error to raise: where (file and line), what is wrong, what to do."""
    where = brief(path, 400) + ("" if line is None else f", {row_word} {line}")
    return InputError(f"{where}: {brief(what, 600)}; {brief(do, 400)}")


def is_inside(path: Path, root: Path) -> bool:
    """Return whether a path stays in ``root``, symbolic links and ``..`` resolved."""
    return os.path.realpath(path).startswith(os.path.join(os.path.realpath(root), ""))


def check_inside(path: Path, root: Path) -> None:
    """Refuse a path that leads out of ``root``, by a symbolic link or by ``..``. Raises ``InputError``."""
    if not is_inside(path, root):
        raise refusal(path, f"leads out of the folder {root}", "copy the file into the folder")


def read_bytes(path: Path, root: Path, limit_bytes: int) -> bytes:
    """Return the content of a regular file inside ``root``.

    Raises ``InputError`` where it is missing, not a regular file, too large, unreadable or outside.
    """
    check_inside(path, root)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise refusal(path, f"is {_kind(status.st_mode)}, not a file", "put the file itself there")
        if status.st_size > limit_bytes:
            raise refusal(
                path,
                f"has {status.st_size:,} bytes, more than the {limit_bytes:,} allowed",
                "check what it is",
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise refusal(path, "does not exist", "check the folder is complete") from None
    except OSError as error:
        raise refusal(path, f"cannot be read ({error.strerror})", "check its permissions") from None


def read_text(path: Path, root: Path, limit_bytes: int) -> tuple[str, list[Message]]:
    """Return the UTF-8 text of a small file, and a note about zero bytes at its end, which are dropped.

    Raises ``InputError`` as ``read_bytes`` does, and where the file holds something else than text.
    """
    data, notes = without_zero_tail(read_bytes(path, root, limit_bytes))
    refuse_other_content(path, data)
    try:
        return data.decode("utf-8-sig"), [note.after(path.name) for note in notes]
    except UnicodeDecodeError:
        raise refusal(path, "is not UTF-8 text", "save it as UTF-8") from None


def without_zero_tail(data: bytes) -> tuple[bytes, list[Message]]:
    """Return data without the zero bytes at its end, and a note about them."""
    text = data.rstrip(b"\0")
    zeros = len(data) - len(text)
    return text, [
        warning(f"the last {zeros} bytes are zeros (power loss?) and were dropped")
    ] if zeros else []


def refuse_other_content(path: Path, head: bytes) -> None:
    """Raise ``InputError`` where the first bytes of a text file are those of another format."""
    if head and (found := content_name(head[:HEAD_BYTES])):
        raise refusal(path, f"is {found}, not a text file", "put the right file there")


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "a folder"
    return "a named pipe" if stat.S_ISFIFO(mode) else "a device or socket"
