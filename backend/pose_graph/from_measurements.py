"""Convert a flight's measurements to a problem, and validate every value before gtsam gets it."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from backend import se3
from backend.errors import BackendError
from backend.measurements import EdgeKind, Measurements, RelativePose
from backend.pose_graph import unary_factors
from backend.pose_graph.graph import NOT_RIGID
from backend.pose_graph.problem import Problem, square_roots
from backend.pose_graph.unary_factors import UnaryFactor

Array = NDArray[np.float64]

_BODY_UP = np.array([0.0, 0.0, 1.0])
_KINDS = get_args(EdgeKind)
_AT_ONCE = 1_000
"""Number of edges per block."""


def from_measurements(measurements: Measurements, initial: Array | None) -> tuple[Problem, list[str]]:
    """Return the problem of a flight and warnings about dropped measurements.

    It holds relative poses, attitudes, ranges and positions. The other kinds are of the refinement alone
    (`backend.bundle`), and positions count as those of the body's origin, wherever the antenna is.
    Raises ``BackendError`` for invalid values.
    """
    n = measurements.count
    if n == 0:
        raise BackendError("there is no keyframe: nothing to solve")
    names = tuple(f"keyframe {name}" for name in measurements.names) or tuple(
        f"keyframe {k}" for k in range(n)
    )
    if len(names) != n:
        raise BackendError(f"{len(names)} names for {n} keyframes; give one each or none")
    if initial is not None and initial.shape != (n, 4, 4):
        raise BackendError(f"the start has shape {initial.shape} instead of ({n}, 4, 4)")
    for kind in (measurements.attitudes, measurements.ranges, measurements.positions):
        for single in kind:
            if not 0 <= single.k < n:
                raise BackendError(f"a measurement names keyframe {single.k} of {n}")
    edges = measurements.relative_poses
    _check_fields(edges)
    problem = Problem(
        dimension=3,
        names=names,
        i=np.array([e.i for e in edges], dtype=np.int64),
        j=np.array([e.j for e in edges], dtype=np.int64),
        ij_T=_rigid(edges, n),
        sqrt_information=_roots(edges),
        trusted=np.array([e.kind != "loop" for e in edges], dtype=bool),
        initial=np.full((n, 4, 4), np.nan) if initial is None else initial,
        unary_factors=(),
        length_unit=measurements.length_unit,
    )
    singles, warnings = _unary_factors(measurements)
    return replace(problem, unary_factors=singles), warnings


def _check_fields(edges: tuple[RelativePose, ...]) -> None:
    """Raise ``BackendError`` for an edge with a field of another shape, or of an unknown kind."""
    for e in edges:
        if e.kind not in _KINDS:
            raise BackendError(
                f"relative pose {e.i}-{e.j}: kind is {e.kind!r}; expected one of {', '.join(_KINDS)}"
            )
        for name, value, side in (("i_T_j", e.i_T_j, 4), ("covariance", e.covariance, 6)):
            if np.shape(value) != (side, side):
                raise BackendError(
                    f"relative pose {e.i}-{e.j}: {name} has shape {np.shape(value)}; "
                    f"expected ({side}, {side})"
                )


def _rigid(edges: tuple[RelativePose, ...], n: int) -> Array:
    T = np.array([e.i_T_j for e in edges], dtype=np.float64).reshape(-1, 4, 4)
    for e in edges:
        if not (0 <= e.i < n and 0 <= e.j < n) or e.i == e.j:
            raise BackendError(f"an edge ({e.kind}) joins keyframes {e.i} and {e.j} of {n}; drop it")
    finite = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    R = np.where(finite[:, None, None], T[:, :3, :3], np.eye(3))
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0)
    bad = np.flatnonzero(~finite | (off > NOT_RIGID) | (np.linalg.det(R) < 0))
    if len(bad):
        raise BackendError(
            f"{_edge(edges[bad[0]])} is not a finite rigid transform ({len(bad)} such); drop it"
        )
    T = T.copy()
    T[:, :3, :3] = se3.nearest_rotations(R) if len(T) else R
    T[:, 3] = [0, 0, 0, 1]
    return T


def _roots(edges: tuple[RelativePose, ...]) -> Array:
    covariance = np.array([e.covariance for e in edges], dtype=np.float64).reshape(-1, 6, 6)
    # Validation needs ten times the memory of its input.
    blocks = [covariance[k : k + _AT_ONCE] for k in range(0, max(1, len(edges)), _AT_ONCE)]
    bad = np.flatnonzero(np.concatenate([_not_positive(block) for block in blocks]))
    if len(bad):
        raise BackendError(
            f"{_edge(edges[bad[0]])} has a covariance that is not symmetric positive definite"
            f" ({len(bad)} such); drop it or mend its covariance"
        )
    return np.concatenate([_root(block) for block in blocks])


def _not_positive(covariance: Array) -> NDArray[np.bool_]:
    finite = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    scale, unit = _scaled(np.where(finite[:, None, None], covariance, np.eye(6)))
    skew = np.abs(unit - np.swapaxes(unit, 1, 2)).max(axis=(1, 2), initial=0)
    lowest = np.linalg.eigvalsh((unit + np.swapaxes(unit, 1, 2)) / 2)[:, 0]
    return np.asarray(~finite | (skew > 1e-6) | (lowest < 1e-12) | (scale < 1e-12).any(axis=1))


def _root(covariance: Array) -> Array:
    scale, unit = _scaled(covariance)
    information: Array = np.asarray(np.linalg.inv((unit + np.swapaxes(unit, 1, 2)) / 2), dtype=np.float64)
    return square_roots(information) / scale[:, None, :]


def _scaled(covariance: Array) -> tuple[Array, Array]:
    """Return (m, 6) standard deviations and the correlation matrices: radians and metres differ in size."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-300))
    return scale, covariance / (scale[:, :, None] * scale[:, None, :])


