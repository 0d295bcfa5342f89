"""Workers that send all that they are given as other processes would receive it."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future

from frontend.workers import Item, Result, Shared, Workers


def sent(value: Item) -> Item:
    """Return a copy as another process would receive it."""
    copy: Item = pickle.loads(pickle.dumps(value))
    return copy


class SentWorkers(Workers):
    """Threads that work on copies alone."""

    def share(self, value: Shared) -> Shared:
        return sent(value)

    def submit(
        self, pool: Executor, job: Callable[[Shared, Item], Result], shared: Shared, item: Item
    ) -> Future[Result]:
        return pool.submit(lambda: sent(sent(job)(shared, sent(item))))
