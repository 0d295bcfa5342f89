"""A step of odometry that pairs of pictures contradict, in numbers and in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from backend.measurements import Misfit
from slam.core.messages import Message, warning


@dataclass(frozen=True)
class ContradictedStep:
    """A stretch of odometry over which pairs of pictures agree on another displacement than the poses."""

    pairs: int
    """Number of pairs of pictures that lead over it, agree with each other, and contradict it."""
    off: Misfit
    """Distance of their second ends from where odometry puts them, and the angle."""
    between: tuple[int, int]
    """All of these pairs lead from the first of these two keyframes, or before, to the second, or behind."""
    weakest: tuple[int, int]
    """The same of the stretch with the least certain odometry between them."""
    left_out: bool
    """Whether its odometry was left out; else the pairs were, which are no more than its links."""

    def sentence(self, name: Callable[[int], str]) -> Message:
        """Return what contradicts what, by how much, where, and what to do; ``name`` of each keyframe."""
        begin, end = (name(k) for k in self.between)
        first, last = (name(k) for k in self.weakest)
        if self.left_out:
            verdict = (
                f"its links from {first} to {last}, the least certain there, are left out, and places near "
                f"them may be off by {self.off.length:.2g} {self.off.unit}"
            )
        else:
            verdict = "too few to tell which is wrong: the map follows the odometry, and may be wrong by that"
        return warning(
            f"{self.pairs} pairs of pictures agree with each other and contradict the odometry by {self.off},"
            f" somewhere between {begin} and {end}: {verdict}",
            "" if self.left_out else "fly over that ground again",
            f"look for damaged or frozen pictures from {first} to {last}",
        )
