"""An output folder with two files, for the tests of output folders."""

from __future__ import annotations

from pathlib import Path

from slam.cli.output_folder import MARKER_NAME, output_folder


def write_output(target: Path, text: str) -> None:
    with output_folder(target) as folder:
        (folder / "summary.json").write_text(text)
        (folder / "loops.csv").write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != MARKER_NAME}
