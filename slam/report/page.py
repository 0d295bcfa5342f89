"""Render a template and its figures as one HTML page with everything embedded."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slam.core.errors import one_line
from slam.report.answers.checked_lengths import as_html

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class Item:
    """A figure with its name."""

    label: str
    value: str
    lines: tuple[str, ...] = ()
    """Sentences that follow, each group on a line of its own."""


def render_page(template: str, **content: object) -> str:
    """Return the page as HTML; every external name is escaped and stripped of control characters."""
    return _environment().get_template(template).render(**content)


def render_part(name: str, content: object) -> str:
    """Return the output of a macro of parts.html.j2 as HTML, escaped as a page is."""
    return str(getattr(_environment().get_template("parts.html.j2").module, name)(content))


def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("slam.report", "."), autoescape=True, undefined=StrictUndefined, finalize=_shown
    )
    environment.filters["asked"] = as_html
    return environment


def _shown(value: object) -> object:
    """Return a value for a page; text of others, which the output of a macro is not, in one line."""
    from markupsafe import Markup

    foreign = isinstance(value, str) and not isinstance(value, Markup) and not value.isprintable()
    return one_line(str(value)) if foreign else value


def embedded(picture: bytes, kind: str = "png") -> str:
    """Encode a picture as a data address that needs no file."""
    return f"data:image/{kind};base64," + base64.b64encode(picture).decode()
