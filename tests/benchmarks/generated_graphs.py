"""Planar pose graphs made with known truth: laps, figure eights and lawn-mower paths of one to three robots.

Odometry joins the consecutive poses of a robot. True loops join a pose to a place that was visited before, by
the same robot or by another one. False loops are random, or come in rows that are consistent with each other
and with the odometry, as a floor that repeats makes them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from backend import se3
from backend.pose_graph.graph import PoseGraph

Array = np.ndarray

SHAPES = ("laps", "eights", "lawn mower")
KINDS = {"random": 1, "consistent": 8}
"""Number of false loops in a row."""
SHARES = (0.0, 0.1, 0.25, 0.3, 0.5, 0.6)
POSES_PER_LOOP = (1, 2, 4)
STD = np.array([0.05, 0.05, np.radians(1.1)])
"""Standard deviations (m, m, rad) of each edge."""
_NEAR_M = 0.8
"""Distance up to which two poses see the same place."""
_APART = 15
"""Smallest difference of pose numbers within one robot for a loop."""
_FALSE_M, _FALSE_RAD = 1.0, np.radians(20)
"""A measurement that is wrong by less than both of these is not made as a false loop."""


@dataclass(frozen=True)
class Scene:
    """Parameters of one made graph."""

    shape: str
    robots: int
    poses_per_loop: int
    share: float
    """Share of false loops among all loops; -1 for exactly one false loop."""
    kind: str
    seed: int

    @property
    def label(self) -> str:
        """Name of the scene."""
        false = "one false" if self.share < 0 else f"{100 * self.share:.0f} % false"
        return (
            f"{self.shape}, {self.robots} robots, a loop every {self.poses_per_loop} poses, {false}"
            f" {self.kind}, seed {self.seed}"
        )


@dataclass(frozen=True)
class MadeGraph:
    """A made graph with its truth."""

    graph: PoseGraph
    w_T: Array
    """(n, 4, 4) true poses."""
    odometry: Array
    """(m,) edges of odometry."""
    false: Array
    """(m,) false loops."""


def scenes(seeds: range) -> Iterator[Scene]:
    """Yield all combinations."""
    shares = [(share, kind) for share in SHARES[1:] for kind in KINDS]
    for shape, robots, each, (share, kind), seed in product(
        SHAPES, (1, 2, 3), POSES_PER_LOOP, [(0.0, "random"), (-1.0, "random"), *shares], seeds
    ):
        yield Scene(shape, robots, each, share, kind, seed)


def make(scene: Scene) -> MadeGraph:
    """Make one graph; ids have a gap after each robot, and initial poses follow the odometry."""
    kind = list(KINDS).index(scene.kind)
    about = [
        SHAPES.index(scene.shape),
        scene.robots,
        scene.poses_per_loop,
        round(100 * scene.share) + 100,
        kind,
    ]
    rng = np.random.default_rng([scene.seed, *about])
    paths = [_path(scene.shape, rng) for _ in range(scene.robots)]
    robot = np.repeat(np.arange(scene.robots), [len(path) for path in paths])
    truth = np.concatenate(paths)
    ids = np.concatenate([np.arange(len(path)) for path in paths]) + 1000 * robot
    w_T = se3.from_planar(truth)
    step = np.flatnonzero(robot[1:] == robot[:-1])
    odometry = np.column_stack([step, step + 1])
    seen = ("nearest", "any")[scene.seed % 2]
    loops = _true_loops(truth, robot, scene.poses_per_loop, seen, rng)
    T_odometry, T_loops = (_measured(w_T, pairs, rng) for pairs in (odometry, loops))
    count = 1 if scene.share < 0 else round(scene.share / (1 - scene.share) * len(loops))
    wrong, T_wrong = _false_loops(w_T, robot, T_loops, count, KINDS[scene.kind], rng)
    pairs = np.vstack([odometry, loops, wrong])
    n_odometry, n_true = len(odometry), len(odometry) + len(loops)
    graph = PoseGraph(
        dimension=2,
        ids=ids.astype(np.int64),
        poses=_chained(w_T, robot, T_odometry),
        i=pairs[:, 0],
        j=pairs[:, 1],
        ij_T=np.concatenate([T_odometry, T_loops, T_wrong]),
        information=np.tile(np.diag(STD**-2.0), (len(pairs), 1, 1)),
        fixed=np.zeros(len(ids), dtype=bool),
    )
    number = np.arange(len(pairs))
    return MadeGraph(graph, w_T, number < n_odometry, number >= n_true)


def _path(shape: str, rng: np.random.Generator) -> Array:
    """Return (n, 3) poses: x, y, heading along the path, in a frame of the shape's own."""
    begin = rng.uniform(0, 2 * np.pi)
    if shape == "lawn mower":
        rows, length, gap = 6, 20, 0.5
        xy = np.array(
            [
                (k if row % 2 == 0 else length - 1 - k, row * gap)
                for row in range(rows)
                for k in range(length)
            ],
            dtype=float,
        ) * [0.5, 1.0]
    else:
        t = begin + 2 * np.pi * np.arange(120) / 40
        xy = np.column_stack([5 * np.cos(t), 5 * np.sin(t) * (1 if shape == "laps" else np.cos(t))])
    xy = xy + rng.normal(scale=0.1, size=xy.shape)
    ahead = np.gradient(xy, axis=0)
    return np.column_stack([xy, np.arctan2(ahead[:, 1], ahead[:, 0])])


