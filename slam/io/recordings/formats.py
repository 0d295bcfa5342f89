"""The known formats of recordings. Each is one module with ``open_recording``, and one row of ``FORMATS``."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from slam.core.errors import explain
from slam.io.content import HEAD_BYTES, content_name
from slam.io.files import refusal
from slam.io.recordings.kitti import is_kitti
from slam.io.recordings.recording import Recording
from slam.io.recordings.video import mp4
from slam.io.text_encoding import decode_text, wide_encoding


@dataclass(frozen=True)
class Format:
    """A format, and how its files are recognised."""

    description: str
    """With its article: "a PX4 log"."""
    module: str
    """Module of this package whose ``open_recording(path)`` returns a ``Recording``."""
    suffixes: tuple[str, ...]
    """Usual suffixes, in small letters."""
    starts: tuple[bytes, ...]
    """The first bytes of a file of this format, one of several."""
    pattern: re.Pattern[bytes] | None = None
    """Pattern of the first bytes, where they vary."""
    check: str = ""
    """Function of the module that raises ``InputError`` for a text with the suffix, but of another content.

    Empty where the first bytes tell.
    """

    def begins(self, head: bytes) -> bool:
        """Return whether a file with these first bytes is of this format."""
        return head.startswith(self.starts) or (self.pattern is not None and bool(self.pattern.match(head)))


_TELEMETRY = re.compile(rb"\0[\x03-\x07].{6}[\xfd\xfe]", re.DOTALL)
"""Microseconds of a year from 2001 to 2037, the highest byte first, and the start of a packet."""
_MCAP_WITHOUT_ROS = re.compile(rb"\x89MCAP0\r\n\x01.{8}(?!\x04\0\0\0ros[12])", re.DOTALL)
"""The first record, with the length and the text of the profile."""
_TRANSPORT_STREAM = re.compile(rb"\x47[\x40-\x5f].{186}\x47", re.DOTALL)
"""MPEG-2 transport stream: packets of 188 bytes (ISO/IEC 13818-1, section 2.4.3)."""
_BARE_STREAM = re.compile(rb"\0?\0\0\x01([\x09\x27\x47\x67]|[\x40\x46]\x01)", re.DOTALL)
"""H.264 or H.265 without a container: the first unit is a delimiter or a parameter set."""
_NUMBER = rb"[-+]?\d[-+\d.eE]*"
_GROUND_LIST = re.compile(
    rb"[^\n\0]+\.(png|jpe?g|tiff?|bmp)[ \r]*\n[ *]*" + _NUMBER + rb"([ \t]+" + _NUMBER + rb"){2}",
    re.IGNORECASE,
)
"""A picture, and the first row of its pose."""
_TABLE = re.compile(
    rb"(\xef\xbb\xbf)?[^\n\0]*?(?<![a-z])(time|timestamp|stamp|t)(?![a-z])[^\n\0]*?[,;|\t]", re.IGNORECASE
)
"""A header with a time and another column."""
_SUBTITLES = re.compile(rb"(\xef\xbb\xbf)?\s*\d+\s*[\r\n].*(-->|\[latitude)", re.DOTALL)


FORMATS: tuple[Format, ...] = (
    Format("a PX4 log", "logs.ulog", (".ulg", ".ulog"), (b"ULog\x01\x12\x35",)),
    Format("an ArduPilot log", "logs.dataflash", (".bin",), (b"\xa3\x95\x80",)),
    Format("a MAVLink telemetry log", "logs.tlog", (".tlog",), (), _TELEMETRY),
    Format(
        "an AR.Drone's navdata",
        "logs.ardrone",
        (".navdata",),
        (b"\x88\x77\x66\x55", b"\x89\x77\x66\x55"),
    ),
    Format("a video of an AR.Drone", "video.pave", (".pave",), (b"PaVE",)),
    Format("a ROS 1 bag", "ros.rosbag", (".bag",), (b"#ROSBAG V2.0\n",)),
    Format("a ROS 2 bag", "ros.rosbag", (".db3",), (b"SQLite format 3\0",)),
    Format("a video", "video.video", (".mp4", ".mov", ".m4v"), (), mp4.START),
    Format("a video", "video.video", (".mkv", ".webm"), (b"\x1a\x45\xdf\xa3",)),
    Format("a video", "video.video", (".avi",), (), re.compile(rb"RIFF.{4}AVI ", re.DOTALL)),
    Format("a video", "video.video", (".ts", ".mts"), (), _TRANSPORT_STREAM),
    Format("a video", "video.video", (".h264", ".264", ".h265", ".hevc"), (), _BARE_STREAM),
    Format("a video", "video.video", (".flv",), (b"FLV\x01",)),
    Format("a file of subtitles", "video.video", (".srt",), (), _SUBTITLES),
    Format("a list of ground pictures", "ground_list", (), (), _GROUND_LIST),
    Format("a table of readings", "tables.table", (".csv", ".tsv"), (), _TABLE, "check_titles"),
    Format("an MCAP recording", "foxglove.foxglove", (".mcap",), (), _MCAP_WITHOUT_ROS),
    Format("an MCAP recording", "ros.rosbag", (".mcap",), (b"\x89MCAP0\r\n",)),
)


@dataclass(frozen=True)
class FolderFormat:
    """A format of folders, and how they are recognised."""

    module: str
    fits: Callable[[Path], bool]
    """Return whether a folder is of this format, by the names in it."""


def _is_ros2(folder: Path) -> bool:
    """Return whether ``ros2 bag record`` may have written a folder."""
    names = [path.name for path in folder.iterdir()]
    return "metadata.yaml" in names and any(name.endswith((".db3", ".mcap", ".zstd")) for name in names)


FOLDERS: tuple[FolderFormat, ...] = (
    FolderFormat("ros.rosbag", _is_ros2),
    FolderFormat("kitti", is_kitti),
    FolderFormat("tum", lambda folder: (folder / "rgb.txt").is_file()),
)


def format_of(path: Path) -> Format | FolderFormat | None:
    """Return the format of a file or folder by its content, or None where it is no recording.

    Raises ``InputError`` for a file with the suffix of a format and other content.
    """
    if path.is_dir():
        return next((known for known in FOLDERS if known.fits(path)), None)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise refusal(path, "cannot be read", explain(error)) from None
    text = decode_text(head)[0].encode() if wide_encoding(head) else head
    found = next((known for known in FORMATS if known.begins(head) or known.begins(text)), None)
    named = next((known for known in FORMATS if path.suffix.lower() in known.suffixes), None)
    if found is None and named is not None:
        content = content_name(head)
        if named.check and not content:
            getattr(import_module(f"slam.io.recordings.{named.module}"), named.check)(path)
            return named
        other = f"is {content}" if content else "begins otherwise"
        what = f"has the name of {named.description}, but {other}" if head else "is empty"
        raise refusal(path, what, "copy it again from the recorder, or correct its name")
    return found


def open_recording(path: Path, *parts: Path) -> Recording:
    """Open a recording. Raises ``InputError`` where it is of no known format or damaged.

    ``parts``: other files of it, of a format that knows several.
    """
    found = format_of(path)
    if found is None:
        raise refusal(path, "is no recording of a known format", "docs/recordings.md lists the formats")
    opener: Callable[..., Recording] = import_module(f"slam.io.recordings.{found.module}").open_recording
    return opener(path, *parts)
