"""Docstrings are sentences, and no public class name has two meanings."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.syntax import statements

ROOT = Path(__file__).parents[1]
FRAGMENTS = {"Of", "By", "Times", "What", "Who", "Where", "Beyond", "Beside"}
"""A docstring that begins with one of these words is no sentence."""


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings of modules, classes, functions, fields and constants."""
    for node in (tree, *statements(tree)):
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


def public_classes(tree: ast.Module) -> list[str]:
    return [n.name for n in tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]


def texts_alone(tree: ast.Module) -> list[int]:
    """Lines of the formatted texts that are used for nothing."""
    return [
        each.lineno
        for each in statements(tree)
        if isinstance(each, ast.Expr) and isinstance(each.value, ast.JoinedStr)
    ]


@cache
def findings() -> dict[str, tuple[list[tuple[int, str]], list[str], list[int]]]:
    """Name of every source file -> its fragments, public classes and texts alone; each is parsed once."""
    found = {}
    for package in ("slam", "frontend", "backend"):
        for path in sorted((ROOT / package).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found[path.relative_to(ROOT).as_posix()] = (
                fragments(tree),
                public_classes(tree),
                texts_alone(tree),
            )
    return found


def test_no_docstring_begins_with_a_fragment():
    assert {name: wrong for name, (wrong, *_) in findings().items() if wrong} == {}


def test_a_fragment_is_seen():
    source = '"""Where it is."""\n\nA = 1\n"""Of the pictures."""\n\ndef f():\n    """What it is."""\n'
    assert fragments(ast.parse(source)) == [(1, "Where"), (4, "Of"), (7, "What")]


def test_no_text_stands_alone():
    """A line of a text that lacks its brackets is a statement of its own, and the text ends before it."""
    assert {name: lines for name, (_, _, lines) in findings().items() if lines} == {}


def test_a_text_alone_is_seen():
    assert texts_alone(ast.parse('a = "what "\nf"{a}"\nprint(f"{a}")\n')) == [2]


def test_public_class_names_are_unique():
    homes = defaultdict(list)
    for name, (_, classes, _) in findings().items():
        for public in classes:
            homes[public].append(name)
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}
