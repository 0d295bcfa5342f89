"""The layers of the code, checked on the imports in the source and on those at run time."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import networkx as nx
import pytest

from tests.syntax import statements

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "backend": ("backend", "numpy", "gtsam", "gtsam_unstable", "scipy", "networkx", "numba"),
    "frontend": ("frontend", "numpy", "cv2", "scipy", "networkx", "backend.measurements"),
}
HEAVY = (
    "gtsam", "gtsam_unstable", "cv2", "scipy.optimize", "scipy.stats", "matplotlib", "rasterio", "numba",
    "dask", "distributed",
)  # fmt: skip
OF_MAPS = ("gtsam", "gtsam_unstable", "cv2", "numba")
"""Heavy modules that every map needs."""


def imported(source: str, package: str) -> list[tuple[int, str]]:
    """Return line and dotted name of every module that a source file of ``package`` imports.

    ``from a import b`` counts as ``a.b``: b may be a module. ``import_module`` and ``__import__`` count too,
    as ``<lazy>`` where they import a module of the table ``_MODULES``.
    """
    parts = package.split(".")
    return [
        (line, ".".join([*(parts[: len(parts) - level + 1] if level else []), name]))
        for line, level, name in imports_in(source)
    ]


@cache  # several tests look at the imports of every source file
def imports_in(source: str) -> tuple[tuple[int, int, str], ...]:
    """Return line, number of leading dots, and name of every import in a source."""
    tree = ast.parse(source)
    calls = "import_module" in source or "__import__" in source
    return tuple(each for node in (ast.walk if calls else statements)(tree) for each in imports_of(node))


def imports_of(node: ast.AST) -> Iterator[tuple[int, int, str]]:
    if isinstance(node, ast.Import):
        yield from ((node.lineno, 0, alias.name) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = [node.module] if node.module else []
        yield from ((node.lineno, node.level, ".".join([*base, alias.name])) for alias in node.names)
    elif isinstance(node, ast.Call) and last_name(node.func) in ("import_module", "__import__"):
        name = node.args[0] if node.args else None
        known = isinstance(name, ast.Constant) and isinstance(name.value, str)
        lazy = node.args and ast.unparse(node.args[0]) == "_MODULES[name]"
        yield node.lineno, 0, name.value if known else "<lazy>" if lazy else "<computed>"


def last_name(function: ast.expr) -> str:
    """``b`` of ``a.b`` and of ``b``."""
    return getattr(function, "attr", getattr(function, "id", ""))


def is_of(name: str, allowed: str) -> bool:
    """Return whether an imported name belongs to an allowed package; of a part of ours, to its own names."""
    inside = name.removeprefix(allowed + ".")
    return name == allowed or (inside != name and ("." not in allowed or "." not in inside))


def violations(layer: str, source: str, package: str) -> list[tuple[int, str]]:
    """Return the imports of a file that are neither standard library nor allowed to its layer."""
    return [
        (line, name)
        for line, name in imported(source, package)
        if name.split(".")[0] not in sys.stdlib_module_names
        and not (name == "<lazy>" and package == layer)
        and not any(is_of(name, allowed) for allowed in ALLOWED[layer])
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
        ("backend", "def f():\n    import slam.core.flight as flight"),
        ("backend", "from ..slam import flight"),
        ("backend", "from importlib import import_module\nimport_module('cv2')"),
        ("backend", "import importlib\nname = 'cv' + '2'\nimportlib.import_module(name)"),
        ("backend", "__import__('pydantic')"),
        ("backend", "import numpy, rasterio"),
        ("backend", "import numpyro"),
        ("frontend", "import gtsam"),
        ("frontend", "from backend import graph"),
        ("frontend", "import backend"),
        ("frontend", "from backend.pose_graph.minimise import minimise"),
        ("frontend", "from backend.measurements_of_others import x"),
        ("frontend", "from backend.se3 import cross_matrix"),
        ("frontend", "from backend.measurements.straight_flight import straight_velocities"),
        ("frontend", "if True:\n    from slam.core.estimate import Estimate"),
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
def test_the_walker_passes_allowed_imports(layer, allowed):
    assert violations(layer, allowed, layer) == []


def test_only_a_layer_s_own_package_may_import_lazily():
    lazy = "from importlib import import_module\nimport_module(_MODULES[name])"
    assert violations("backend", lazy, "backend") == []
    assert violations("backend", lazy, "backend.pose_graph") == [(2, "<lazy>")]


def lazy_names(package: str) -> dict[str, str]:
    """Public name -> module, as ``_MODULES`` of the package's ``__init__`` lists them."""
    source = (ROOT / package / "__init__.py").read_text(encoding="utf-8")
    (table,) = (
        node.value
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_MODULES"
    )
    return ast.literal_eval(table)


@pytest.mark.parametrize("package", ["backend", "frontend", "slam"])
def test_a_package_offers_names_of_its_own_modules_alone(package):
    names = lazy_names(package)
    assert names
    assert all(module.startswith(package + ".") for module in names.values())


@pytest.mark.parametrize("package", ["backend", "frontend", "slam"])
def test_each_public_name_exists_and_dir_lists_it(package):
    module = import_module(package)
    assert set(lazy_names(package)) == set(module.__all__) - {"__version__"}
    assert dir(module) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    submodules = {path.stem for path in (ROOT / package).iterdir() if path.suffix in ("", ".py")}
    assert not submodules & set(module.__all__), "a submodule would hide the name"
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'optimise'"):
        _ = module.optimise


