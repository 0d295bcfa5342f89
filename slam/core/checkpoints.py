"""Checkpoints: results of expensive work with which a later run goes on, if this one is killed.

A result is found by its kind of work and by a key, a digest of all that it depends on. One that is found is
therefore that of the work itself, to the bit, and nothing has to say when a result is void. Stages `recall`
a result before they do the work, and `keep` it after.

- `slam.core.packing` makes bytes and digests of values.
- `slam.io.checkpoint_file` is the file of a run. `slam.cli.checkpoints` opens it, and says what all results
  depend on.
- `slam.mapping.checkpoints` (pictures, tracking, pairs, refinement) and `slam.report.rasters.checkpoints`
  (mosaics) know what each kind of work depends on.
- Work of `frontend` and `backend` states beside itself what it needs of its checkpoints:
  `frontend.photographs`, `frontend.mosaic.checkpoints`, `backend.bundle.checkpoints`. The state with which
  tracking goes on is `frontend.tracking_state`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Protocol, TypeVar

from slam.core.packing import UnpackError, unpack

Result = TypeVar("Result")
Work = Literal["picture", "pair", "track", "refine", "mosaic"]
"""Kinds of work: a search for features, a comparison of two pictures, a stretch of tracking, a round of the
refinement, and a job on the pictures of a mosaic."""


class Checkpoints(Protocol):
    """Results by their kind of work and key."""

    @property
    def are_kept(self) -> bool:
        """Whether results are kept, so that keys are worth their time."""

    def recall(self, work: Work, key: bytes) -> bytes | None:
        """Return a result of this or an earlier run; None where it is not known."""

    def keep(self, work: Work, key: bytes, result: bytes) -> None:
        """Keep a result; it is safe against a kill when the function returns."""

    def say(self, line: str) -> None:
        """Tell the user what was resumed."""


class NoCheckpoints:
    """Nothing is kept."""

    are_kept = False

    def recall(self, work: Work, key: bytes) -> bytes | None:
        """Know nothing."""
        return None

    def keep(self, work: Work, key: bytes, result: bytes) -> None:
        """Forget the result."""

    def say(self, line: str) -> None:
        """Print nothing."""


NO_CHECKPOINTS = NoCheckpoints()


def recall_as(
    kind: type[Result], checkpoints: Checkpoints, work: Work, key: bytes, parts: Iterable[type] = ()
) -> Result | None:
    """Return a result of one class that `slam.core.packing.pack` made bytes of; None where it is not known.

    ``parts``: further classes that it may hold.
    """
    kept = checkpoints.recall(work, key)
    try:
        found = None if kept is None else unpack(kept, (kind, *parts))
    except UnpackError:
        return None
    return found if isinstance(found, kind) else None