def _true_loops(truth: Array, robot: Array, each: int, seen: str, rng: np.random.Generator) -> Array:
    """Join each pose, or every second or fourth one, to a near place visited before: the nearest, or any."""
    loops = []
    for k in range(len(truth)):
        earlier = np.arange(k)
        earlier = earlier[(robot[earlier] != robot[k]) | (k - earlier >= _APART)]
        off = np.linalg.norm(truth[earlier, :2] - truth[k, :2], axis=1)
        near = earlier[off < _NEAR_M]
        if k % each == 0 and len(near):
            nearest = near[np.argmin(off[off < _NEAR_M])]
            loops.append((int(nearest if seen == "nearest" else rng.choice(near)), k))
    return np.array(loops, dtype=np.int64).reshape(-1, 2)


def _measured(w_T: Array, pairs: Array, rng: np.random.Generator) -> Array:
    noise = se3.from_planar(rng.normal(size=(len(pairs), 3)) * STD)
    return np.asarray(se3.inverse(w_T[pairs[:, 0]]) @ w_T[pairs[:, 1]] @ noise)


def _false_loops(
    w_T: Array, robot: Array, T_loops: Array, count: int, row: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Make ``count`` false loops in rows; each row begins with the measurement of a true loop elsewhere."""
    pairs: list[tuple[int, int]] = []
    measured: list[Array] = []
    while len(pairs) < count:
        size = min(row, count - len(pairs))
        i, j = np.sort(rng.integers(0, len(w_T) - size, 2))
        if robot[i] != robot[i + size - 1] or robot[j] != robot[j + size - 1]:
            continue
        T = T_loops[rng.integers(len(T_loops))]
        off = se3.planar_log((se3.inverse(T) @ se3.inverse(w_T[i]) @ w_T[j])[None])[0]
        if j - i < max(size, _APART) or (np.hypot(*off[:2]) < _FALSE_M and abs(off[2]) < _FALSE_RAD):
            continue
        for k in range(size):
            here, there = (se3.inverse(w_T[a]) @ w_T[a + k] for a in (i, j))
            noise = se3.from_planar(rng.normal(size=(1, 3)) * STD)[0]
            pairs.append((int(i + k), int(j + k)))
            measured.append(se3.inverse(here) @ T @ there @ noise)
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(measured).reshape(-1, 4, 4)


def _chained(w_T: Array, robot: Array, T_odometry: Array) -> Array:
    start = w_T.copy()
    step = iter(T_odometry)
    for k in range(1, len(w_T)):
        if robot[k] == robot[k - 1]:
            start[k] = start[k - 1] @ next(step)
    return start