def _edge(edge: RelativePose) -> str:
    return f"the {edge.kind} edge {edge.i}-{edge.j}"


def _unary_factors(measurements: Measurements) -> tuple[tuple[UnaryFactor, ...], list[str]]:
    singles: list[UnaryFactor | None] = []
    unusable = 0
    up: dict[int, Array] = {}
    for a in measurements.attitudes:
        _check_std(a.std_rad, "attitude", a.k)
        single = unary_factors.attitude(a)
        if single is not None and single.w_R_b is not None:
            up[a.k] = single.w_R_b[2]
        singles.append(single)
    for r in measurements.ranges:
        if not (np.isfinite(r.range_m) and r.range_m > 0):
            unusable += 1
            continue
        _check_std(np.array([r.std_m]), "range", r.k)
        if np.isfinite(r.std_m):
            cos_tilt = float(up.get(r.k, _BODY_UP) @ r.b_T_s[:3, 2])
            singles.append(unary_factors.slant_range(r, max(cos_tilt, 0.1)))
    for p in measurements.positions:
        _check_std(p.std_m, "position", p.k)
        singles.append(unary_factors.position(p, measurements.antenna_m))
    unusable += sum(single is None for single in singles)
    messages = [f"{unusable} attitudes, ranges or positions without a usable figure were left out"]
    return tuple(single for single in singles if single is not None), messages if unusable else []


def _check_std(std: Array, kind: str, k: int) -> None:
    if not (np.asarray(std) > 0).all():
        raise BackendError(
            f"the {kind} of keyframe {k} has a standard deviation that is not above zero: {std}"
        )


def components(problem: Problem) -> NDArray[np.int64]:
    """Return (n,) component numbers of the poses: 0 is the largest; equal sizes in order of first pose."""
    n = problem.count
    links = coo_array((np.ones(len(problem.i)), (problem.i, problem.j)), shape=(n, n))
    count, label = connected_components(links, directed=False)
    size = np.bincount(label, minlength=count)
    first = np.full(count, n)
    np.minimum.at(first, label, np.arange(n))
    rank = np.empty(count, dtype=np.int64)
    rank[np.lexsort((first, -size))] = np.arange(count)
    return rank[label]
