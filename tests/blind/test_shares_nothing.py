"""The generator of blind flights shares no code with what is fitted to them."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ALLOWED = ("numpy", "scipy", "cv2")
HOUSE = ("slam", "frontend", "backend")
GENERATOR = ("tests.blind.cases", "tests.blind.score")


def named(source: str) -> Iterator[str]:
    """Every module that a source may import, however it says so."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Name | ast.Attribute):
            last = node.id if isinstance(node, ast.Name) else node.attr
            if last in ("__import__", "import_module", "exec", "eval", "spec_from_file_location", "run_path"):
                yield f"<{last}>"


def foreign(source: str) -> tuple[list[str], list[str]]:
    """Modules that are not allowed, and those of the tests, to be walked on."""
    wrong, ours = [], []
    for name in named(source):
        top = name.split(".")[0]
        if name.startswith("tests."):
            ours.append(name)
        elif top not in sys.stdlib_module_names and top not in ALLOWED:
            wrong.append(name)
    return wrong, ours


def file_of(name: str) -> Path | None:
    """A module's file, or that of the module that a name stands in."""
    whole = ROOT.joinpath(*name.split("."))
    return next((f for f in (whole.with_suffix(".py"), whole.parent.with_suffix(".py")) if f.is_file()), None)


def walked(start: str) -> dict[str, list[str]]:
    """File -> what it imports beyond what is allowed, over all files reached from ``start``."""
    found: dict[str, list[str]] = {}
    todo = [start]
    while todo:
        file = file_of(todo.pop())
        if file is None or str(file) in found:
            continue
        found[str(file)], ours = foreign(file.read_text(encoding="utf-8"))
        todo += ours
    return found


@pytest.mark.parametrize("start", GENERATOR)
def test_no_import_reaches_the_fitted_model(start):
    found = walked(start)
    assert len(found) >= 6
    assert {file: wrong for file, wrong in found.items() if wrong} == {}


@pytest.mark.parametrize(
    "planted",
    [
        "import slam",
        "from slam.simulation import dynamics",
        "def f():\n    from backend.ekf.track import x",
        "from . import vehicle",
        "__import__('slam')",
        "from importlib import import_module\nimport_module('frontend')",
        "exec('import slam')",
    ],
)
def test_the_walk_sees_a_planted_import(planted):
    assert foreign(planted)[0]


def test_nothing_of_the_house_is_loaded():
    program = (
        f"import sys, {', '.join(GENERATOR)}\nprint([m for m in sys.modules if m.split('.')[0] in {HOUSE!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_the_equations_are_not_the_simulators_own_text():
    """No line of the vehicle of any length stands in the simulator or the critic."""

    def lines(folder: Path) -> set[str]:
        texts = (
            f.read_text(encoding="utf-8") for f in folder.rglob("*.py") if not f.name.startswith("test_")
        )
        rows = {row.strip() for text in texts for row in text.splitlines()}
        return {row for row in rows if len(row) > 40 and not row.startswith(("import ", "from ", '"""', "#"))}

    assert lines(ROOT / "tests" / "blind") & lines(ROOT / "slam") == set()
