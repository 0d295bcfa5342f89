"""The normal equations of a refinement, with the floor points eliminated.

The factors of the pose side are linearised by gtsam, and the observations of the floor points by a kernel.
Together they are one sparse system in the variables of the pose side, in an order of elimination that is
found once, because the pattern stays.

Source: Triggs et al. 2000, section 6 (reduced camera system); Agarwal, Snavely, Seitz and Szeliski 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array, csc_array, csr_array, diags_array, vstack

from backend.bundle.exposure_motion import READOUT
from backend.bundle.observations import FloorObservations, LinearObservations
from backend.bundle.schur import add_camera_system, block_pattern, eliminate, transposed_product
from backend.pose_graph.linear import linear_system
from backend.sparse_cholesky import Blocks, Cholesky, Elimination, analyse, factorise

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_NUMBERS = 2_500_000
"""Numbers of all right-hand sides that are solved for at a time, at most. They are 20 MB, and a solution
needs about five times as much; 25 right-hand sides of a survey of 400 photographs are as many."""


def columns_at_once(rows: int, most: int) -> int:
    """Return how many right-hand sides of some rows are solved for at a time: ``most`` of a small system."""
    return int(np.clip(MOST_NUMBERS // max(rows, 1), 1, most))


@dataclass(frozen=True)
class Structure:
    """Order of elimination of the pose side, and pattern of the reduced camera system."""

    variable: dict[int, int]
    """Number of each key of the pose side, 0.. by key."""
    elimination: Elimination
    observations: FloorObservations
    camera: Index
    """(m,) camera of each observation. Cameras are keyframes, numbered in the order of elimination."""
    by_camera: Index
    """(m,) observations, sorted by camera."""
    at: Index
    """(n + 1,) begin of each camera's observations among these."""
    row: Index
    """(n + 1,) begin of each camera's blocks, and..."""
    column: Index
    """(blocks,) ...the camera of each block's columns."""
    of_cameras: Index
    """(6n,) columns of the cameras."""
    of_calibration: Index
    """(q,) columns of the calibration, and of the read-out time; none of what is fixed."""

    @staticmethod
    def of(
        graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, n: int, observations: FloorObservations
    ) -> Structure:
        """Analyse the pattern of a pose-side graph and the observations of its ``n`` keyframes."""
        dims = values.dims()
        variable = {key: k for k, key in enumerate(sorted(dims))}
        keyframes = np.array([variable[POSE(k)] for k in range(n)])
        common = [variable[key] for key in (CALIBRATION(0), READOUT) if key in variable]
        lens = np.array(common, dtype=np.int64)
        by_camera, at = _sorted_by(observations.keyframe, n)
        row, column = block_pattern(
            observations.keyframe, observations.track, observations.first, by_camera, at
        )
        pairs = np.column_stack([np.repeat(np.arange(n), np.diff(row)), column])
        everywhere = np.array([(k, v) for v in lens for k in keyframes], dtype=np.int64).reshape(-1, 2)
        together = np.array(list(combinations(common, 2)), dtype=np.int64).reshape(-1, 2)
        ties = np.vstack([_pairs_of(graph, variable), keyframes[pairs], everywhere, together])
        widths = np.array([dims[key] for key in variable], dtype=np.int64)
        elimination = analyse(np.unique(ties[ties[:, 0] != ties[:, 1]], axis=0), widths)
        order = np.argsort(elimination.begin[keyframes])
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n)
        camera = rank[observations.keyframe]
        pairs = np.sort(rank[pairs], axis=1)
        return Structure(
            variable,
            elimination,
            observations,
            camera,
            *_sorted_by(camera, n),
            row=np.concatenate([[0], np.cumsum(np.bincount(pairs[:, 0], minlength=n))]),
            column=pairs[np.lexsort(pairs.T[::-1]), 1],
            of_cameras=elimination.columns(keyframes[order]),
            of_calibration=elimination.columns(lens),
        )

    def columns(self, key: int) -> slice:
        """Return the columns of a variable of the pose side."""
        v = self.variable[key]
        begin = int(self.elimination.begin[v])
        return slice(begin, begin + int(self.elimination.widths[v]))

    def columns_of(self, keys: Sequence[int]) -> Index:
        """Return the columns (k, d) of variables with as many numbers each."""
        variables = np.array([self.variable[key] for key in keys])
        return self.elimination.columns(variables).reshape(len(keys), -1)

    @cached_property
    def by_key(self) -> Index:
        """Place among the columns by key of each column in the order of elimination."""
        at = np.empty(self.elimination.size, dtype=np.int64)
        at[self.elimination.columns(np.arange(len(self.variable)))] = np.arange(len(at))
        return at


