"""Results of expensive work that a later run can use, if this one is killed."""

from __future__ import annotations

from typing import Literal, Protocol

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
