"""Checkpoints of the jobs on the pictures of a mosaic: a job whose result is known costs no work.

The stages of a mosaic state here what they need of them, and `slam.report.rasters.checkpoints` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

from frontend.mosaic.plan import MosaicPlan
from frontend.workers import Ready, Workers, workers

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class StageCheckpoints(Protocol):
    """Results of the jobs of one stage."""

    def recall(self, item: object) -> Any:
        """Return the result for an item; None where it is not known."""

    def keep(self, item: object, result: object) -> None:
        """Keep the result for an item."""


class MosaicCheckpoints(Protocol):
    """Results of the jobs on pictures of a mosaic."""

    def stage(self, name: str, plan: MosaicPlan, *others: object) -> StageCheckpoints:
        """Return the results of jobs that depend on a plan, on its pictures, and on ``others``."""


class NoMosaicCheckpoints:
    """Nothing is kept, in any stage."""

    def stage(self, name: str, plan: MosaicPlan, *others: object) -> StageCheckpoints:
        """Return this for each stage."""
        return self

    def recall(self, item: object) -> Any:
        """Know nothing."""
        return None

    def keep(self, item: object, result: object) -> None:
        """Forget the result."""


NO_MOSAIC_CHECKPOINTS = NoMosaicCheckpoints()


def with_checkpoints(
    checkpoints: StageCheckpoints,
    job: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Sequence[Item],
    share: Workers | None = None,
    reused: Callable[[Item], Result | None] = lambda item: None,
) -> Iterator[Result]:
    """Yield ``job(shared, item)`` for each item, in order, as `frontend.workers.Workers.map` does.

    A result that is None is not kept. ``share``: the workers, by default those of `frontend.workers`.
    ``reused`` is asked first: it returns a result that is known otherwise.
    """
    new: set[int] = set()

    def wanted() -> Iterator[Item | Ready[Result]]:
        for k, item in enumerate(items):
            known = reused(item)
            if known is None:
                known = checkpoints.recall(item)
            if known is not None:
                yield Ready(known)
            else:
                new.add(k)
                yield item

    done = (share or workers()).map(job, shared, wanted())
    for k, result in enumerate(done):
        if k in new and result is not None:
            checkpoints.keep(items[k], result)
        yield result
