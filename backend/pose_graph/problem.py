"""The estimation problem, the same for a flight's measurements and a g2o file: edges and unary factors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.graph import MIN_INFORMATION, PoseGraph, check
from backend.pose_graph.unary_factors import UnaryFactor, fixed, gtsam_poses

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_LARGEST_ROOT = 0.9e8
"""Square root of information below which gtsam's diagonal model is none of its constraints: those begin at a
standard deviation of 1e-8."""


@dataclass(frozen=True)
class Problem:
    """Poses 0..n-1, edges between them, and unary factors on single poses."""

    dimension: int
    names: tuple[str, ...]
    """(n,) name of each pose in messages: ``keyframe 7``, ``vertex 12``."""
    i: Index
    j: Index
    """(m,)."""
    ij_T: Array
    """(m, 4, 4)."""
    sqrt_information: Array
    """(m, d, d) R with R^T R the information, in gtsam's tangent order."""
    trusted: NDArray[np.bool_]
    """(m,) edges that are rejected only if nothing else explains the inconsistency: odometry."""
    initial: Array
    """(n, 4, 4), NaN where unknown."""
    unary_factors: tuple[UnaryFactor, ...] = ()
    length_unit: str = "m"
    """Name of the unit of lengths in messages."""
    noise: float = 1.0
    """Factor of these standard deviations over those that the file or the flight states."""

    @property
    def count(self) -> int:
        """Number of poses."""
        return len(self.names)

    @property
    def dof(self) -> int:
        """Number of degrees of freedom of a pose: 3 or 6."""
        return 3 if self.dimension == 2 else 6

    @cached_property
    def log_sqrt_information(self) -> Array:
        """(m,) logarithms of the determinants of ``sqrt_information``."""
        return np.asarray(np.linalg.slogdet(self.sqrt_information)[1])

    def name(self, key: int) -> str:
        """Return the name of a key in messages."""
        return self.names[key]

    def restricted(self, members: Index) -> Problem:
        """Return the subproblem on some poses (sorted), renumbered from 0."""
        if len(members) == self.count:
            return self
        number = np.full(self.count, -1, dtype=np.int64)
        number[members] = np.arange(len(members))
        edge = self.edges_among(members)
        return replace(
            self,
            names=tuple(self.names[k] for k in members),
            i=number[self.i[edge]],
            j=number[self.j[edge]],
            ij_T=self.ij_T[edge],
            sqrt_information=self.sqrt_information[edge],
            trusted=self.trusted[edge],
            initial=self.initial[members],
            unary_factors=tuple(a.with_key(int(number[a.k])) for a in self.unary_factors if number[a.k] >= 0),
        )

    def edges_among(self, members: Index) -> NDArray[np.bool_]:
        """Return (m,) which edges join two of some poses."""
        return np.asarray(np.isin(self.i, members) & np.isin(self.j, members))

    def with_edges(self, which: NDArray[np.bool_]) -> Problem:
        """Return the problem with the same poses and only some edges (m,)."""
        if which.all():
            return self
        return replace(
            self,
            i=self.i[which],
            j=self.j[which],
            ij_T=self.ij_T[which],
            sqrt_information=self.sqrt_information[which],
            trusted=self.trusted[which],
        )

    def with_noise(self, scale: float) -> Problem:
        """Return the problem with the standard deviations of all edges multiplied by a factor."""
        if scale == 1:
            return self
        root = self.sqrt_information / scale
        return replace(self, sqrt_information=root, noise=self.noise * scale)

    def residuals(self, w_T: Array) -> Array:
        """Return (m, d) whitened residuals of the edges as gtsam defines them: the log of the pose error."""
        error = se3.inverse(self.ij_T) @ se3.inverse(w_T[self.i]) @ w_T[self.j]
        tangent = se3.planar_log(error) if self.dimension == 2 else se3.log(error)
        return np.asarray(np.einsum("mab,mb->ma", self.sqrt_information, tangent))

    def adjoint(self, T: Array) -> Array:
        """Return the adjoints (..., d, d) of transforms (..., 4, 4) on the problem's tangent space."""
        whole = se3.adjoint(T)
        return whole if self.dof == 6 else whole[..., se3.PLANAR[:, None], se3.PLANAR]

    def edge_factors(self, weight: Array | None = None) -> gtsam.NonlinearFactorGraph:
        """Return the between factors; ``weight`` (m,) multiplies the information, 0 omits the edge."""
        if weight is not None:
            used = weight > 0
            scaled = replace(self, sqrt_information=np.sqrt(weight)[:, None, None] * self.sqrt_information)
            return scaled.with_edges(used).edge_factors()
        graph = gtsam.NonlinearFactorGraph()
        add = graph.add
        for factor in self.single_factors():
            add(factor)
        return graph

    def single_factors(self) -> Iterator[gtsam.NonlinearFactor]:
        """Yield the between factors one by one."""
        make = gtsam.BetweenFactorPose2 if self.dimension == 2 else gtsam.BetweenFactorPose3
        poses = gtsam_poses(self.ij_T, self.dimension)
        return map(make, self.i.tolist(), self.j.tolist(), poses, _models(self.sqrt_information))

    def unary_factor_graph(self) -> gtsam.NonlinearFactorGraph:
        """Return the unary factors with their robust losses."""
        graph = gtsam.NonlinearFactorGraph()
        for unary in self.unary_factors:
            graph.push_back(unary.factor)
        return graph

    def values(self, w_T: Array) -> gtsam.Values:
        """Convert poses (n, 4, 4) to gtsam values with keys 0..n-1."""
        values, poses = gtsam.Values(), gtsam_poses(w_T, self.dimension)
        # A keyword selects the overload at once instead of trying a dozen others.
        if self.dimension == 2:
            for k, pose in enumerate(poses):
                values.insert(k, pose2=pose)
        else:
            for k, pose in enumerate(poses):
                values.insert(k, pose3=pose)
        return values

    def poses(self, values: gtsam.Values) -> Array:
        """Convert gtsam values back to poses (n, 4, 4)."""
        if self.dimension == 2:
            return se3.from_planar(np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3))
        return spatial_poses(values)


