"""The notebooks of the documentation run from their first cell to the last, and hold no outputs."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.test_docs import MOST_WORDS, mean_words

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
MOST_BYTES = 20_000


def cells(name: str, kind: str) -> list[str]:
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    return [cell.source for cell in notebook.cells if cell.cell_type == kind]


def run(name: str) -> tuple[dict[str, Any], list[list[bytes]]]:
    """Run all cells in one namespace, and return it with the pictures (PNG) that each cell draws.

    The value of a last expression is shown as Jupyter does, as HTML or text.
    """
    from io import BytesIO

    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    space: dict[str, Any] = {"__name__": "__main__"}
    pictures = []
    for number, source in enumerate(cells(name, "code")):
        tree = ast.parse(source, f"{name}.ipynb, cell {number}")
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, f"{name}.ipynb, cell {number}", "exec"), space)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"{name}.ipynb, cell {number}", "eval"), space)
            shown = value._repr_html_() if hasattr(value, "_repr_html_") else repr(value)
            assert shown
        drawn = []
        for figure in map(pyplot.figure, pyplot.get_fignums()):
            figure.savefig(content := BytesIO(), format="png", dpi=80)
            drawn.append(content.getvalue())
        pyplot.close("all")
        pictures.append(drawn)
    return space, pictures


def test_there_are_two_and_the_navigation_leads_to_them():
    assert NAMES == ["criticism", "map"]
    page = (FOLDER.parent / "notebooks.md").read_text(encoding="utf-8")
    assert all(f"(notebooks/{name}.ipynb)" in page for name in NAMES)
    assert "- notebooks.md" in (FOLDER.parents[1] / "mkdocs.yml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_valid_small_and_without_outputs(name):
    path = FOLDER / f"{name}.ipynb"
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < MOST_BYTES
    assert all(not cell.outputs for cell in notebook.cells if cell.cell_type == "code")
    assert mean_words("\n\n".join(cells(name, "markdown"))) <= MOST_WORDS


@pytest.mark.slow  # each maps or judges a whole flight
def test_the_map_is_as_the_notebook_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    space, pictures = run("map")
    assert sum(map(len, pictures)) == 4
    worst = max(space["evaluation"].landmarks, key=lambda row: row.error_m.loops)
    assert worst.error_m.loops < 0.2 * max(row.error_m.chain for row in space["evaluation"].landmarks)
    assert (space["error_m"] < 2 * space["std_m"]).mean() > 0.9
    assert 0 < float(space["there"]) < 0.05


@pytest.mark.slow
def test_the_secret_is_found_as_the_notebook_says():
    space, pictures = run("criticism")
    assert sum(map(len, pictures)) == 4
    (cause,) = space["verdict"].causes
    assert cause.name == "quadratic_drag"
    assert cause.parameters["c"].low < 0.4 < cause.parameters["c"].high
    before, after = (space[name]["truth.x"].rms[10.0] for name in ("before", "after"))
    assert after < 0.5 * before
