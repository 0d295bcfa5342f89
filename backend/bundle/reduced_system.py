"""The normal equations of a refinement, with the floor points eliminated.

The factors of the pose side are linearised by gtsam, and the observations of the floor points by a kernel.
Together they are one sparse system in the variables of the pose side, in an order of elimination that is
found once, because the pattern stays.

Source: Triggs et al. 2000, section 6 (reduced camera system); Agarwal, Snavely, Seitz and Szeliski 2010.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array, csc_array, csr_array, diags_array, vstack

from backend.bundle.exposure_motion import READOUT
from backend.bundle.observations import LinearObservations
from backend.bundle.schur import add_camera_system, add_product, add_products, eliminate, transposed_product
from backend.bundle.structure import Structure
from backend.pose_graph.linear import linear_system
from backend.sparse_cholesky import Blocks, Cholesky, factorise

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_NUMBERS = 2_500_000
"""Numbers of all right-hand sides that are solved for at a time, at most. They are 20 MB, and a solution
needs about five times as much; 25 right-hand sides of a survey of 400 photographs are as many."""
_OBSERVATIONS_AT_ONCE = 8192
"""Observations of which a product with the Jacobian is in memory; the time is flat above a thousand."""


def columns_at_once(rows: int, most: int) -> int:
    """Return how many right-hand sides of some rows are solved for at a time: ``most`` of a small system."""
    return int(np.clip(MOST_NUMBERS // max(rows, 1), 1, most))


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
        return 0.5 * sum(float(np.sum(part**2)) for part in self._rights)

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

    @property
    def right(self) -> Array:
        """Right-hand side (rows,): minus the residuals of observations, points' priors and pose side."""
        return np.concatenate([part.ravel() for part in self._rights])

    @property
    def _rights(self) -> tuple[Array, Array, Array]:
        return self.seen.right, self.seen.prior_right, self.pose_side_right

    @cached_property
    def gradient(self) -> tuple[Array, Array]:
        """J'b by the pose side (size,) and by the points (3t,)."""
        return self.transposed_times(self.right)

    def transposed_times(self, vectors: Array) -> tuple[Array, Array]:
        """Return J'v by the pose side (size, ...) and by the points (3t, ...) of vectors (rows, ...)."""
        s, seen, each = self.structure, self.seen, np.arange(len(self.structure.camera))
        ends = np.cumsum([seen.right.size, seen.prior_right.size])
        of_pixels, of_priors, of_sensors = np.split(np.ascontiguousarray(vectors), ends)
        by_pose = np.asarray(self.pose_side.T @ of_sensors)
        by_pose[s.of_cameras] += _transposed(seen.of_pose, each, s.camera, of_pixels, len(s.at) - 1)
        by_pose[s.of_calibration] += self._of_calibration.T @ of_pixels
        points = len(seen.prior_right)
        by_point = _transposed(seen.of_point, each, s.observations.track, of_pixels, points)
        by_point += (of_priors.T / s.observations.prior_std.ravel()).T
        return by_pose, by_point

    def times(self, by_pose: Array, by_point: Array) -> Array:
        """Return Jx (rows, k) of changes by the pose side (size, k) and by the points (3t, k)."""
        product = np.empty((sum(part.size for part in self._rights), by_pose.shape[1]))
        for rows, part in self.products(by_pose, by_point):
            product[rows] = part
        return product

    def products(self, by_pose: Array, by_point: Array) -> Iterator[tuple[slice, Array]]:
        """Yield Jx of changes by the pose side (size, k) and the points (3t, k) for some rows at a time."""
        s, seen, k = self.structure, self.seen, by_pose.shape[1]
        of_cameras, of_lens = by_pose[s.of_cameras].reshape(len(s.at) - 1, 6, k), by_pose[s.of_calibration]
        of_points = np.ascontiguousarray(by_point).reshape(len(by_point) // 3, 3, k)
        for begin in range(0, len(s.camera), _OBSERVATIONS_AT_ONCE):
            some = slice(begin, begin + _OBSERVATIONS_AT_ONCE)
            part = seen.of_calibration[some] @ of_lens
            add_product(seen.of_pose[some], s.camera[some], of_cameras, part)
            add_product(seen.of_point[some], s.observations.track[some], of_points, part)
            yield slice(2 * begin, 2 * begin + 2 * len(part)), part.reshape(-1, k)
        points = slice(seen.right.size, seen.right.size + seen.prior_right.size)
        yield points, by_point / s.observations.prior_std.reshape(-1, 1)
        yield slice(points.stop, None), self.pose_side @ by_pose

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
        whitened, y_lens, inverse = eliminate(first, prior, seen.of_point, seen.of_calibration)
        y_lens = y_lens.reshape(3 * len(inverse), len(s.of_calibration))
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
            cameras = s.camera, s.observations.track, y_lens, len(s.at) - 1
            mixed = self._of_cameras.T @ C - _across(seen.of_pose, whitened, *cameras)
            parts.append(self._with_calibration(mixed, C.T @ C - y_lens.T @ y_lens))
        factor = factorise(s.elimination, parts, scale, self._of_camera_system(whitened))
        return ReducedSystem(s, factor, seen.of_pose, whitened, y_lens, inverse)

    def _of_camera_system(self, whitened: Array) -> Blocks:
        """Return the reduced camera system, computed front by front."""
        s = self.structure
        seen = s.camera, s.observations.track, s.observations.first, s.by_camera, s.at, s.row, s.column
        place = s.of_cameras[::6].copy()

        def blocks(begin: int, end: int, where: Index, D: Array, B: Array) -> None:
            add_camera_system(*seen, self.seen.of_pose, whitened, place, begin, end, where, D, B)

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
        return csr_array(whole), self.right


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


def _across(left: Array, right: Array, row: Index, column: Index, vectors: Array, count: int) -> Array:
    """Return the product (count a, ...) of the sum of all left' right with vectors (columns b, ...).

    An observation has the blocks ``left`` (m, 2, a) and ``right`` (m, 2, b) at its ``row`` and ``column``.
    """
    width, shape = int(np.prod(vectors.shape[1:])), vectors.shape[1:]
    columns = np.ascontiguousarray(vectors).reshape(len(vectors) // right.shape[2], right.shape[2], width)
    product = np.zeros((count, left.shape[2], width))
    add_products(left, right, row, column, columns, product)
    return product.reshape(count * left.shape[2], *shape)


@dataclass(frozen=True)
class ReducedSystem:
    """Factorised normal equations, with the points eliminated."""

    structure: Structure
    factor: Cholesky
    of_pose: Array
    """(m, 2, 6) Jacobian of each observation by its pose."""
    whitened: Array
    """(m, 2, 3) that by its point, times L'^-1."""
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
        track, cameras, points = s.observations.track, len(s.at) - 1, len(self.inverse)
        u[s.of_cameras] -= _across(self.of_pose, self.whitened, s.camera, track, left, cameras)
        u[s.of_calibration] -= self.y_calibration.T @ left
        x = self.factor.solve(u)
        left -= _across(self.whitened, self.of_pose, track, s.camera, x[s.of_cameras], points)
        left -= self.y_calibration @ x[s.of_calibration]
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
