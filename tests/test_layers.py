"""The layers of the house, checked on the imports that the source holds and on those that really happen."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import networkx as nx
import pytest

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "backend": ("backend", "numpy", "gtsam", "scipy", "networkx", "numba"),
    "frontend": ("frontend", "numpy", "cv2", "scipy", "networkx", "backend.measurements"),
}
HEAVY = ("gtsam", "cv2", "scipy.optimize", "matplotlib", "rasterio", "numba")


def imported(source: str, package: str) -> Iterator[tuple[int, str]]:
    """Line and full dotted name of every module that a source file of ``package`` imports anywhere.

    ``from a import b`` counts as ``a.b``: b may be a module. ``import_module`` and ``__import__`` count too.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            home = parts[: len(parts) - node.level + 1] if node.level else []
            base = ".".join([*home, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in (
            "import_module",
            "__import__",
        ):
            name = node.args[0] if node.args else None
            known = isinstance(name, ast.Constant) and isinstance(name.value, str)
            yield node.lineno, name.value if known else "<computed>"


def violations(layer: str, source: str, package: str) -> list[tuple[int, str]]:
    """What a file imports beyond the standard library and what its layer may."""
    return [
        (line, name)
        for line, name in imported(source, package)
        if name.split(".")[0] not in sys.stdlib_module_names
        and not any(name == allowed or name.startswith(allowed + ".") for allowed in ALLOWED[layer])
    ]


def package_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).parent.parts)


@pytest.mark.parametrize("layer", sorted(ALLOWED))
def test_a_layer_imports_only_what_it_may(layer):
    files = sorted((ROOT / layer).rglob("*.py"))
    assert files
    found = {
        str(path.relative_to(ROOT)): wrong
        for path in files
        if (wrong := violations(layer, path.read_text(encoding="utf-8"), package_of(path)))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("layer", "planted"),
    [
        ("backend", "import cv2"),
        ("backend", "import slam"),
        ("backend", "from frontend.camera import Camera"),
        ("backend", "from frontend import camera"),
        ("backend", "def f():\n    import slam.flight as flight"),
        ("backend", "from ..slam import flight"),
        ("backend", "from importlib import import_module\nimport_module('cv2')"),
        ("backend", "import importlib\nname = 'cv' + '2'\nimportlib.import_module(name)"),
        ("backend", "__import__('pydantic')"),
        ("backend", "import numpy, rasterio"),
        ("backend", "import numpyro"),
        ("frontend", "import gtsam"),
        ("frontend", "from backend import graph"),
        ("frontend", "import backend"),
        ("frontend", "from backend.solve import minimise"),
        ("frontend", "from backend.measurements_of_others import x"),
        ("frontend", "from backend.se3 import cross_matrix"),
        ("frontend", "if True:\n    from slam.estimate import Estimate"),
    ],
)
def test_the_walker_sees_a_planted_violation(layer, planted):
    assert violations(layer, planted, f"{layer}")


@pytest.mark.parametrize(
    ("layer", "allowed"),
    [
        ("backend", "import numpy as np\nimport gtsam\nfrom scipy.spatial.transform import Rotation"),
        ("backend", "from backend.measurements import RelativePose\nfrom . import measurements\nimport math"),
        (
            "frontend",
            "import cv2\nfrom backend.measurements import RelativePose\nfrom frontend.camera import Camera",
        ),
        ("frontend", "from backend import measurements\nimport networkx"),
    ],
)
def test_the_walker_lets_pass_what_is_allowed(layer, allowed):
    assert violations(layer, allowed, layer) == []


def test_the_backend_package_imports_nothing():
    source = (ROOT / "backend" / "__init__.py").read_text(encoding="utf-8")
    assert [type(node).__name__ for node in ast.parse(source).body] == ["Expr"]


def test_datasets_holds_no_code():
    """An import package of that name would shadow a public one."""
    assert list((ROOT / "datasets").rglob("*.py")) == []


def circles(sources: Iterable[tuple[str, str]]) -> list[set[str]]:
    """Files and folders directly in ``slam/`` that import each other all the way round; of (which, source).

    What only types need counts too: a reader has to know it all the same.
    """
    wants = nx.DiGraph(
        (room, ".".join(name.split(".")[:2]))
        for room, source in sources
        for _, name in imported(source, "slam")
        if name.startswith("slam.")
    )
    wants.remove_edges_from([(room, room) for room in wants])
    return [found for found in nx.strongly_connected_components(wants) if len(found) > 1]


def test_no_two_parts_of_the_application_import_each_other():
    files = sorted((ROOT / "slam").glob("*/**/*.py")) + sorted((ROOT / "slam").glob("[!_]*.py"))
    assert len(files) > 100
    rooms = [".".join(path.relative_to(ROOT).with_suffix("").parts[:2]) for path in files]
    texts = [path.read_text(encoding="utf-8") for path in files]
    assert circles(zip(rooms, texts, strict=True)) == []


def test_a_planted_circle_is_seen():
    reader = ("slam.io", "from slam.flight import Flight")
    assert circles([reader]) == []
    data = ("slam.flight", "def read():\n    from slam.io.flight_folder import read_flight")
    assert circles([reader, data]) == [{"slam.io", "slam.flight"}]


def test_gtsam_stays_in_the_back_end():
    """Only the back end knows gtsam's types: the application and the front end speak numpy."""
    found = [
        str(path.relative_to(ROOT))
        for path in (ROOT / "slam").rglob("*.py")
        for _, name in imported(path.read_text(encoding="utf-8"), package_of(path))
        if name.split(".")[0] == "gtsam"
    ]
    assert found == []


HELP = """import sys
from slam.cli import app
try:
    app(["--help"])
except SystemExit as left:
    assert not left.code
"""


@pytest.mark.parametrize("program", ["import slam", "import slam.cli", HELP])
def test_light_entries_stay_light(program):
    """``slam --help`` answers at once only while nothing heavy is imported for it."""
    check = f"loaded = [name for name in {HEAVY!r} if name in sys.modules]\nassert not loaded, loaded"
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\nimport sys\n{check}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
