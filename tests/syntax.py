"""Walks over the syntax of source files."""

from __future__ import annotations

import ast
from collections.abc import Iterator


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements below a node, which are far fewer than its expressions."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        below = getattr(node, part, [])
        for one in below if isinstance(below, list) else []:
            yield one
            yield from statements(one)
