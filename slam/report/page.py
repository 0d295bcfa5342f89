"""Render a template and its figures as one HTML page with everything embedded."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from slam.core.errors import one_line


@dataclass(frozen=True)
class Item:
    """A figure with its name."""

    label: str
    value: str


def render_page(template: str, **content: object) -> str:
    """Return the page as HTML; every external name is escaped and stripped of control characters."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("slam.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: (
            one_line(value) if isinstance(value, str) and not value.isprintable() else value
        ),
    )
    return environment.get_template(template).render(**content)


def embedded(picture: bytes, kind: str = "png") -> str:
    """Encode a picture as a data address that needs no file."""
    return f"data:image/{kind};base64," + base64.b64encode(picture).decode()
