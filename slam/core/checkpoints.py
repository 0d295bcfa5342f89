"""Results of expensive work that a later run can use, if this one is killed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Protocol, TypeVar

from slam.core.packing import UnpackError, unpack

Result = TypeVar("Result")
Work = Literal["picture", "pair", "track", "refine", "mosaic"]
"""Kinds of work: a search for features, a comparison of two pictures, a stretch of tracking, a round of the
refinement, and a job on the pictures of a mosaic."""


class Checkpoints(Protocol):
    """Results by the kind of work, and by a key that is a digest of all that a result depends on."""

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