def _sorted_by(number: Index, n: int) -> tuple[Index, Index]:
    begin = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=n))])
    return np.argsort(number, kind="stable"), begin


def _pairs_of(graph: gtsam.NonlinearFactorGraph, variable: dict[int, int]) -> Index:
    """Return the pairs (p, 2) of variables that share a factor."""
    found = {
        pair
        for factor in (graph.at(k) for k in range(graph.size()))
        for pair in combinations(sorted(variable[key] for key in factor.keys()), 2)  # noqa: SIM118
    }
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class LinearSystem:
    """Linearised residuals of the pose side and the floor points, whitened, with robust weights."""

    structure: Structure
    seen: LinearObservations
    pose_side: csc_array
    """(rows, size) Jacobian of the pose side's factors, columns in the order of elimination."""
    pose_side_right: Array
    """(rows,) minus their residuals."""

    @staticmethod
    def at(
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        structure: Structure,
        seen: LinearObservations,
    ) -> LinearSystem:
        """Linearise the pose side at ``values``, and join it with the observations."""
        return LinearSystem(structure, seen, *linear_system(graph, values, structure.by_key))

    @property
    def error(self) -> float:
        """Half the sum of squares."""
        parts = self.seen.right, self.seen.prior_right, self.pose_side_right
        return 0.5 * sum(float(np.sum(part**2)) for part in parts)

    @cached_property
    def _of_cameras(self) -> bsr_array:
        count = len(self.structure.camera)
        entries = self.seen.of_pose, self.structure.camera, np.arange(count + 1)
        return bsr_array(entries, shape=(2 * count, len(self.structure.of_cameras)))

    @property
    def _of_calibration(self) -> Array:
        return self.seen.of_calibration.reshape(
            2 * len(self.structure.camera), len(self.structure.of_calibration)
        )

    @cached_property
    def gradient(self) -> tuple[Array, Array]:
        """J'b by the pose side (size,) and by the points (3t,)."""
        right = self.seen.right.ravel()
        by_pose = np.asarray(self.pose_side.T @ self.pose_side_right)
        s, seen, each = self.structure, self.seen, np.arange(len(self.structure.camera))
        by_pose[s.of_cameras] += _transposed(seen.of_pose, each, s.camera, right, len(s.at) - 1)
        by_pose[s.of_calibration] += self._of_calibration.T @ right
        points = len(seen.prior_right)
        by_point = _transposed(seen.of_point, each, s.observations.track, right, points)
        return by_pose, by_point + (seen.prior_right / s.observations.prior_std).ravel()

    def error_after(self, step: tuple[Array, Array], damping: float) -> float:
        """Return half the sum of squares after the step x that solves (J'J + damping I) x = J'b."""
        pairs = zip(self.gradient, step, strict=True)
        return self.error - 0.5 * sum(float(g @ x + damping * x @ x) for g, x in pairs)

    def eliminate(self, damping: float = 0.0) -> ReducedSystem:
        """Eliminate the points and factorise the rest, with ``damping`` added to the diagonal.

        Raises ``SingularMatrixError`` if a variable is not determined.
        """
        s, seen = self.structure, self.seen
        first, prior = s.observations.first, s.observations.prior_std**-2.0 + damping
        y_pose, y_lens, inverse = eliminate(first, prior, seen.of_pose, seen.of_point, seen.of_calibration)
        y_lens = y_lens.reshape(3 * len(inverse), len(s.of_calibration))
        shape = 3 * len(inverse), len(s.of_cameras)
        y_cameras = bsr_array((y_pose, s.camera, first), shape=shape)
        size = s.elimination.size
        of_sensors = self.pose_side.T @ self.pose_side
        scale = of_sensors.diagonal() + damping
        squares = np.sum(seen.of_pose**2, axis=1)
        for c, columns in enumerate(s.of_cameras.reshape(-1, 6).T):
            scale[columns] += np.bincount(s.camera, squares[:, c], minlength=len(columns))
        parts = [csc_array(of_sensors)]
        if damping:
            parts.append(csc_array(damping * diags_array(np.ones(size))))
        if len(s.of_calibration):
            C = self._of_calibration
            scale[s.of_calibration] += np.sum(C**2, axis=0)
            mixed = self._of_cameras.T @ C - y_cameras.T @ y_lens
            parts.append(self._with_calibration(mixed, C.T @ C - y_lens.T @ y_lens))
        factor = factorise(s.elimination, parts, scale, self._of_camera_system(y_pose))
        return ReducedSystem(s, factor, y_cameras, y_lens, inverse)

    def _of_camera_system(self, y_pose: Array) -> Blocks:
        """Return the reduced camera system, computed front by front."""
        s = self.structure
        seen = s.camera, s.observations.track, s.observations.first, s.by_camera, s.at, s.row, s.column
        place = s.of_cameras[::6].copy()

        def blocks(begin: int, end: int, where: Index, D: Array, B: Array) -> None:
            add_camera_system(*seen, self.seen.of_pose, y_pose, place, begin, end, where, D, B)

        return blocks

    def _with_calibration(self, mixed: Array, own: Array) -> csc_array:
        """Return the entries of the calibration, both triangles."""
        cameras, lens = self.structure.of_cameras, self.structure.of_calibration
        row, column = (index.ravel() for index in np.meshgrid(cameras, lens, indexing="ij"))
        own_row, own_column = (index.ravel() for index in np.meshgrid(lens, lens, indexing="ij"))
        values = np.concatenate([mixed.ravel(), mixed.ravel(), own.ravel()])
        rows = np.concatenate([row, column, own_row])
        columns = np.concatenate([column, row, own_column])
        return csc_array(coo_array((values, (rows, columns)), shape=(self.structure.elimination.size,) * 2))

    def jacobian(self) -> tuple[csr_array, Array]:
        """Return the whole Jacobian (rows, size + 3t), and the right-hand side (rows,).

        Rows are those of the observations, of the points' priors, and of the pose side; columns those of the
        pose side, and of the points.
        """
        s, seen, size = self.structure, self.seen, self.structure.elimination.size
        points = seen.prior_right.size
        lens = np.broadcast_to(s.of_calibration, (len(s.camera), len(s.of_calibration)))
        of_point = size + 3 * s.observations.track[:, None] + np.arange(3)
        # Indices of four bytes: those of eight would be as large as the values.
        columns = np.hstack([s.of_cameras.reshape(-1, 6)[s.camera], lens, of_point]).astype(np.int32)
        values = np.concatenate([seen.of_pose, seen.of_calibration, seen.of_point], axis=2)
        prior, sensors = (1.0 / s.observations.prior_std).ravel(), csr_array(self.pose_side)
        width, each = size + points, np.arange(points + 1)
        begin = np.arange(0, values.size + 1, values.shape[2])
        parts = (
            _by_rows(values, np.repeat(columns, 2, axis=0), begin, width),
            _by_rows(prior, size + each[:-1], each, width),
            _by_rows(sensors.data, sensors.indices, sensors.indptr, width),
        )
        whole = vstack(parts, format="csr")
        right = self.seen.right, self.seen.prior_right, self.pose_side_right
        return csr_array(whole), np.concatenate([part.ravel() for part in right])


