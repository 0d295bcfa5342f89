"""What numba does not see: every kernel's cache is discarded with all files whose code is compiled into it.

`backend.compilation.discard_stale` has to be told those files. Here they are read from the source.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.syntax import statements

ROOT = Path(__file__).parents[1]
COMPILED = "backend.compilation"


@dataclass
class Module:
    """Names of one file: what it defines, what it has from others, what it has compiled."""

    source: str
    defined: dict[str, ast.AST] = field(default_factory=dict)
    imported: dict[str, tuple[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        tree = ast.parse(self.source)
        for node in statements(tree):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, "an import relative to its file is not looked through here"
                for alias in node.names:
                    self.imported[alias.asname or alias.name] = (node.module or "", alias.name)
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                self.defined[node.name] = node
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = (n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name))
                self.defined.update((name.id, node) for name in names)


class Modules(Mapping[str, Module]):
    """Modules by dotted name; each is parsed when it is first asked for, as most have nothing compiled."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self.sources, self._parsed = dict(sources), {}

    def __getitem__(self, name: str) -> Module:
        if name not in self._parsed:
            self._parsed[name] = Module(self.sources[name])
        return self._parsed[name]

    def __contains__(self, name: object) -> bool:
        return name in self.sources

    def __iter__(self) -> Iterator[str]:
        return iter(self.sources)

    def __len__(self) -> int:
        return len(self.sources)


class Sources:
    """What each module compiles, and of what."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self.modules = Modules(sources)

    def compiles(self, module: str, expression: ast.expr) -> bool:
        """Whether it is ``njit`` or what was made of it, with options or without."""
        while isinstance(expression, ast.Call):
            expression = expression.func
        if not isinstance(expression, ast.Name):
            return isinstance(expression, ast.Attribute) and expression.attr in ("njit", "jit", "vectorize")
        known = self.modules[module]
        origin, name = known.imported.get(expression.id, (module, expression.id))
        if name == "njit":
            return True
        made = self.modules[origin].defined.get(name) if origin in self.modules else None
        return isinstance(made, ast.Assign) and self.compiles(origin, made.value)

    def kernels(self, module: str) -> list[str]:
        return [
            name
            for name, node in self.modules[module].defined.items()
            if isinstance(node, ast.FunctionDef)
            and any(self.compiles(module, d) for d in node.decorator_list)
        ]

    def users(self) -> list[str]:
        """Modules that have ``njit``, or what was made of it, and not only to make such of it."""
        return sorted(module for module in self._candidates() if module != COMPILED and self._uses(module))

    def _candidates(self) -> set[str]:
        """Modules that name numba's decorators, or import from one that makes decorators of them."""
        found: set[str] = set()
        sources = self.modules.sources
        todo = {module for module, source in sources.items() if re.search("jit|vectorize", source)}
        while todo:
            found |= todo
            making = [f"from {module} import" for module in todo if self._makes(module)]
            todo = {m for m in sources if m not in found and any(each in sources[m] for each in making)}
        return found

    def _makes(self, module: str) -> bool:
        return any(
            isinstance(node, ast.Assign) and self.compiles(module, node.value)
            for node in self.modules[module].defined.values()
        )

    def _uses(self, module: str) -> bool:
        has = any(self.compiles(module, ast.Name(name)) for name in self.modules[module].imported)
        return bool(self.kernels(module)) or (has and not self._makes(module))

    def inlined(self, module: str) -> set[str]:
        """The modules that the kernels of one take from: kernels, constants, types, how to compile."""
        seen: set[tuple[str, str]] = set()
        todo = [(module, name) for name in self.kernels(module)]
        while todo:
            here, name = todo.pop()
            if here == COMPILED or here not in self.modules or (here, name) in seen:
                continue
            seen.add((here, name))
            known = self.modules[here]
            if name in known.defined:
                todo.extend((here, used) for used in _used(known.defined[name]))
            elif name in known.imported:
                origin, original = known.imported[name]
                whole = f"{origin}.{original}"
                todo.extend(
                    ((whole, each) for each in self.modules[whole].defined)
                    if whole in self.modules
                    else [(origin, original)]
                )
        return {module} | {here for here, name in seen if name in self.modules[here].defined}


