"""What a person at the terminal sees while work goes on: bars, or one line a stage where output is a file.

Everything goes to standard output; standard error holds nothing but the one line of a refused input.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from slam.core.progress import Progress

_PIPE_COLUMNS = 120


def console() -> Console:
    """The console on standard output as it is now; wide enough for a path where it is not a terminal."""
    from rich.console import Console

    plain = Console(highlight=False)
    if plain.is_terminal or "COLUMNS" in os.environ:
        return plain
    return Console(highlight=False, width=_PIPE_COLUMNS)


@contextmanager
def show_progress(out: Console) -> Iterator[Progress]:
    """A ``Progress`` that draws on ``out`` until the block ends."""
    if not out.is_terminal:
        yield _Lines(out)
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=out) as bars:
        yield _Bars(bars)


class _Lines:
    """One line when a stage begins: what a log needs to tell where a long run is."""

    def __init__(self, out: Console) -> None:
        self._out = out
        self._seen: set[str] = set()

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage not in self._seen:
            self._seen.add(stage)
            self._out.print(f"{stage} ({total})" if total else stage, markup=False)


class _Bars:
    """One bar a stage; a stage without a known total shows that it lives."""

    def __init__(self, bars: RichProgress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        from rich.markup import escape

        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(escape(stage), total=total or None)
        self._bars.update(self._tasks[stage], completed=done, total=total or None)
