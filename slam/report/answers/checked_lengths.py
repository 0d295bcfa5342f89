"""Passages that ask for a length measured on the ground, in a page that may later hold such a measurement.

An evaluation against known distances has checked the lengths of a map. What asked a pilot to do so then says
where the result stands. The page holds both wordings, one of them in a comment, so that a later evaluation
can exchange them. In the text of an answer, private characters of Unicode mark the passage.
"""

from __future__ import annotations

import re

from markupsafe import Markup, escape

from slam.core.errors import one_line
from slam.core.messages import CHECKED_BY_ONE_DISTANCE

RESULT = "“How far is it from the truth?” under “In short”"
"""Name of the answer that compares lengths with known distances; figures further down name it too."""
CHECKED = f"Known distances on the ground have checked the lengths ({RESULT})."
_BEGIN, _OR, _END = "\ue000", "\ue001", "\ue002"
_IN_TEXT = re.compile(f"{_BEGIN}([^{_OR}]*){_OR}([^{_END}]*){_END}")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_IN_PAGE = re.compile("<!-- (unless checked|checked): (.*?) -->(.*?)<!-- /(?:unless )?checked -->", re.DOTALL)


def unless_checked(ask: str, checked: str = "") -> str:
    """Return a passage that reads ``ask``, and ``checked`` where known distances have checked the lengths."""
    return f"{_BEGIN}{ask}{_OR}{checked}{_END}"


def basis(text: str) -> str:
    """Return what an accuracy rests on, whose end asks for a distance unless one was measured."""
    if not text.endswith(CHECKED_BY_ONE_DISTANCE):
        return text
    return text.removesuffix(CHECKED_BY_ONE_DISTANCE) + unless_checked(
        CHECKED_BY_ONE_DISTANCE, f"In its place, {CHECKED[0].lower()}{CHECKED[1:]}"
    )


def as_asked(text: str) -> str:
    """Return the text of a page without known distances."""
    return _IN_TEXT.sub(r"\1", text)


def as_html(text: str) -> Markup:
    """Return the text as HTML, with both wordings of each passage."""
    html, end = Markup(), 0
    for found in _IN_TEXT.finditer(text):
        ask, checked = (_with_options(part) for part in found.groups())
        html += _with_options(text[end : found.start()])
        html += Markup("<!-- unless checked: {} -->{}<!-- /unless checked -->").format(checked, ask)
        end = found.end()
    return html + _with_options(text[end:])


def _with_options(text: str) -> Markup:
    """Return the text as HTML, with each command-line option as code, which no line break divides."""
    return Markup(_OPTION.sub(r"<code>\g<0></code>", str(escape(one_line(text)))))


def settled(page: str, checked: bool) -> str:
    """Return a page whose passages say that lengths were checked, or ask for it."""
    name = "checked" if checked else "unless checked"

    def exchanged(found: re.Match[str]) -> str:
        shown, hidden = found[3], found[2]
        if found[1] != name:
            shown, hidden = hidden, shown
        return f"<!-- {name}: {hidden} -->{shown}<!-- /{name} -->"

    return _IN_PAGE.sub(exchanged, page)
