"""State of the repository that was measured."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
WRITTEN = ("docs/figures.json", "docs/figures.md", "docs/blind.md", "docs/measured/", "README.md")
"""Files and a folder that the benchmarks write themselves."""


def commit() -> str:
    """Return the commit, with a + where the work tree differs from it in more than figures."""
    commit_id, changed = _git("rev-parse", "--short=7", "HEAD"), _git("diff", "--name-only", "HEAD")
    differs = any(not name.startswith(WRITTEN) for name in changed.splitlines())
    return f"{commit_id or 'unknown'}{'+' if differs else ''}"


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
