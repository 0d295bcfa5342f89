"""Flights and graphs with known truth, for the tests of the back end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backend import se3
from backend.measurements import Attitude, Measurements, Position, RelativePose, SlantRange
from backend.pose_graph.graph import PoseGraph

ODOMETRY_STD = np.array([0.004, 0.004, 0.006, 0.01, 0.01, 0.01])
LOOP_STD = np.array([0.006, 0.006, 0.01, 0.015, 0.015, 0.015])


@dataclass(frozen=True)
class Made:
    """Measurements and the truth behind them."""

    measurements: Measurements
    truth: np.ndarray


def flight(
    seed: int,
    n: int = 60,
    loops: int = 12,
    attitude_std: tuple[float, float, float] | None = (0.01, 0.01, np.inf),
    range_std: float | None = 0.01,
    position_std: float | None = None,
    height: float = 0.8,
) -> Made:
    """Two rounds of a figure eight at constant height with slowly turning heading."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 4 * np.pi, n)
    xi = np.zeros((n, 6))
    xi[:, :2] = 0.05 * rng.normal(size=(n, 2))
    truth = se3.from_planar(np.column_stack([2 * np.sin(phase), np.sin(2 * phase), 0.3 * phase])) @ se3.exp(
        xi
    )
    truth[:, 2, 3] = height + 0.05 * np.sin(3 * phase)
    edges = [_edge(truth, k, k + 1, ODOMETRY_STD, "odometry", rng) for k in range(n - 1)]
    for _ in range(loops):
        k = int(rng.integers(0, n // 2 - 2))
        edges.append(_edge(truth, k, k + n // 2, LOOP_STD, "loop", rng))
    attitudes = () if attitude_std is None else _attitudes(truth, np.array(attitude_std), rng)
    ranges: tuple[SlantRange, ...] = ()
    if range_std is not None:
        slant = truth[:, 2, 3] / truth[:, 2, 2] + rng.normal(size=n) * range_std
        ranges = tuple(SlantRange(k, float(slant[k]), range_std) for k in range(n))
    positions: tuple[Position, ...] = ()
    if position_std is not None:
        p = truth[:, :3, 3] + rng.normal(size=(n, 3)) * position_std
        positions = tuple(Position(k, p[k], np.full(3, position_std)) for k in range(n))
    return Made(Measurements(np.arange(n) * 0.5, tuple(edges), attitudes, ranges, positions), truth)


def _edge(truth: np.ndarray, i: int, j: int, std: np.ndarray, kind, rng: np.random.Generator) -> RelativePose:
    noise = se3.exp((rng.normal(size=6) * std)[None])[0]
    return RelativePose(i, j, se3.inverse(truth[i]) @ truth[j] @ noise, np.diag(std**2), kind)


def _attitudes(truth: np.ndarray, std: np.ndarray, rng: np.random.Generator) -> tuple[Attitude, ...]:
    R = truth[:, :3, :3]
    angle = np.column_stack(
        [np.arctan2(R[:, 2, 1], R[:, 2, 2]), -np.arcsin(R[:, 2, 0]), np.arctan2(R[:, 1, 0], R[:, 0, 0])]
    )
    angle = angle + rng.normal(size=angle.shape) * np.where(np.isfinite(std), std, 0)
    angle[:, ~np.isfinite(std)] = np.nan
    return tuple(Attitude(k, angle[k], std) for k in range(len(R)))


def falsified(made: Made, count: int, seed: int) -> tuple[Made, np.ndarray]:
    """Turn ``count`` loops into false ones; also gives (m,) which edges are false."""
    rng = np.random.default_rng(seed)
    edges = list(made.measurements.relative_poses)
    loops = [k for k, e in enumerate(edges) if e.kind == "loop"]
    false = np.zeros(len(edges), dtype=bool)
    for k in rng.choice(loops, count, replace=False):
        e = edges[k]
        xi = np.concatenate([rng.normal(size=3) * 0.3, rng.normal(size=3)])
        edges[k] = replace(e, i_T_j=e.i_T_j @ se3.exp(xi[None])[0])
        false[k] = True
    return Made(replace(made.measurements, relative_poses=tuple(edges)), made.truth), false


def graph(seed: int, dimension: int, n: int = 40, noise: float = 1.0, poses: bool = True) -> PoseGraph:
    """A closed walk with extra loops; exact for ``noise`` 0, with correlated information."""
    rng = np.random.default_rng(seed)
    d = 3 if dimension == 2 else 6
    if dimension == 2:
        truth = se3.from_planar(np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-3, 3, n)]))
    else:
        truth = se3.exp(rng.normal(size=(n, 6)) * [1, 1, 1, 3, 3, 3])
    i = np.concatenate([np.arange(n - 1), rng.integers(0, n // 2, n // 2)])
    j = np.concatenate([np.arange(1, n), rng.integers(n // 2 + 1, n, n // 2)])
    A = rng.normal(size=(len(i), d, d)) * 0.2 + np.eye(d)
    information = 1e4 * A @ np.swapaxes(A, 1, 2)
    draw = np.linalg.solve(
        np.swapaxes(np.linalg.cholesky(information), 1, 2), rng.normal(size=(len(i), d, 1))
    )
    off = noise * draw[..., 0]
    error = se3.from_planar(off) if dimension == 2 else se3.exp(off)
    ij_T = se3.inverse(truth[i]) @ truth[j] @ error
    start = truth if poses else np.full_like(truth, np.nan)
    return PoseGraph(dimension, np.arange(n), start, i, j, ij_T, information, np.zeros(n, dtype=bool))


def unplaced_graph(i: np.ndarray, j: np.ndarray, ij_T: np.ndarray, std: np.ndarray) -> PoseGraph:
    """A graph without poses, of edges (m,) with the transforms (m, 4, 4) and one deviation (3,) or (6,)."""
    n = int(max(i.max(), j.max())) + 1
    information = np.tile(np.diag(std**-2.0), (len(i), 1, 1))
    poses, fixed = np.full((n, 4, 4), np.nan), np.zeros(n, dtype=bool)
    return PoseGraph(2 if len(std) == 3 else 3, np.arange(n), poses, i, j, ij_T, information, fixed)


def planar_chain(n: int) -> PoseGraph:
    """A graph without poses: a straight path of n poses, 1 m apart."""
    step = np.tile(np.eye(4), (n - 1, 1, 1))
    step[:, 0, 3] = 1.0
    return unplaced_graph(np.arange(n - 1), np.arange(1, n), step, np.array([0.05, 0.05, 0.01]))
