"""Puts the result of ``slam evaluate`` into a report that was written before.

The page holds what an evaluation tells between pairs of comments. What stands between them is replaced, what
asked for known distances is exchanged (`slam.report.answers.checked_lengths`), the pictures of the maps are
drawn again where landmarks were compared, and all else stays byte for byte.
"""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING

from slam.report.answers.checked_lengths import settled
from slam.report.output_files import output_files
from slam.report.page import render_part
from slam.report.pictures.map import map_picture
from slam.report.pictures.mosaic_marks import MapMarks, Mark

if TYPE_CHECKING:
    from slam.report.tables.evaluation import Evaluated

_PARTS = ("evaluation_answer", "evaluation_tables", "file_list")
"""Macros of parts.html.j2 whose output the page holds between comments of the same name."""
_LANDMARKS = "landmark_words"
"""The macro whose output tells of landmarks on the map, and which a page without a mosaic lacks."""
_MAP = re.compile(
    '(<img [^>]*data-file="([^"]*)" data-unit="([^"]*)" data-axes="([^"]*)" data-points="([^"]*)"[^>]* src=")'
    '[^"]*'
)
"""A picture of a map, with the file that it shows and its marks without those of an evaluation."""


def with_evaluation(page: str, evaluated: Evaluated, folder: Path) -> str | None:
    """Return the page of a map in ``folder`` with an evaluation; None where the page has no place for it."""
    for name in _PARTS:
        content = output_files(folder) if name == "file_list" else evaluated
        changed = _with_part(page, name, content)
        if changed is None:
            return None
        page = changed
    return settled(_with_landmarks(page, evaluated, folder), evaluated.checks_lengths)


def _with_part(page: str, name: str, content: object) -> str | None:
    begin, end = (f"<!-- {mark}{name} -->" for mark in ("", "/"))
    found = re.search(f"{begin}.*?{end}", page, re.DOTALL)
    if found is None:
        return None
    return f"{page[: found.start()]}{begin}{render_part(name, content)}{end}{page[found.end() :]}"


def _with_landmarks(page: str, evaluated: Evaluated, folder: Path) -> str:
    """Return the page with the landmarks of the evaluation on the pictures of both maps, in place of earlier
    ones."""
    changed = _with_part(page, _LANDMARKS, evaluated)
    if changed is None or changed == page:
        return page

    def drawn(found: re.Match[str]) -> str:
        points = tuple(Mark(*row) for row in json.loads(unescape(found[5])))
        address = map_picture(folder / found[2], MapMarks(found[3], found[4] == "earth", points), evaluated)
        return found[0] if address is None else f"{found[1]}{address}"

    return _MAP.sub(drawn, changed)