def spatial_poses(values: gtsam.Values) -> Array:
    """Return all spatial poses (n, 4, 4) in order of their keys."""
    rows = np.asarray(gtsam.utilities.extractPose3(values)).reshape(-1, 12)
    w_T = np.tile(np.eye(4), (len(rows), 1, 1))
    w_T[:, :3, :3], w_T[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    return w_T


def _models(R: Array) -> list[gtsam.noiseModel.Gaussian]:
    """Return the noise model of each square-root information (m, d, d); one shared model if all are equal."""
    # Beyond these, gtsam's diagonal model is a constraint: no information would be infinite, and a deviation
    # that counts as zero would enter the covariances as 1.
    diagonal = np.diagonal(R, axis1=1, axis2=2)
    positive = ((diagonal > 0) & (diagonal < _LARGEST_ROOT)).all(axis=1)
    smart = positive & (np.count_nonzero(R, axis=(1, 2)) == R.shape[1])
    make = gtsam.noiseModel.Gaussian.SqrtInformation
    if len(R) and np.ptp(R, axis=0).max() == 0:
        return [make(R[0], bool(smart[0]))] * len(R)
    return [make(matrix, s) for matrix, s in zip(R, smart.tolist(), strict=True)]


def square_roots(information: Array) -> Array:
    """Return R (m, d, d) with R^T R = information, upper triangular if it is positive definite.

    Raises ``BackendError`` if it has a negative eigenvalue or none above zero.
    """
    try:
        return np.swapaxes(np.linalg.cholesky(information), 1, 2).copy()
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(information)
        bad = (values[:, 0] < -1e-9 * values[:, -1]) | (values[:, -1] <= 0)
        if bad.any():
            e = int(np.argmax(bad))
            raise BackendError(
                f"the information matrix of edge {e} is not positive (smallest eigenvalue {values[e, 0]:.3g};"
                f" {bad.sum()} such edges); drop it"
            ) from None
        return np.asarray(np.sqrt(np.maximum(values, 0))[:, :, None] * np.swapaxes(vectors, 1, 2))


def informative(problem: Problem) -> NDArray[np.bool_]:
    """Return (m,) whether an edge carries information about any direction, above rounding errors."""
    return np.asarray((problem.sqrt_information**2).sum(axis=1).max(axis=1) > MIN_INFORMATION)


def from_pose_graph(graph: PoseGraph) -> Problem:
    """Build the problem of a g2o graph; the edges of odometry are trusted.

    Raises ``BackendError`` for invalid arrays.
    """
    check(graph)
    fixed_poses = np.flatnonzero(graph.fixed & graph.has_pose).tolist()
    return Problem(
        dimension=graph.dimension,
        names=tuple(f"vertex {number}" for number in graph.ids.tolist()),
        i=graph.i,
        j=graph.j,
        ij_T=graph.ij_T,
        sqrt_information=square_roots(graph.information),
        trusted=graph.is_odometry,
        initial=graph.poses,
        unary_factors=tuple(fixed(k, graph.poses[k], graph.dimension) for k in fixed_poses),
    )