@pytest.mark.parametrize("package", ["backend", "frontend", "slam"])
def test_type_checkers_see_the_names_that_are_imported_lazily(package):
    source = (ROOT / package / "__init__.py").read_text(encoding="utf-8")
    seen = {name for _, name in imported(source, package) if name.startswith(package + ".")}
    assert {f"{module}.{name}" for name, module in lazy_names(package).items()} <= seen


def test_datasets_holds_no_code():
    """An import package of that name would shadow a public one."""
    assert list((ROOT / "datasets").rglob("*.py")) == []


PACKAGES = {
    "slam": (
        ("core",),
        ("io", "parallel"),
        ("simulation",),
        ("data_quality",),
        ("inertial",),
        ("mapping", "criticism"),
        ("evaluation",),
        ("experiments", "report"),
        ("cli",),
    ),
    "backend": (
        (
            "arguments",
            "errors",
            "measurements",
            "quantiles",
            "quaternions",
            "se3",
            "significance",
            "triple",
            "compilation",
            "wording",
            "whitening",
        ),
        ("gauge", "preintegration", "robust", "sparse_cholesky", "sparse_product"),
        ("pose_graph", "ekf", "inertial_scale"),
        ("bundle", "g2o", "clocks"),
    ),
}
"""Parts of a package from the bottom up. A part imports only parts of the rows above it in this table."""


def upward_imports(package: str, sources: Iterable[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return imports (part, part) of ``package`` that do not point downwards, from (part, source).

    An import for a type annotation counts too, because a reader has to follow it.
    """
    height = {part: level for level, parts in enumerate(PACKAGES[package]) for part in parts}
    pairs = {
        (part, name.split(".")[1])
        for part, source in sources
        for _, name in imported(source, package)
        if name.startswith(package + ".")
    }
    return {(a, b) for a, b in pairs if a != b and height[b] >= height[a]}


def parts_of(package: str) -> list[tuple[str, str]]:
    """Return (part, source) of every file in ``package`` except its own ``__init__`` and ``__main__``."""
    files = [path for path in sorted((ROOT / package).rglob("*.py")) if not path.stem.startswith("__m")]
    return [
        (path.relative_to(ROOT / package).with_suffix("").parts[0], path.read_text(encoding="utf-8"))
        for path in files
        if path.parent != ROOT / package or path.stem != "__init__"
    ]


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_parts_import_only_parts_below_them(package):
    sources = parts_of(package)
    assert {part for part, _ in sources} == {part for parts in PACKAGES[package] for part in parts}
    assert upward_imports(package, sources) == set()


def test_a_planted_upward_import_is_seen():
    assert upward_imports("slam", [("io", "from slam.core.flight import Flight")]) == set()
    reader = ("core", "def read():\n    from slam.io.flight_folder import read_flight")
    assert upward_imports("slam", [reader]) == {("core", "io")}
    sideways = ("mapping", "from slam.criticism import criticise")
    assert upward_imports("slam", [sideways]) == {("mapping", "criticism")}


def import_circles(sources: Iterable[tuple[str, str]]) -> list[set[str]]:
    """Return groups of modules that import each other in a circle, from (module, source)."""
    texts = dict(sources)
    graph = nx.DiGraph()
    for module, source in texts.items():
        for _, name in imported(source, module):
            # ``a.b.c`` is the module a.b.c, or the name c in the module a.b.
            target = name if name in texts else name.rpartition(".")[0]
            if target in texts and target != module:
                graph.add_edge(module, target)
    return [found for found in nx.strongly_connected_components(graph) if len(found) > 1]


def test_no_modules_import_each_other_in_a_circle():
    files = [path for package in ("slam", "frontend", "backend") for path in (ROOT / package).rglob("*.py")]
    # Packages import their public names lazily, which makes no circle.
    modules = [path for path in files if path.stem != "__init__"]
    assert len(modules) > 300
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in modules]
    texts = [path.read_text(encoding="utf-8") for path in modules]
    assert import_circles(zip(names, texts, strict=True)) == []


def test_a_planted_circle_is_seen():
    reader = ("slam.io.csv", "from slam.core.flight import Flight")
    assert import_circles([reader, ("slam.core.flight", "import math")]) == []
    assert import_circles([reader, ("slam.core.flight", "def read():\n    from slam.io import csv")]) == [
        {"slam.io.csv", "slam.core.flight"}
    ]


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


@pytest.mark.parametrize(
    ("program", "needed"),
    [
        ("import slam", ()),
        ("import backend", ()),
        ("import frontend", ()),
        ("import slam.cli", ()),
        (HELP, ()),
        ("from slam import optimize", ()),
        ("import slam.mapping.main_loop", OF_MAPS),
        ("import slam.simulation.recording", ("cv2", "numba", "scipy.optimize")),  # scipy.interpolate's
    ],
)
def test_importing_the_packages_loads_nothing_heavy(program, needed):
    """``slam --help`` answers at once only while nothing heavy is imported for it."""
    heavy = [name for name in HEAVY if name not in needed]
    check = f"loaded = [name for name in {heavy!r} if name in sys.modules]\nassert not loaded, loaded"
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\nimport sys\n{check}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
