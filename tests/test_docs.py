"""Documentation pages: sentences are short, named files exist, and the examples of docs/library.md run."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
PROSE = [name for name in PAGES if not name.startswith(("docs/api/", "docs/measured/"))]
GENERATED = ("docs/figures.md", "docs/blind.md")
"""Written by a command from measured figures."""
MOST_WORDS = 20


def sentences(text: str) -> list[str]:
    """Sentences of a page's prose, without code blocks, tables, headings and pictures."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(("|", "#", "!", "<", ":::"))]
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.)\s)", "\n".join(lines))
    flat = [re.sub(r"^([-*]|\d+\.)\s+", "", " ".join(block.split())) for block in blocks]
    return [s for block in flat for s in re.split(r"(?<=[.!?:])\s+(?=[A-Z0-9`*\[(])", block) if s]


def mean_words(text: str) -> float:
    counts = [len(sentence.split()) for sentence in sentences(text)]
    return sum(counts) / max(len(counts), 1)


def test_long_sentences_are_seen():
    assert sentences("# Title\n\nOne two. Three `four`.\n\n- Five six\n- Seven\n\n| a | b |\n") == [
        "One two.",
        "Three `four`.",
        "Five six",
        "Seven",
    ]
    assert mean_words("word " * 30 + ".") > MOST_WORDS


@pytest.mark.parametrize(
    "name",
    [
        *(n for n in PROSE if n not in GENERATED),
        "README.md",
        "CONTRIBUTING.md",
    ],
)
def test_sentences_are_short_on_average(name):
    assert mean_words((ROOT / name).read_text(encoding="utf-8")) <= MOST_WORDS


@pytest.mark.parametrize("name", [*PROSE, "README.md", "CONTRIBUTING.md"])
def test_files_named_by_a_page_exist(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    named = re.findall(r"`((?:slam|frontend|backend|tests|datasets|docs)/[\w./-]*)", text)
    assert [path for path in named if not (ROOT / path).exists()] == []


SOURCES = [p.relative_to(ROOT).as_posix() for p in ROOT.glob("[a-z]*/**/*.py")]


@pytest.mark.parametrize("name", [*PROSE, "README.md", "CONTRIBUTING.md"])
def test_source_files_named_without_their_folder_exist(name):
    named = set(re.findall(r"`([\w/]+\.py)`", (ROOT / name).read_text(encoding="utf-8")))
    assert [file for file in sorted(named) if not any(s.endswith(file) for s in SOURCES)] == []


@pytest.mark.parametrize("name", [*PROSE, "README.md", "CONTRIBUTING.md"])
def test_names_that_a_page_finds_in_a_file_are_there(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    for places in re.findall(r"((?:`[\w.]+`(?:, | and | or ))*`[\w.]+`) (?:of|in) `([\w/]+\.py)`", text):
        names, file = re.findall(r"`([\w.]+)`", places[0]), ROOT / places[1]
        sources = [file] if file.exists() else [s for s in ROOT.glob("[a-z]*/**/*.py") if s.match(places[1])]
        words = {word for s in sources for word in re.findall(r"\w+", s.read_text(encoding="utf-8"))}
        assert [n for n in names if n.split(".")[-1] not in words | {s.stem for s in sources}] == [], places


@pytest.mark.parametrize("name", PROSE)
def test_modules_named_by_a_page_exist(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    for module in re.findall(r"python -m ((?:slam|tests)(?:\.\w+)+)", text):
        assert (ROOT / module.replace(".", "/")).with_suffix(".py").exists(), module


@pytest.mark.parametrize(
    ("number", "prints"),
    [
        # The README's example, which a test of its own runs, is the same job.
        pytest.param(0, "rmse=", marks=pytest.mark.slow),
        (1, r"\A12 \(\d+, 4, 4\)"),
        (2, r"\A(ok, error 0|.*e-)"),
        (3, r"\[3\."),
        (4, r"\Aregistered with \d+ inliers[^$]*\(8, 8\)"),
    ],
)
def test_the_library_examples_run(number, prints, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(examples) == 5
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(examples[number], "docs/library.md", "exec"), {})
    assert re.search(prints, out.getvalue())


def test_each_package_named_alone_loads_no_other():
    """`frontend` and `backend` serve alone: neither loads the application."""
    for package, others in (("frontend", ("slam", "gtsam")), ("backend", ("slam", "cv2", "frontend"))):
        code = f"import {package}, sys\n[getattr({package}, n) for n in dir({package})]\n"
        code += f"loaded = [n for n in {others!r} if n in sys.modules]\nassert not loaded, loaded"
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr.decode()
