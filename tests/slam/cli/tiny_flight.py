"""A flight of five seconds, from one mark to another and back."""

from __future__ import annotations

from pathlib import Path

from tests.slam.cli.commands import run

RECIPE = """name = "tiny"
landmark_pairs = [["A", "B"]]
[landmarks]
A = [0.3, 0.3]
B = [1.1, 0.3]
[maneuver]
way_points = ["A", "B", "A"]
height_m = 0.8
cruise_m_s = 0.4
[world]
texture = "{texture}"
extent_m = [0.0, 0.0, 1.6, 1.6]
[camera]
size_px = [176, 144]
rate_hz = 8.0
"""


def simulated(folder: Path, texture: str = "puzzle", seed: int = 3) -> Path:
    recipe = folder / "tiny.toml"
    recipe.write_text(RECIPE.format(texture=texture))
    result = run("simulate", recipe, "--out", folder / "flight", "--seed", seed)
    assert result.exit_code == 0, result.output
    return folder / "flight"


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
