"""Gauge freedom: find the directions that no measurement fixes in the world, and fix them with a prior."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from backend.errors import format_ranges

Array = NDArray[np.float64]

GAUGE_STD = 1e-6
"""Standard deviation, in rad and m, of the prior on a direction that nothing measures."""

_DIRECTIONS = ("roll", "pitch", "heading", "x", "y", "height")
_ROTATION_STD_RAD = 1.0
_POSITION_STD_M = 1e4
SYMBOL_SHIFT = 56
_PLURAL = {"vertex": "vertices"}


def key_name(key: int) -> str:
    """Return the name of a key: ``keyframe 7`` for 7 and for the symbol x7, else the symbol itself."""
    letter, number = key >> SYMBOL_SHIFT, key & ((1 << SYMBOL_SHIFT) - 1)
    return f"keyframe {number}" if letter in (0, ord("x")) else f"{chr(letter)}{number}"


def format_keys(keys: Iterable[int], name: Callable[[int], str] = key_name) -> str:
    """Format keys as a list of ranges: ``keyframes 0-57, 60``."""
    keys = sorted(keys)
    if len(keys) == 1:
        return name(keys[0])
    groups: dict[str, list[int]] = {}
    split = [name(key).rpartition(" ") for key in keys]
    if len({word for word, _, _ in split}) == 1 and all(number.isdigit() for _, _, number in split):
        groups[split[0][0]] = [int(number) for _, _, number in split]
    else:
        for key, (word, _, number) in zip(keys, split, strict=True):
            if number.isdigit():
                groups.setdefault(word, []).append(int(number))
            else:
                groups.setdefault(name(key), [])
    messages = [
        f"{_PLURAL.get(word, word + 's')} {format_ranges(numbers)}" if numbers else word
        for word, numbers in groups.items()
    ]
    return ", ".join(messages[:6]) + (f" and {len(messages) - 6} more" if len(messages) > 6 else "")


@dataclass(frozen=True)
class GraphComponents:
    """Connected components of a factor graph, as lists of keys."""

    parts: list[list[int]]
    floating: list[list[int]]
    """Components without a unary factor: nothing fixes them in the world."""


def graph_components(graph: gtsam.NonlinearFactorGraph) -> GraphComponents:
    """Find the connected components of a graph, and those that no unary factor fixes."""
    touched = [list(f.keys()) for f in (graph.at(k) for k in range(graph.size())) if f is not None]
    keys, flat = np.unique(
        np.array([key for t in touched for key in t], dtype=np.uint64), return_inverse=True
    )
    if len(keys) == 0:
        return GraphComponents([], [])
    sizes = np.array([len(t) for t in touched])
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    owner = np.repeat(flat[first[sizes > 0]], sizes[sizes > 0])
    shape = (len(keys), len(keys))
    count, label = connected_components(coo_array((np.ones(len(flat)), (owner, flat)), shape=shape), False)
    tied = np.zeros(count, dtype=bool)
    tied[label[flat[first[sizes == 1]]]] = True
    order = np.argsort(label, kind="stable")
    parts = [part.tolist() for part in np.split(keys[order], np.cumsum(np.bincount(label))[:-1])]
    return GraphComponents(parts, [part for part, t in zip(parts, tied, strict=True) if not t])


def unobserved_directions(jacobians: list[Array]) -> Array:
    """Return the rigid motions of a component that its unary factors do not observe.

    ``jacobians`` are whitened (r, 6) derivatives by a motion of the whole component, all about the same
    point in world axes, rotation first. Returns orthonormal rows (d, 6) of such motions. A direction
    counts as unobserved if its standard deviation would exceed 1 rad or 10 km: a solver would drift
    along it.
    """
    information = np.zeros((6, 6))
    for J in jacobians:
        information += J.T @ J
    scale = np.array([_ROTATION_STD_RAD] * 3 + [_POSITION_STD_M] * 3)
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale)
    rows = vectors[:, values < 1].T / scale
    return np.linalg.qr(rows.T)[0].T if len(rows) else rows


def gauge_prior(key: int, pose: Array, directions: Array, std: float = GAUGE_STD) -> gtsam.NonlinearFactor:
    """Return a prior on a pose (4, 4) along the directions (d, 6) of motion about it, and along no other."""
    R = pose[:3, :3]
    rows = np.zeros((6, 6))
    # World axes to body axes: xi_w = blkdiag(R, R) xi_b. Zero rows leave the other directions free.
    rows[: len(directions), :3] = directions[:, :3] @ R
    rows[: len(directions), 3:] = directions[:, 3:] @ R
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(rows / std, False)
    return gtsam.PriorFactorPose3(key, gtsam.Pose3(pose), noise)


def format_directions(directions: Array) -> str:
    """Name the directions of motions (d, 6), rotation first: ``x, y and heading``."""
    part = np.abs(directions) > 0.3 * np.abs(directions).max(axis=1, keepdims=True)
    words = [word for word, used in zip(_DIRECTIONS, part.any(axis=0), strict=True) if used]
    words = words[3:] + words[:3] if len(words) == 6 else words
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + f" and {words[-1]}"
