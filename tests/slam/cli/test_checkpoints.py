"""What a run left is void where a library that its results depend on has changed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from slam.cli.checkpoints import LIBRARIES, program_digest

PROJECT = Path(__file__).resolve().parents[3] / "pyproject.toml"
OF_NO_RESULT = {
    "typer", "rich", "pydantic", "matplotlib", "defusedxml", "pyyaml", "jinja2", "threadpoolctl",
}  # fmt: skip
"""They read settings and tags, which the digests hold, or draw what is never kept."""


def test_each_library_that_makes_results_counts():
    wanted = tomllib.loads(PROJECT.read_text())["project"]["dependencies"]
    names = {re.split(r"[^\w-]", line)[0] for line in wanted}
    assert names - OF_NO_RESULT <= {*LIBRARIES}


def test_another_version_of_a_decoder_of_pictures_is_another_program(monkeypatch):
    before = program_digest()
    assert program_digest() == before
    found = {"rasterio": "99.0"}
    monkeypatch.setattr("slam.cli.checkpoints.version", lambda name: found.get(name, "1.0"))
    with_rasterio = program_digest()
    found.clear()
    assert program_digest() != with_rasterio
