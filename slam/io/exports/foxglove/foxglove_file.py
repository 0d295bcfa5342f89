"""An MCAP file of protobuf messages that is being written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from slam.core.errors import InputError
from slam.core.version import VERSION

Message = Any

METADATA = "lemniscate"
"""Name of the record with facts about the map."""
_PACKAGES = ("mcap_protobuf.writer", "foxglove_schemas_protobuf")
_MAX_NS = 2**63
"""Readers hold times in 64 bits with a sign."""


class FoxgloveFile:
    """Takes messages in the order of their times."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer

    def add(self, topic: str, stamp_ns: int, message: Message) -> None:
        """Append a message of Foxglove's protobuf classes. Raises ``InputError`` for a stamp before 1970."""
        if not 0 <= stamp_ns < _MAX_NS:
            raise InputError("a stamp of the map is before 1970, which MCAP cannot hold; write tum")
        self._writer.write_message(topic, message, log_time=stamp_ns, publish_time=stamp_ns)


@contextmanager
def new_mcap(path: Path, facts: Mapping[str, str], chunk_bytes: int = 1 << 20) -> Iterator[FoxgloveFile]:
    """Write a file with the ``facts`` as its metadata; its index follows at the end of the block.

    If the program is killed, the last ``chunk_bytes`` are lost, and the index.

    Raises ``InputError`` without the packages of the extra ``foxglove``.
    """
    require_packages()
    writer_type = import_module("mcap_protobuf.writer").Writer
    with path.open("wb") as stream:
        writer = writer_type(stream, chunk_size=chunk_bytes)
        writer.add_metadata(METADATA, {"written_by": f"slam {VERSION}", **facts})
        try:
            yield FoxgloveFile(writer)
        finally:
            writer.finish()


def require_packages() -> None:
    """Raise ``InputError`` that says how to install what writes these files, if it is missing."""
    try:
        for name in _PACKAGES:
            import_module(name)
    except ImportError:
        raise InputError(
            "the packages that write MCAP files are not installed; run: pip install "
            "'lemniscate-slam[foxglove]'"
        ) from None
