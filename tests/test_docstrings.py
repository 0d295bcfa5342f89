"""Docstrings are sentences, and no public class name has two meanings."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FRAGMENTS = {"Of", "By", "Times", "What", "Who", "Where", "Beyond", "Beside"}
"""A docstring that begins with one of these words is no sentence."""


def sources() -> Iterator[tuple[str, ast.Module]]:
    """Name and syntax tree of every source file."""
    for package in ("slam", "frontend", "backend"):
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings of modules, classes, functions, fields and constants."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        for before, statement in zip([None, *node.body], node.body, strict=False):
            match statement:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    if before is None or isinstance(before, ast.Assign | ast.AnnAssign):
                        yield statement.lineno, text


def fragments(tree: ast.Module) -> list[tuple[int, str]]:
    first = [(line, text.split()[0].rstrip(".,:;")) for line, text in docstrings(tree) if text.split()]
    return [(line, word) for line, word in first if word in FRAGMENTS]


def test_no_docstring_begins_with_a_fragment():
    found = {name: wrong for name, tree in sources() if (wrong := fragments(tree))}
    assert found == {}


def test_a_fragment_is_seen():
    source = '"""Where it is."""\n\nA = 1\n"""Of the pictures."""\n\ndef f():\n    """What it is."""\n'
    assert fragments(ast.parse(source)) == [(1, "Where"), (4, "Of"), (7, "What")]


def test_public_class_names_are_unique():
    homes = defaultdict(list)
    for name, tree in sources():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(name)
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}
