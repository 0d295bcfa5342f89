"""Cholesky factorisation of a sparse symmetric matrix of small blocks, and the blocks of its inverse.

The columns belong to variables of a few dimensions each. Variables are eliminated in the order of minimum
degree. Columns with almost the same pattern form a front, a dense matrix that LAPACK factorises, so that the
time is that of dense products.

Source: Duff and Reid 1983 (multifrontal method); Liu 1990 (elimination tree); Takahashi, Fagan and Chen
1973 (the inverse on the pattern of the factor).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu

from backend.compilation import discard_stale, njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Blocks = Callable[[int, int, Index, Array, Array], None]
"""Function (begin, end, where, D', B') that adds the entries of the columns from ``begin`` to ``end`` to the
blocks of their front, both transposed: the lower triangle of the columns' own rows to D, and rows r below to
the rows ``where[r]`` of B."""

discard_stale([Path(__file__)])

_FILL = 0.2
"""Share of zeros up to which a column joins the front of its only predecessor: a few zeros cost less than a
front. The time is flat between 0.1 and 0.4."""
_LOST = 1e-14
"""Ratio of a pivot to the diagonal at which all digits are lost: some tens of roundings."""


class SingularMatrixError(ValueError):
    """A variable is not determined by the equations."""

    def __init__(self, variable: int) -> None:
        super().__init__(f"variable {variable} is not determined")
        self.variable = variable


@dataclass(frozen=True)
class _Front:
    """Columns with one pattern, in the order of elimination."""

    begin: int
    end: int
    rows: Index
    """Rows below the columns."""
    in_parent: Index
    """Place of these rows in the front of the parent."""
    children: tuple[int, ...]
    parent: int
    """-1 for a root."""


@dataclass(frozen=True)
class Elimination:
    """Order and structure of the factorisation of all matrices with one pattern."""

    begin: Index
    """(n,) first column of each variable, in the order of elimination."""
    widths: Index
    """(n,) dimensions of each variable."""
    fronts: tuple[_Front, ...]

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.widths.sum())

    def columns(self, variables: Index) -> Index:
        """Return the columns of variables, one after the other."""
        return _ranges(self.begin[variables], self.widths[variables])

    def variable_at(self, column: int) -> int:
        """Return the variable of a column."""
        return int(np.flatnonzero((self.begin <= column) & (column < self.begin + self.widths))[0])


def analyse(pairs: Index, widths: Index) -> Elimination:
    """Order the variables of a matrix whose pairs (p, 2) of variables have common entries."""
    order = _minimum_degree(pairs, len(widths))
    below = _patterns(_renumbered(pairs, order), len(widths))
    parent = np.array([rows[0] if len(rows) else -1 for rows in below])
    postorder = _postorder(parent)
    order = order[postorder]
    place = np.empty_like(postorder)
    place[postorder] = np.arange(len(place))
    below = [np.sort(place[below[v]]) for v in postorder]
    begin = np.concatenate([[0], np.cumsum(widths[order])])
    by_variable = np.empty(len(widths), dtype=np.int64)
    by_variable[order] = begin[:-1]
    return Elimination(by_variable, widths, _fronts(below, begin))


def _renumbered(pairs: Index, order: Index) -> Index:
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return place[pairs]


def _ranges(begin: Index, length: Index) -> Index:
    """Return begin, begin + 1, ... of each range, one after the other."""
    ends = np.cumsum(length)
    return np.repeat(begin - (ends - length), length) + np.arange(ends[-1] if len(ends) else 0)


def _minimum_degree(pairs: Index, n: int) -> Index:
    """Return the variables (n,) by minimum degree of A + A', those tied to very many others last.

    The limit is that of AMD: such a variable would only slow the ordering down. Source: Amestoy, Davis and
    Duff 1996, section 5 (the order) and their code (the limit).
    """
    ties = csc_array((np.ones(2 * len(pairs)), np.vstack([pairs, pairs[:, ::-1]]).T), shape=(n, n))
    degree = np.diff(ties.indptr)
    free = np.flatnonzero(degree <= max(16.0, 10.0 * np.sqrt(n)))
    rest = np.flatnonzero(degree > max(16.0, 10.0 * np.sqrt(n)))
    if not len(free):
        return rest
    ties = csc_array(ties[free][:, free])
    dominant = csc_array(diags_array(ties.sum(axis=0) + 1.0) - ties)
    found = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True})
    return np.concatenate([free[np.argsort(found.perm_c)], rest]).astype(np.int64)


def _patterns(pairs: Index, n: int) -> list[Index]:
    """Return the rows below the diagonal of each column of the factor."""
    low, high = np.sort(pairs, axis=1).T
    matrix = csc_array((np.ones(len(pairs)), (high, low)), shape=(n, n))
    below: list[Index] = []
    children: list[list[int]] = [[] for _ in range(n)]
    for v in range(n):
        own = matrix.indices[matrix.indptr[v] : matrix.indptr[v + 1]]
        rows = np.unique(np.concatenate([own[own > v], *(below[child][1:] for child in children[v])]))
        below.append(rows.astype(np.int64))
        if len(rows):
            children[rows[0]].append(v)
    return below


def _postorder(parent: Index) -> Index:
    """Return the nodes of a forest, children before their parent."""
    children: list[list[int]] = [[] for _ in parent]
    for v, above in enumerate(parent.tolist()):
        if above >= 0:
            children[above].append(v)
    found, waiting = list[int](), np.flatnonzero(parent < 0).tolist()
    while waiting:
        v = waiting.pop()
        found.append(v)
        waiting += children[v]
    return np.array(found[::-1], dtype=np.int64)


def _fronts(below: Sequence[Index], begin: Index) -> tuple[_Front, ...]:
    """Join variables in postorder to fronts."""
    starts = np.array([*_front_starts(below, begin), len(below)])
    owner = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    width = np.diff(begin)
    rows = [_ranges(begin[below[last - 1]], width[below[last - 1]]) for last in starts[1:]]
    parent = [int(owner[below[last - 1][0]]) if len(below[last - 1]) else -1 for last in starts[1:]]
    children: list[list[int]] = [[] for _ in parent]
    for s, above in enumerate(parent):
        if above >= 0:
            children[above].append(s)
    fronts = []
    for s, above in enumerate(parent):
        inside = np.arange(begin[starts[above]], begin[starts[above + 1]]) if above >= 0 else rows[s]
        there = np.searchsorted(np.concatenate([inside, rows[above]]), rows[s])
        own = int(begin[starts[s]]), int(begin[starts[s + 1]])
        fronts.append(_Front(*own, rows[s], there.astype(np.int64), tuple(children[s]), above))
    return tuple(fronts)


def _front_starts(below: Sequence[Index], begin: Index) -> Iterator[int]:
    """Yield the first variable of each front."""
    width = np.diff(begin)
    height = np.array([int(width[rows].sum()) for rows in below])
    zeros = size = 0
    for v in range(len(below)):
        follows = v > 0 and len(below[v - 1]) > 0 and below[v - 1][0] == v
        more = zeros + size * (height[v] + width[v] - height[v - 1]) if follows else 0
        if follows and more <= _FILL * (size + width[v]) * (height[v] + width[v]):
            zeros, size = more, size + width[v]
        else:
            yield v
            zeros, size = 0, width[v]


@dataclass(frozen=True)
class Cholesky:
    """Factor L of a matrix L L', with columns in the order of elimination."""

    elimination: Elimination
    diagonal: Sequence[Array]
    """(p, p) lower triangle of each front."""
    below: Sequence[Array]
    """(r, p) rows below it."""

    def solve(self, right: Array) -> Array:
        """Return the solution (size, ...) for right-hand sides of this shape."""
        x = np.array(right, dtype=float)
        parts = list(zip(self.elimination.fronts, self.diagonal, self.below, strict=True))
        for front, L, B in parts:
            y = lapack.dtrtrs(L, x[front.begin : front.end], lower=1)[0]
            x[front.begin : front.end] = y
            x[front.rows] -= B @ y
        for front, L, B in reversed(parts):
            y = x[front.begin : front.end] - B.T @ x[front.rows]
            x[front.begin : front.end] = lapack.dtrtrs(L, y, lower=1, trans=1)[0]
        return x

    def covariances(self, variables: Index) -> list[Array]:
        """Return the diagonal block of the inverse of each variable."""
        at = self.elimination.begin[variables]
        found: list[Array] = [np.empty(0)] * len(at)
        for front, inverse in self._inverses():
            for k in np.flatnonzero((at >= front.begin) & (at < front.end)):
                own = slice(at[k] - front.begin, at[k] - front.begin + self.elimination.widths[variables[k]])
                found[k] = inverse[own, own].copy()
        return found

    def _inverses(self) -> Iterator[tuple[_Front, Array]]:
        """Yield the inverse on the columns of each front, parents first."""
        fronts = self.elimination.fronts
        size = np.ones(len(fronts), dtype=np.int64)
        for s, front in enumerate(fronts):
            size[s] += size[list(front.children)].sum()
        # Of the children the smallest subtree is next, so that few wait for their turn.
        on_rows = {s: np.empty((0, 0)) for s, front in enumerate(fronts) if front.parent < 0}
        waiting = list(on_rows)
        while waiting:
            s = waiting.pop()
            front, below = fronts[s], on_rows.pop(s)
            free = np.tril(lapack.dtrtri(self.diagonal[s], lower=1)[0])
            B = self.below[s] @ free
            mixed = -(below @ B)
            own = free.T @ free - B.T @ mixed
            for child in sorted(front.children, key=size.__getitem__, reverse=True):
                at = fronts[child].in_parent
                on_rows[child] = np.empty((len(at), len(at)))
                _gather(own, mixed, below, at, on_rows[child])
                waiting.append(child)
            yield front, own


