"""Output of a command: tables or JSON on standard output; progress, log and errors on standard error.

Progress is drawn as bars on a terminal. Elsewhere, and with ``--verbose``, it is one line per stage.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from slam.core.errors import one_line
from slam.core.progress import silent

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from slam.core.figure_table import FigureTable
    from slam.core.progress import Progress

_PIPE_COLUMNS = 120


def console(stderr: bool = False) -> Console:
    """Return a console on standard output or error; wide enough for a path where it is not a terminal."""
    from rich.console import Console

    plain = Console(highlight=False, stderr=stderr)
    if plain.is_terminal or "COLUMNS" in os.environ:
        return plain
    return Console(highlight=False, stderr=stderr, width=_PIPE_COLUMNS)


class Screen:
    """Output of one command, as its options ``--quiet`` and ``--json`` ask for it."""

    def __init__(self, quiet: bool = False, as_json: bool = False) -> None:
        self._quiet = quiet
        self._as_json = as_json

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Show progress on standard error until the block ends; nothing with ``--quiet``."""
        if self._quiet:
            yield silent
            return
        with show_progress(console(stderr=True)) as progress:
            yield progress

    def print(self, renderable: RenderableType) -> None:
        """Print a table or a text; nothing with ``--quiet`` or ``--json``."""
        if self.shows_tables:
            console().print(renderable)

    @property
    def shows_tables(self) -> bool:
        """Whether tables are printed."""
        return not self._quiet and not self._as_json

    def table(self, figures: FigureTable) -> None:
        """Print a table of figures."""
        from slam.cli.tables import rich_table

        self.print(rich_table(figures))

    def line(self, text: str, style: str | None = None) -> None:
        """Print a line of text as it is, without markup."""
        if self.shows_tables:
            console().print(text, markup=False, style=style)

    def note(self, text: str) -> None:
        """Print a line about the run on standard error; nothing with ``--quiet``."""
        if not self._quiet:
            print(f"slam: {one_line(text)}", file=sys.stderr)

    def files(self, paths: Sequence[Path]) -> None:
        """Print the paths of the files that a person opens first."""
        from slam.cli.tables import path_list

        if self.shows_tables:
            console().print(path_list(paths), soft_wrap=True)

    def json(self, text: str) -> None:
        """Write JSON text to standard output; nothing without ``--json``."""
        if self._as_json:
            sys.stdout.write(text)

    def json_file(self, path: Path) -> None:
        """Write the content of a JSON file to standard output; nothing without ``--json``."""
        if self._as_json:
            self.json(path.read_text(encoding="utf-8"))


@contextmanager
def show_progress(out: Console) -> Iterator[Progress]:
    """Draw progress on ``out`` until the block ends."""
    if not out.is_terminal or logging.getLogger("slam").isEnabledFor(logging.INFO):
        yield _Lines(out)
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=out) as bars:
        yield _Bars(bars)


class _Lines:
    """Prints one line when a stage begins."""

    def __init__(self, out: Console) -> None:
        self._out = out
        self._seen: set[str] = set()

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage not in self._seen:
            self._seen.add(stage)
            self._out.print(f"{stage} ({total})" if total else stage, markup=False)


class _Bars:
    """Draws one bar per stage; the bar of a stage without a known total moves to show activity."""

    def __init__(self, bars: RichProgress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        from rich.markup import escape

        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(escape(stage), total=total or None)
        self._bars.update(self._tasks[stage], completed=done, total=total or None)
