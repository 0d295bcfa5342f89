"""The file of checkpoints. Each result is appended with a digest of its bytes.

A kill in the middle leaves all results before it, and a damaged result is not used. Results are data
(`slam.core.packing`), and nothing of the file is run.
"""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from types import TracebackType

from slam.core.checkpoints import Work
from slam.core.errors import explain
from slam.core.packing import DIGEST_BYTES

_FORMAT = b"slam checkpoints 2\n"
_HEAD = struct.Struct(f"<8sQ{DIGEST_BYTES}s{DIGEST_BYTES}s")
"""Work, length, key and digest of a result. Damage here hides results: no others have these digests."""
_RUN = "run"
"""Kind of the first record: what all results of the file depend on."""
_RUN_KEY = bytes(DIGEST_BYTES)
_FLUSHED_EVERY_S = 60.0
"""A kill loses nothing that was written; a failure of power loses what was written since the last flush."""
_MOST_RUN_BYTES = 1 << 16


class CheckpointFile:
    """Checkpoints (`slam.core.checkpoints.Checkpoints`) in a file that belongs to one run at a time."""

    def __init__(
        self,
        path: Path,
        run: Mapping[str, str],
        resume: bool = True,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Open the file, or make it.

        ``run``: what all results depend on, by a name that a user understands. What another such run left, or
        any run without ``resume``, is removed. ``say`` prints a line.
        """
        self._path, self._say = path, say
        self._at: dict[tuple[str, bytes], tuple[int, int, bytes]] = {}
        self._end, self._flushed_s = 0, time.monotonic()
        self._file: int | None = None
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
            if resume:
                self._read(dict(run))
            if not self._end:
                self._begin(dict(run))
        except OSError as error:
            self._give_up(error)

    def __enter__(self) -> CheckpointFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None
            if len(self._at) <= 1:  # nothing but what the results would have depended on
                self._path.unlink(missing_ok=True)

    @property
    def are_kept(self) -> bool:
        """Whether results are kept: until the disk is full."""
        return self._file is not None

    def recall(self, work: Work, key: bytes) -> bytes | None:
        """Return a result of this or an earlier run; None where it is not known."""
        if self._file is None or (work, key) not in self._at:
            return None
        begin, length, digest = self._at[work, key]
        try:
            result = os.pread(self._file, length, begin)
        except OSError:
            result = b""
        if _digest(result) != digest:
            del self._at[work, key]
            self._say(f"{self._path}: a result is damaged, and is computed again")
            return None
        return result

    def keep(self, work: Work, key: bytes, result: bytes) -> None:
        """Append a result. Where that fails, nothing is kept from then on, and the run goes on."""
        if self._file is None:
            return
        try:
            self._append(work, key, result)
            if time.monotonic() - self._flushed_s > _FLUSHED_EVERY_S:
                os.fsync(self._file)
                self._flushed_s = time.monotonic()
        except OSError as error:
            self._give_up(error)

    def say(self, line: str) -> None:
        """Print a line."""
        self._say(line)

    def _append(self, work: str, key: bytes, result: bytes) -> None:
        assert self._file is not None
        digest = _digest(result)
        head = _HEAD.pack(work.encode(), len(result), key, digest)
        raw = memoryview(head + result)
        written = 0
        while written < len(raw):  # the system may write only a part
            written += os.pwrite(self._file, raw[written:], self._end + written)
        self._at[work, key] = self._end + _HEAD.size, len(result), digest
        self._end += len(raw)

    def _begin(self, run: dict[str, str]) -> None:
        assert self._file is not None
        self._at.clear()
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, _FORMAT, 0)
        self._end = len(_FORMAT)
        self._append(_RUN, _RUN_KEY, json.dumps(run).encode())

    def _read(self, run: dict[str, str]) -> None:
        """Find the results of an earlier run, if they were made of the same."""
        assert self._file is not None
        size = os.fstat(self._file).st_size
        if not size:
            return
        if os.pread(self._file, len(_FORMAT), 0) != _FORMAT:
            self._say("starts anew: what the last run left is damaged, or of another version")
            return
        end = self._scan(size)
        before = self._run_before()
        if before is None:
            self._say("starts anew: what the last run left is damaged")
            return
        changed = [name for name, value in run.items() if before.get(name) != value]
        if changed:
            self._say(f"starts anew: since the run that was ended, {' and '.join(changed)} changed")
            return
        if end < size:  # of a record that a kill cut off, or damage
            os.ftruncate(self._file, end)
        self._end = end

    def _scan(self, size: int) -> int:
        """Find the records, and return where the last whole one ends."""
        assert self._file is not None
        at = len(_FORMAT)
        while at + _HEAD.size <= size:
            raw = os.pread(self._file, _HEAD.size, at)
            work, length, key, digest = _HEAD.unpack(raw)
            begin = at + _HEAD.size
            if length > size - begin:
                break
            self._at[work.rstrip(b"\0").decode("ascii", "replace"), key] = begin, length, digest
            at = begin + length
        return at

    def _run_before(self) -> dict[str, str] | None:
        """Return what the results in the file depend on; None where that is damaged."""
        assert self._file is not None
        begin, length, digest = self._at.get((_RUN, _RUN_KEY), (0, 0, b""))
        raw = os.pread(self._file, min(length, _MOST_RUN_BYTES), begin)
        if _digest(raw) != digest:
            return None
        try:
            found = json.loads(raw)
        except ValueError:
            return None
        return found if isinstance(found, dict) else None

    def _give_up(self, error: OSError) -> None:
        """Keep nothing any more, and give the disk back."""
        if self._file is None:
            self._say(f"no checkpoints: {self._path}: {explain(error)}")
        else:
            self._say(f"no checkpoints any more: {explain(error)}")
            with suppress(OSError):  # a disk that failed may refuse this too
                self._path.unlink()
            with suppress(OSError):
                os.close(self._file)
        self._file = None
        self._at.clear()


def _digest(raw: bytes) -> bytes:
    return blake2b(raw, digest_size=DIGEST_BYTES).digest()
