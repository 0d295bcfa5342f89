"""Observability: the null space of the linearised system, described in sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array, eye_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

from backend import se3
from backend.gauge import format_keys, graph_components, key_name
from backend.pose_graph.graph import MIN_INFORMATION
from backend.pose_graph.linear import jacobian

Array = NDArray[np.float64]

_MAX_DENSE_SIZE = 1200
_ZERO_EIGENVALUE = 1e-10
"""Eigenvalue of the normal matrix with unit diagonal below which a direction counts as unobserved."""
_MAX_DIRECTIONS = 14
_GENERATORS = ("roll", "pitch", "heading", "x", "y", "height", "scale")


def unobserved(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, name: Callable[[int], str] = key_name
) -> list[str]:
    """Return sentences about the directions that no measurement observes at ``values``.

    Rigid motions in world axes about the mean position, and the scale, are recognised per connected
    component; remaining directions are described by the variables that take part.
    """
    return open_directions(null_space(jacobian(graph, values)), values, graph_components(graph).parts, name)


def open_directions(
    null: Array, values: gtsam.Values, parts: Sequence[Sequence[int]], name: Callable[[int], str] = key_name
) -> list[str]:
    """Return sentences about directions (dim, k) in the columns by key; ``parts`` are the connected ones."""
    if null.shape[1] == 0:
        return []
    null = _orthonormal(null)
    keys, dims = sorted(values.keys()), values.dims()
    width = np.array([dims[key] for key in keys])
    start = np.concatenate([[0], np.cumsum(width)])
    where = {key: slice(start[k], start[k + 1]) for k, key in enumerate(keys)}
    sentences = []
    for part in parts:
        G = _generators(values, part, where, start[-1])
        norm = np.linalg.norm(G, axis=0)
        G = G[:, norm > 0] / norm[norm > 0]
        words = [w for w, n in zip(_GENERATORS, norm, strict=True) if n > 0]
        inside = np.linalg.norm(null.T @ G, axis=0) > 0.999
        if inside.any():
            names = ", ".join(word for word, yes in zip(words, inside, strict=True) if yes)
            sentences.append(f"{names} of {format_keys(part, name)} not observed")
            null = _without(null, np.linalg.qr(G[:, inside])[0])
        if "scale" in words:
            # A fixed pose moves the centre of the scale: its null vector then includes a translation.
            share = np.linalg.lstsq(G, null, rcond=None)[0]
            whole = np.linalg.norm(G @ share - null, axis=0) < 1e-3
            grows = whole & (np.abs(share[words.index("scale")]) > 0.05)
            if grows.any():
                sentences.append(f"scale of {format_keys(part, name)} not observed")
                null = null[:, ~grows]
    if null.shape[1]:
        share = np.array([np.linalg.norm(null[where[key]]) for key in keys])
        some = [key for key, s in zip(keys, share, strict=True) if s > 0.1 * share.max()]
        plural = "direction" if null.shape[1] == 1 else "directions"
        sentences.append(f"{null.shape[1]} {plural} around {format_keys(some, name)} not observed")
    return sentences


def null_space(J: csc_array) -> Array:
    """Return orthonormal directions (dim, k) that do not change residuals of this Jacobian; at most 14.

    Rows are first brought to unit length, so that one very accurate measurement does not make the others look
    like rounding errors, then columns, so that radians and metres compare. Dense below 1200 unknowns,
    shift-invert Lanczos above.
    """
    dim = J.shape[1]
    size = np.sqrt(np.asarray(J.multiply(J).sum(axis=1)).ravel())
    J = csc_array(diags_array(1 / np.maximum(size, np.sqrt(MIN_INFORMATION))) @ J)
    length = np.sqrt(np.asarray(J.multiply(J).sum(axis=0)).ravel())
    length[length == 0] = 1
    scaled = J @ diags_array(1 / length)
    H = csc_array(scaled.T @ scaled)
    if dim <= _MAX_DENSE_SIZE:
        eigenvalues, vectors = np.linalg.eigh(H.toarray())
    else:
        eigenvalues, vectors = _smallest(H)
    open_ = eigenvalues < _ZERO_EIGENVALUE
    null = vectors[:, open_] / length[:, None]
    return _orthonormal(np.linalg.qr(null)[0])


def _smallest(H: csc_array) -> tuple[Array, Array]:
    dim = H.shape[0]
    factor = splu(csc_array(H + 1e-9 * eye_array(dim)))
    operator = LinearOperator((dim, dim), matvec=factor.solve, dtype=np.float64)
    try:
        # Without isolated small eigenvalues Lanczos does not converge: then nothing is named.
        inverse, vectors = eigsh(operator, k=_MAX_DIRECTIONS, which="LM", v0=np.ones(dim), maxiter=20)
    except ArpackError:
        return np.zeros(0), np.zeros((dim, 0))
    return 1 / inverse - 1e-9, vectors


def _without(null: Array, basis: Array) -> Array:
    return _orthonormal(null - basis @ (basis.T @ null))


def _orthonormal(A: Array) -> Array:
    """Return a basis of the column space without directions that are rounding errors."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return U[:, s > 1e-3]


def _generators(values: gtsam.Values, part: Sequence[int], where: dict[int, slice], dim: int) -> Array:
    """Return tangent vectors (dim, 7) of the rigid motions and the scale change of one component."""
    G = np.zeros((dim, 7))
    poses = {key: values.atPose3(key).matrix() for key in part if _has_type(values.atPose3, key)}
    flat = {key: values.atPose2(key) for key in part if key not in poses and _has_type(values.atPose2, key)}
    points = {key: np.asarray(values.atPoint3(key)) for key in part if _has_type(values.atPoint3, key)}
    places = [T[:3, 3] for T in poses.values()] + [np.array([p.x(), p.y(), 0]) for p in flat.values()]
    places += list(points.values())
    if not places:
        return G
    center = np.eye(4)
    center[:3, 3] = np.mean(places, axis=0)
    for key, T in poses.items():
        G[where[key], :6] = se3.adjoint(se3.inverse(T) @ center)
        G[where[key], 6][3:] = T[:3, :3].T @ (T[:3, 3] - center[:3, 3])
    for key, pose in flat.items():
        T = se3.from_planar(np.array([[pose.x(), pose.y(), pose.theta()]]))[0]
        rows = se3.adjoint(se3.inverse(T) @ center)[[3, 4, 2]]
        G[where[key], 2:5] = rows[:, 2:5]
        G[where[key], 6][:2] = (T[:3, :3].T @ (T[:3, 3] - center[:3, 3]))[:2]
    for key, p in points.items():
        arm = p - center[:3, 3]
        G[where[key], :3], G[where[key], 3:6] = -se3.cross_matrix(arm), np.eye(3)
        G[where[key], 6] = arm
    return G


def _has_type(read: Callable[[int], object], key: int) -> bool:
    try:
        read(key)
    except (RuntimeError, ValueError, IndexError):
        return False
    return True
