"""Pose graphs of laps round a circle, as g2o files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

ODOMETRY = np.array([0.05, 0.05, 0.02])
"""Standard deviations of an edge: m, m, rad."""


def laps(path: Path, count: int = 120, per_lap: int = 40, every: int = 2, false: int = 0) -> np.ndarray:
    """Write a planar graph with a loop from each ``every``-th pose to the lap before, ``false`` of them to a
    wrong place; return (n, 3) true poses x, y, yaw.
    """
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * np.arange(count) / per_lap
    truth = np.column_stack([5 * np.sin(angle), 5 - 5 * np.cos(angle), angle])
    edges = [(k, k + 1, _between(truth[k], truth[k + 1])) for k in range(count - 1)]
    pairs = [(k - per_lap, k) for k in range(per_lap, count, every)]
    wrong = set(np.random.default_rng(1).choice(len(pairs), false, replace=False).tolist())
    for n, (i, j) in enumerate(pairs):
        seen = (i + per_lap // 3) % count if n in wrong else i
        edges.append((i, j, _between(truth[seen], truth[j])))
    lines = []
    for i, j, step in edges:
        measured = step + rng.normal(0, ODOMETRY)
        information = " ".join(f"{x:.9g}" for x in _upper(np.diag(ODOMETRY**-2)))
        lines.append(f"EDGE_SE2 {i} {j} {' '.join(f'{x:.9g}' for x in measured)} {information}")
    path.write_text("\n".join(lines) + "\n")
    return truth


def edited(change: Callable[[list[str]], list[str]]) -> Callable[[Path], Path]:
    """A damage of the lines of a graph's file."""

    def damage(folder: Path) -> Path:
        path = folder / "laps.g2o"
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        return path

    return damage


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    c, s = np.cos(a[2]), np.sin(a[2])
    step = b[:2] - a[:2]
    turn = (b[2] - a[2] + np.pi) % (2 * np.pi) - np.pi
    return np.array([c * step[0] + s * step[1], -s * step[0] + c * step[1], turn])


def _upper(matrix: np.ndarray) -> np.ndarray:
    return matrix[np.triu_indices(3)]
