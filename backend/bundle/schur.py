"""Elimination of floor points from the normal equations, and their back-substitution: numba kernels.

The normal equations of poses x and points p are [U W; W' V] (x, p) = (u, v), with V block diagonal, one
3 x 3 block L L' for each point. Without the points they are S x = u - W V^-1 v with S = U - W V^-1 W', the
reduced camera system. An observation with the Jacobians J by its pose and P by its point adds J' P to W.
With Q = P L'^-1, S_ij is U_ij less the products J_i' (Q_i Q_j') J_j over the common points of the keyframes
i and j. W L'^-1 has the blocks J' Q, three times as large as Q, and is never in memory. A calibration that
all pictures share is one more variable, of q numbers (0 if it is fixed).

Observations are sorted by point: those of point t begin at ``first[t]``. ``by_camera`` (m,) sorts them by
camera: those of camera i begin at ``at[i]``. Blocks of S are those of its upper triangle, row by row: row i
has the columns ``column[row[i] : row[i + 1]]``, in ascending order.

Source: Triggs et al. 2000, section 6.1; Agarwal, Snavely, Seitz and Szeliski 2010, section 3.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.compilation import discard_stale, njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

discard_stale([Path(__file__)])


@njit(cache=True)
def block_pattern(
    camera: Index, track: Index, first: Index, by_camera: Index, at: Index
) -> tuple[Index, Index]:
    """Return ``row`` (n + 1,) and ``column`` (blocks,) of the reduced camera system; rows are not sorted."""
    n = len(at) - 1
    row = np.zeros(n + 1, np.int64)
    seen, buffer = np.full(n, -1), np.empty(n, np.int64)
    for i in range(n):
        row[i + 1] = row[i] + _partners(i, camera, track, first, by_camera, at, seen, buffer)
    column = np.empty(row[n], np.int64)
    seen[:] = -1
    for i in range(n):
        count = _partners(i, camera, track, first, by_camera, at, seen, buffer)
        column[row[i] : row[i + 1]] = buffer[:count]
    return row, column


@njit(cache=True)
def _partners(
    i: int, camera: Index, track: Index, first: Index, by_camera: Index, at: Index, seen: Index, found: Index
) -> int:
    """Fill in the cameras from i on that share a point with camera i, i itself first; return their number."""
    seen[i], found[0], count = i, i, 1
    for a in by_camera[at[i] : at[i + 1]]:
        for b in range(first[track[a]], first[track[a] + 1]):
            j = camera[b]
            if j > i and seen[j] != i:
                seen[j], found[count] = i, j
                count += 1
    return count


@njit(cache=True)
def eliminate(
    first: Index, prior: Array, of_point: Array, of_calibration: Array
) -> tuple[Array, Array, Array]:
    """Return Q of each observation (m, 2, 3), L^-1 W' of the calibration (t, 3, q), and L^-1 (t, 3, 3).

    ``prior`` (t, 3) is the information of the points' priors, added to the diagonal of V.
    """
    points, q = len(first) - 1, of_calibration.shape[2]
    whitened, y_calibration = np.empty(of_point.shape), np.zeros((points, 3, q))
    inverse, V, mixed = np.empty((points, 3, 3)), np.empty((3, 3)), np.empty((3, q))
    for t in range(points):
        V[:], mixed[:] = 0.0, 0.0
        for a in range(3):
            V[a, a] = prior[t, a]
        for m in range(first[t], first[t + 1]):
            for k in range(2):
                for a in range(3):
                    for b in range(a + 1):
                        V[a, b] += of_point[m, k, a] * of_point[m, k, b]
                    for c in range(q):
                        mixed[a, c] += of_point[m, k, a] * of_calibration[m, k, c]
        R = inverse[t]
        inverse_cholesky(V, R)
        for a in range(3):
            for c in range(q):
                y_calibration[t, a, c] = R[a, 0] * mixed[0, c] + R[a, 1] * mixed[1, c] + R[a, 2] * mixed[2, c]
            for m in range(first[t], first[t + 1]):
                J = of_point[m]
                for k in range(2):
                    whitened[m, k, a] = R[a, 0] * J[k, 0] + R[a, 1] * J[k, 1] + R[a, 2] * J[k, 2]
    return whitened, y_calibration, inverse


@njit(cache=True)
def inverse_cholesky(V: Array, R: Array) -> None:
    """Fill in the inverse R (3, 3) of the lower Cholesky factor of V (3, 3), whose lower triangle is read."""
    l00 = math.sqrt(V[0, 0])
    l10, l20 = V[1, 0] / l00, V[2, 0] / l00
    l11 = math.sqrt(V[1, 1] - l10 * l10)
    l21 = (V[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(V[2, 2] - l20 * l20 - l21 * l21)
    R[0, 1] = R[0, 2] = R[1, 2] = 0.0
    R[0, 0], R[1, 1], R[2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
    R[1, 0] = -l10 / l00 / l11
    R[2, 1] = -l21 / l11 / l22
    R[2, 0] = (l10 * l21 / l11 - l20) / l00 / l22


@njit(cache=True)
def add_camera_system(
    camera: Index,
    track: Index,
    first: Index,
    by_camera: Index,
    at: Index,
    row: Index,
    column: Index,
    of_pose: Array,
    whitened: Array,
    place: Index,
    begin: int,
    end: int,
    where: Index,
    D: Array,
    B: Array,
) -> None:
    """Add the columns from ``begin`` to ``end`` of S to the transposed blocks of a front, as
    `backend.sparse_cholesky.Blocks` does. ``place`` (n,) is the first column of each camera.
    """
    n = len(at) - 1
    number, blocks = np.empty(n, np.int64), np.empty((n, 6, 6))
    for i in range(np.searchsorted(place, begin), np.searchsorted(place, end)):
        count = row[i + 1] - row[i]
        blocks[:count] = 0.0
        for k in range(count):
            number[column[row[i] + k]] = k
        for m in by_camera[at[i] : at[i + 1]]:
            for c in range(6):
                u, v = of_pose[m, 0, c], of_pose[m, 1, c]
                for d in range(6):
                    blocks[number[i], c, d] += u * of_pose[m, 0, d] + v * of_pose[m, 1, d]
            P, J = whitened[m], of_pose[m]
            for other in range(first[track[m]], first[track[m] + 1]):
                if camera[other] < i:
                    continue
                block, Q, K = blocks[number[camera[other]]], whitened[other], of_pose[other]
                k00 = P[0, 0] * Q[0, 0] + P[0, 1] * Q[0, 1] + P[0, 2] * Q[0, 2]
                k01 = P[0, 0] * Q[1, 0] + P[0, 1] * Q[1, 1] + P[0, 2] * Q[1, 2]
                k10 = P[1, 0] * Q[0, 0] + P[1, 1] * Q[0, 1] + P[1, 2] * Q[0, 2]
                k11 = P[1, 0] * Q[1, 0] + P[1, 1] * Q[1, 1] + P[1, 2] * Q[1, 2]
                for c in range(6):
                    u = k00 * J[0, c] + k10 * J[1, c]
                    v = k01 * J[0, c] + k11 * J[1, c]
                    for d in range(6):
                        block[c, d] -= u * K[0, d] + v * K[1, d]
        for c in range(6):
            own = place[i] + c
            for k in range(count):
                for d in range(6):
                    other = place[column[row[i] + k]] + d
                    if other >= end:
                        B[own - begin, where[other]] += blocks[k, c, d]
                    elif other >= own:
                        D[own - begin, other - begin] += blocks[k, c, d]


@njit(cache=True)
def transposed_product(blocks: Array, row: Index, column: Index, vectors: Array, columns: int) -> Array:
    """Return the product (columns, c, k) of transposed blocks (m, r, c) with vectors (rows, r, k)."""
    product = np.zeros((columns, blocks.shape[2], vectors.shape[2]))
    for m in range(len(blocks)):
        x, y = vectors[row[m]], product[column[m]]
        for a in range(blocks.shape[1]):
            for b in range(blocks.shape[2]):
                for k in range(vectors.shape[2]):
                    y[b, k] += blocks[m, a, b] * x[a, k]
    return product


@njit(cache=True)
def add_product(blocks: Array, column: Index, vectors: Array, product: Array) -> None:
    """Add the product of blocks (m, r, c) with the vectors (columns, c, k) at ``column`` to (m, r, k)."""
    for m in range(len(blocks)):
        x, y = vectors[column[m]], product[m]
        for a in range(blocks.shape[1]):
            for b in range(blocks.shape[2]):
                for k in range(vectors.shape[2]):
                    y[a, k] += blocks[m, a, b] * x[b, k]


@njit(cache=True)
def add_products(
    left: Array, right: Array, row: Index, column: Index, vectors: Array, product: Array
) -> None:
    """Add left' right x of each observation, blocks (m, 2, a) and (m, 2, b) with the vectors (columns, b, k)
    at ``column``, to the products (rows, a, k) at ``row``."""
    count = vectors.shape[2]
    between = np.empty((2, count))
    for m in range(len(left)):
        x, y = vectors[column[m]], product[row[m]]
        between[:] = 0.0
        for r in range(2):
            for b in range(right.shape[2]):
                for k in range(count):
                    between[r, k] += right[m, r, b] * x[b, k]
        for r in range(2):
            for a in range(left.shape[2]):
                for k in range(count):
                    y[a, k] += left[m, r, a] * between[r, k]
