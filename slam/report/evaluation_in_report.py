"""Puts the result of ``slam evaluate`` into a report that was written before.

The page holds what an evaluation tells between pairs of comments. What stands between them is replaced, what
asked for known distances is exchanged (`slam.report.checked_lengths`), and all else stays byte for byte.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from slam.report.checked_lengths import settled
from slam.report.output_files import output_files
from slam.report.page import render_part

if TYPE_CHECKING:
    from slam.report.accuracy import Evaluated

_PARTS = ("evaluation_answer", "evaluation_tables", "file_list")
"""Macros of parts.html.j2 whose output the page holds between comments of the same name."""


def with_evaluation(page: str, evaluated: Evaluated, folder: Path) -> str | None:
    """Return the page of a map in ``folder`` with an evaluation; None where the page has no place for it."""
    for name in _PARTS:
        content = output_files(folder) if name == "file_list" else evaluated
        begin, end = (f"<!-- {mark}{name} -->" for mark in ("", "/"))
        found = re.search(f"{begin}.*?{end}", page, re.DOTALL)
        if found is None:
            return None
        page = f"{page[: found.start()]}{begin}{render_part(name, content)}{end}{page[found.end() :]}"
    return settled(page, evaluated.checks_lengths)
