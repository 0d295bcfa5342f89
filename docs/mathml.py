"""Hook of mkdocs: mathematics of the pages becomes MathML, which browsers show without a script."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

_MARKED = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
"""What pymdownx.arithmatex marks: \\(inline\\) in a span, and \\[a block\\] in a div."""


def on_page_content(content: str, **_: Any) -> str:
    """Return the HTML of a page with its formulas in MathML."""
    return _MARKED.sub(_in_mathml, content)


def _in_mathml(found: re.Match[str]) -> str:
    tag, latex = found.groups()
    return convert(html.unescape(latex), display="inline" if tag == "span" else "block")