def factorise(
    elimination: Elimination,
    parts: Sequence[csc_array],
    scale: Array | None = None,
    blocks: Blocks | None = None,
) -> Cholesky:
    """Factorise a symmetric matrix, the sum of ``parts`` and ``blocks``, columns in the order of elimination.

    Only lower triangles are read. ``blocks`` are computed front by front, so that they are never in memory as
    a whole. ``scale`` (size,) is the diagonal before cancellations, to which pivots are compared; that of the
    parts by default. Raises ``SingularMatrixError`` if a pivot is not positive beyond rounding.
    """
    scale = np.sum([part.diagonal() for part in parts], axis=0) if scale is None else scale
    where = np.empty(elimination.size, dtype=np.int64)
    updates: dict[int, Array] = {}
    diagonal: list[Array] = []
    below: list[Array] = []
    for s, front in enumerate(elimination.fronts):
        p, r = front.end - front.begin, len(front.rows)
        D, B, C = (np.zeros(shape, order="F") for shape in ((p, p), (r, p), (r, r)))
        where[front.rows] = np.arange(r)
        if blocks is not None:
            blocks(front.begin, front.end, where, D.T, B.T)
        for part in parts:
            _scatter(part.data, part.indices, part.indptr, front.begin, front.end, where, D.T, B.T)
        for child in front.children:
            _extend_add(D.T, B.T, C.T, updates.pop(child).T, elimination.fronts[child].in_parent)
        L, failed = lapack.dpotrf(D, lower=1, overwrite_a=1, clean=1)
        lost = np.diag(L) ** 2 <= _LOST * scale[front.begin : front.end]
        if failed or lost.any():
            column = failed - 1 if failed else int(np.argmax(lost))
            raise SingularMatrixError(elimination.variable_at(front.begin + column))
        if r:
            B = blas.dtrsm(1.0, L, B, side=1, lower=1, trans_a=1, overwrite_b=1)
            updates[s] = blas.dsyrk(-1.0, B, beta=1.0, c=C, lower=1, overwrite_c=1)
        diagonal.append(L)
        below.append(B)
    return Cholesky(elimination, diagonal, below)


