"""The size of criticism: a reader must be able to know it. The limits follow the code down, never up."""

from __future__ import annotations

import ast
from pathlib import Path

from slam import criticism
from tests.syntax import statements

ROOT = Path(criticism.__file__).parent
SOURCES = {path: path.read_text(encoding="utf-8") for path in sorted(ROOT.rglob("*.py"))}
MOST_LINES, MOST_FILES = 8_961, 49
LONGEST_FILE, LONGEST_FUNCTION = 325, 60
MOST_IMPORTS_OF_THE_MAIN_LOOP = 15
"""Modules of ours that ``run.py`` imports."""


def test_criticism_has_no_more_lines_and_files_than_before():
    lines = {path: len(text.splitlines()) for path, text in SOURCES.items()}
    assert sum(lines.values()) <= MOST_LINES
    assert len(lines) <= MOST_FILES
    assert max(lines.values()) <= LONGEST_FILE


def test_every_function_of_criticism_fits_on_a_screen():
    long = {
        f"{path.name}: {node.name}"
        for path, text in SOURCES.items()
        for node in statements(ast.parse(text))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno >= LONGEST_FUNCTION
    }
    assert long == set()


def test_the_main_loop_of_criticism_needs_few_modules():
    modules = {
        node.module
        for node in statements(ast.parse(SOURCES[ROOT / "run.py"]))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("slam.")
    }
    assert 0 < len(modules) <= MOST_IMPORTS_OF_THE_MAIN_LOOP
