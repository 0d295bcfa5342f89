"""Which state of the repository was measured."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
WRITTEN = ("docs/figures.json", "docs/figures.md", "docs/blind.md", "docs/measured/", "README.md")
"""What measuring itself writes: files and a folder."""


def commit() -> str:
    """The commit that was measured, with a + where the work tree differs from it in more than figures."""
    told, changed = _git("rev-parse", "--short=7", "HEAD"), _git("diff", "--name-only", "HEAD")
    differs = any(not name.startswith(WRITTEN) for name in changed.splitlines())
    return f"{told or 'unknown'}{'+' if differs else ''}"


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