# Blocks in Fortran's order are given transposed: one with a single row has both orders, and its kernel would
# be compiled anew.
@njit(cache=True)
def _scatter(
    data: Array,
    row: NDArray[np.integer[Any]],
    start: NDArray[np.integer[Any]],
    begin: int,
    end: int,
    where: Index,
    D: Array,
    B: Array,
) -> None:
    """Add the entries of the columns from ``begin`` to ``end`` to the transposed blocks of their front."""
    for j in range(begin, end):
        for e in range(start[j], start[j + 1]):
            i = row[e]
            if i >= end:
                B[j - begin, where[i]] += data[e]
            elif i >= j:
                D[j - begin, i - begin] += data[e]


@njit(cache=True)
def _extend_add(D: Array, B: Array, C: Array, update: Array, at: Index) -> None:
    """Add the lower triangle of a child to the places ``at`` of its parent's blocks, all transposed."""
    p = len(D)
    for b in range(len(at)):
        j = at[b]
        for a in range(b, len(at)):
            i = at[a]
            if i < p:
                D[j, i] += update[b, a]
            elif j < p:
                B[j, i - p] += update[b, a]
            else:
                C[j - p, i - p] += update[b, a]


@njit(cache=True)
def _gather(own: Array, mixed: Array, below: Array, at: Index, part: Array) -> None:
    """Fill in the part ``at`` of a symmetric matrix with the blocks [own, mixed'; mixed, below]."""
    p = len(own)
    for a in range(len(at)):
        for b in range(a + 1):
            i, j = max(at[a], at[b]), min(at[a], at[b])
            part[a, b] = own[i, j] if i < p else mixed[i - p, j] if j < p else below[i - p, j - p]
            part[b, a] = part[a, b]