def _by_rows(values: Array, column: NDArray[np.integer], begin: NDArray[np.integer], width: int) -> csr_array:
    """Return a matrix of the values in some columns, those of each row from ``begin`` (rows + 1,) on."""
    # Large arrays, of which scipy would keep indices of eight bytes.
    entries = values.ravel(), column.ravel().astype(np.int32, copy=False), begin.astype(np.int32)
    return csr_array(entries, shape=(len(begin) - 1, width))


def _transposed(blocks: Array, row: Index, column: Index, vectors: Array, count: int) -> Array:
    """Return the product (count c, ...) of the transpose of a matrix of blocks (m, r, c) with vectors."""
    width = int(np.prod(vectors.shape[1:]))
    rows = vectors.reshape(len(vectors) // blocks.shape[1], blocks.shape[1], width)
    product = transposed_product(blocks, row, column, rows, count)
    return product.reshape(count * blocks.shape[2], *vectors.shape[1:])


@dataclass(frozen=True)
class ReducedSystem:
    """Factorised normal equations, with the points eliminated."""

    structure: Structure
    factor: Cholesky
    y_cameras: bsr_array
    """(3t, 6n) L^-1 W' of the cameras."""
    y_calibration: Array
    """(3t, q)."""
    inverse: Array
    """(t, 3, 3) L^-1 of each point."""

    @property
    def size(self) -> int:
        """Number of columns of the pose side."""
        return self.structure.elimination.size

    def solve(self, by_pose: Array, by_point: Array) -> tuple[Array, Array]:
        """Solve for right-hand sides by the pose side (size, ...) and by the points (3t, ...)."""
        s = self.structure
        left = self._each(self.inverse, by_point)
        u = np.array(by_pose)
        y, track, cameras = self.y_cameras.data, s.observations.track, len(s.at) - 1
        u[s.of_cameras] -= _transposed(y, track, s.camera, left, cameras)
        u[s.of_calibration] -= self.y_calibration.T @ left
        x = self.factor.solve(u)
        left -= self.y_cameras @ x[s.of_cameras] + self.y_calibration @ x[s.of_calibration]
        return x, self._each(np.swapaxes(self.inverse, 1, 2), left)

    def _each(self, blocks: Array, vectors: Array) -> Array:
        """Multiply each point's block (t, 3, 3) with its part of the vectors (3t, ...)."""
        width = int(np.prod(vectors.shape[1:]))
        return np.asarray(blocks @ vectors.reshape(len(blocks), 3, width)).reshape(vectors.shape)

    @property
    def calibration_covariance(self) -> Array:
        """Covariance (q, q) of the calibration; q = 0 if it is fixed."""
        lens = self.structure.of_calibration
        if READOUT in self.structure.variable:
            lens = lens[:-1]
        unit = np.zeros((self.size, len(lens)))
        unit[lens, np.arange(len(lens))] = 1.0
        return np.asarray(self.factor.solve(unit)[lens])

    def joint_covariances(self, keys: Sequence[int], *common: int) -> Array:
        """Return joint covariances (n, a + d, a + d) of variables, which come first, with common ones."""
        s = self.structure
        shared = s.elimination.columns(np.array([s.variable[key] for key in common]))
        unit = np.zeros((s.elimination.size, len(shared)))
        unit[shared] = np.eye(len(shared))
        with_common = self.factor.solve(unit)
        own = self.factor.covariances(np.array([s.variable[key] for key in keys]))
        mixed = [with_common[s.columns(key)] for key in keys]
        last = with_common[shared]
        return np.array([np.block([[a, b], [b.T, last]]) for a, b in zip(own, mixed, strict=True)])
