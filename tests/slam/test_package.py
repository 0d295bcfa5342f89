"""The package as users install it: light to import, complete in a wheel, usable in an empty folder."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import slam

ROOT = Path(__file__).parents[2]
GRAPH = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0 1.5708
VERTEX_SE2 2 1 1.2 3.1416
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 1000
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 1000
EDGE_SE2 0 2 1 1 3.1415926 100 0 0 100 0 1000
"""
CLI = "from slam.cli import main; main()"
DRIVER = """import sys
wheel, checkout, code = sys.argv[1:4]
del sys.argv[1:4]
sys.path[:] = [wheel] + [entry for entry in sys.path if entry not in ("", checkout)]
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in repr(finder)]
status = 0
try:
    exec(code)
except SystemExit as left:
    status = left.code
ours = [m for name, m in sys.modules.items() if name.split(".")[0] in ("slam", "frontend", "backend")]
assert ours, "nothing of ours was loaded"
strangers = [m for m in ours if not m.__file__.startswith(wheel)]
assert not strangers, strangers
sys.exit(status)
"""


def python(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def test_the_names_that_a_script_needs():
    from slam import Flight, criticise, evaluate, optimize, read_flight, simulate

    assert Flight.__module__ == "slam.core.flight"
    assert optimize.__module__ == "slam.mapping.pipeline"
    assert read_flight.__module__ == "slam.io.flight_folder"
    assert evaluate.__module__ == "slam.evaluation.score"
    assert simulate.__module__ == "slam.simulation"
    assert criticise.__module__ == "slam.criticism.run"


@pytest.mark.parametrize("package", ["slam", "backend", "frontend"])
def test_importing_a_package_imports_nothing_else(package):
    code = (
        f"import sys; before = set(sys.modules); import {package}; print(sorted(set(sys.modules) - before))"
    )
    done = python("-c", code, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    foreign = {name.split(".")[0] for name in ast.literal_eval(done.stdout)} - sys.stdlib_module_names
    assert foreign == {package}


def test_the_version_is_written_in_one_place():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in settings["project"]
    assert "version" in settings["project"]["dynamic"]
    text = (ROOT / settings["tool"]["hatch"]["version"]["path"]).read_text(encoding="utf-8")
    found = re.search(settings["tool"]["hatch"]["version"]["pattern"], text)
    assert found is not None
    assert found["version"] == slam.__version__ == "0.2.0"


def test_a_checkout_on_the_path_tells_its_version(tmp_path):
    done = python("-m", "slam", "--version", cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.stdout == f"slam {slam.__version__}\n"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, unpacked: what an installation would hold."""
    folder = tmp_path_factory.mktemp("wheel")
    build = "import sys, hatchling.build as b; print(b.build_wheel(sys.argv[1]))"
    done = python("-c", build, folder, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    (archive,) = folder.glob("*.whl")
    unpacked = folder / "unpacked"
    with zipfile.ZipFile(archive) as file:
        file.extractall(unpacked)
    return unpacked


def installed(wheel: Path, folder: Path, code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run in an empty folder with the wheel's modules; fails where one of the checkout's is loaded."""
    return python("-c", DRIVER, wheel, ROOT, code, *arguments, cwd=folder)


def test_the_wheel_holds_the_project_and_nothing_else(wheel: Path):
    top = {path.name for path in wheel.iterdir()}
    assert top == {"slam", "frontend", "backend", f"lemniscate_slam-{slam.__version__}.dist-info"}
    for package in ("slam", "frontend", "backend"):
        here = {p.relative_to(ROOT) for p in (ROOT / package).rglob("*.py")}
        there = {p.relative_to(wheel) for p in (wheel / package).rglob("*.py")}
        assert here == there
    assert {p.name for p in (wheel / "slam" / "datasets").glob("*.toml")} == {
        p.name for p in (ROOT / "datasets").glob("*.toml")
    }
    assert (wheel / "slam" / "report" / "page.html.j2").is_file()
    entry = next(wheel.glob("*.dist-info")) / "entry_points.txt"
    assert "slam = slam.__main__:main" in entry.read_text()


def test_the_wheel_is_typed_and_its_readme_has_no_relative_link(wheel: Path):
    assert all((wheel / package / "py.typed").is_file() for package in ("slam", "frontend", "backend"))
    readme = (next(wheel.glob("*.dist-info")) / "METADATA").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", readme)
    assert len(links) > 10
    assert [link for link in links if not link.startswith("https://")] == []


def test_the_citation_names_this_version():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", citation, re.MULTILINE)[1] == slam.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## \[(\d[^\]]*)\]", changelog, re.MULTILINE)[1] == slam.__version__


@pytest.mark.slow
def test_a_recipe_is_found_in_an_empty_folder(wheel: Path, tmp_path: Path):
    code = (
        "from slam.simulation.recipe import load_recipe, shipped_recipes\n"
        "print(shipped_recipes(), load_recipe('figure_eight').name)"
    )
    done = installed(wheel, tmp_path, code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "figure_eight"
    assert {"'figure_eight',", "'gym',"} <= set(done.stdout.replace("(", "").split())
    wrong = installed(wheel, tmp_path, CLI, "simulate", "figure_nine", "--out", "flight")
    assert wrong.returncode == 1
    assert "did you mean 'figure_eight'" in wrong.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_graph_is_solved_in_an_empty_folder(wheel: Path, tmp_path: Path):
    """Report, pictures and all: templates and data travel with the package."""
    (tmp_path / "tiny.g2o").write_text(GRAPH)
    done = installed(wheel, tmp_path, CLI, "optimize", "tiny.g2o", "--out", "out")
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert record["status"] == "ok"
    assert record["keyframes"] == 3
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000


@pytest.mark.slow
def test_a_recipe_is_flown_in_an_empty_folder(wheel: Path, tmp_path: Path):
    done = installed(wheel, tmp_path, CLI, "simulate", "square", "--out", "flight", "--seed", "3")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "flight" / "mav0" / "cam0" / "data.csv").is_file()