def _used(node: ast.AST) -> Iterator[str]:
    return (each.id for each in ast.walk(node) if isinstance(each, ast.Name))


def the_project() -> Sources:
    files = [path for layer in ("backend", "frontend", "slam") for path in (ROOT / layer).rglob("*.py")]
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in files}
    return Sources({name: path.read_text(encoding="utf-8") for name, path in names.items()})


RECORDED = """
import importlib, json, sys
found = {}
for name in sys.argv[1:]:
    for loaded in [each for each in sys.modules if each.split(".")[0] in ("backend", "frontend", "slam")]:
        del sys.modules[loaded]
    importlib.import_module(name)
    groups = importlib.import_module("backend.compilation").GROUPS
    found[name] = [sorted(map(str, group)) for group in groups]
print(json.dumps(found))
"""


JOINS = {"slam.criticism.kalman.readings": "slam.simulation.terms."}
"""Modules that compile plain functions of the modules of a package."""


def test_each_kernel_is_discarded_with_all_that_is_compiled_into_it():
    """Each file with kernels, imported alone, must tell a group with all files that it takes code from."""
    project = the_project()
    users = project.users()
    assert len(users) > 10
    done = subprocess.run(
        [sys.executable, "-c", RECORDED, *users], capture_output=True, text=True, cwd=ROOT, check=True
    )
    recorded = json.loads(done.stdout)
    missing = {}
    for user in users:
        assert project.kernels(user) or user in JOINS, f"{user} compiles, but nothing is seen of it here"
        taken = project.inlined(user) | {m for m in project.modules if m.startswith(JOINS.get(user, "-"))}
        wanted = {str(ROOT.joinpath(*name.split(".")).with_suffix(".py")) for name in taken}
        lacks = min((wanted - set(group) for group in recorded[user]), key=len, default=wanted)
        if lacks:
            missing[user] = sorted(lacks)
    assert missing == {}


A = (
    "from backend.compilation import njit\nfrom slam.b import B\n\n"
    "@njit(cache=True)\ndef f(x):\n    return {}\n"
)
B = "from backend.compilation import njit\nfrom slam.c import C\n\n@njit()\ndef B(x):\n    return x * C"
OWN_OPTIONS = "from backend.compilation import njit\nB = njit(cache=True, nogil=True)"


@pytest.mark.parametrize(
    ("a", "b", "wanted"),
    [
        (A.format("x"), "B = 1", "a"),
        (A.format("x * B"), "B = 1", "ab"),
        (A.format("x * D") + "D = B + 1", "B = 1", "ab"),
        (A.format("B(x)"), B, "abc"),
        (A.format("x * B"), "from slam.c import C\nB = 2 * C", "abc"),
        (A.format("x * B"), "from slam.c import C\nB, D = range(2)", "ab"),
        (A.replace("slam.b import B", "slam import b").format("x * b.B"), "B = 1", "ab"),
        (A.replace("njit(cache=True)", "B").format("x"), OWN_OPTIONS, "ab"),
    ],
)
def test_what_is_compiled_into_a_kernel_is_seen(a, b, wanted):
    planted = Sources({"slam.a": a, "slam.b": b, "slam.c": "C = 1"})
    assert "slam.a" in planted.users()
    assert planted.kernels("slam.a") == ["f"]
    assert planted.inlined("slam.a") == {f"slam.{module}" for module in wanted}


def test_a_decorator_that_is_made_of_one_that_is_made_is_seen():
    made = "from slam.b import B\nD = B(fastmath=True)"
    user = "from slam.c import D\n\n@D\ndef f(x):\n    return x"
    planted = Sources({"slam.a": user, "slam.b": OWN_OPTIONS, "slam.c": made, "slam.d": "x = 1"})
    assert planted.users() == ["slam.a"]


def test_a_file_that_only_says_how_to_compile_uses_nothing_yet():
    assert Sources({"slam.b": OWN_OPTIONS}).users() == []
    assert Sources({"slam.b": f"{OWN_OPTIONS}\n\n@B\ndef f(x):\n    return x"}).users() == ["slam.b"]
    assert Sources({"slam.b": "from numba import njit\nf = wrapped(njit)"}).users() == ["slam.b"]
