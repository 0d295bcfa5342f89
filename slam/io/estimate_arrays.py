"""The arrays of ``estimate.npz``: their shapes, and what is refused."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from slam.core.floor_points import FloorPoints

Array = NDArray[np.float64]

_LARGEST_EXPANSION = 20
"""Largest ratio of unpacked to file size. We store without compression, so a larger ratio is an attack."""
_MIN_LIMIT_BYTES = 1 << 26
_MAX_COORDINATE_M = 1e12
"""Largest coordinate. At larger ones, squares lose all digits of near points; no flight reaches them."""
_RIGID_TOLERANCE = 1e-6

ANY = -1
"""Size of an axis that differs from file to file."""
SHAPES: dict[str, tuple[str, tuple[int, ...], str]] = {
    "stamps": ("n", (), "i"),
    "w_T_b": ("n", (4, 4), "f"),
    "covariances": ("n", (6, 6), "f"),
    "over_floor_covariances": ("n", (6, 6), "f"),
    "ground_covariances": ("g", (6, 6), "f"),
    "joint_errors": ("s", (6, ANY), "f"),
    "row_motion": ("r", (3,), "f"),
    "row_turn": ("u", (3,), "f"),
    "chain_w_T_b": ("n", (4, 4), "f"),
    "odometry_w_T_b": ("n", (4, 4), "f"),
    "component": ("n", (), "i"),
    "frame_index": ("n", (), "i"),
    "frame_names": ("n", (), "U"),
    "edge_ij": ("m", (2,), "i"),
    "edge_i_T_j": ("m", (4, 4), "f"),
    "edge_covariance": ("m", (6, 6), "f"),
    "edge_kind": ("m", (), "U"),
    "loop_ij": ("l", (2,), "i"),
    "loop_verdict": ("l", (), "U"),
    "loop_reason": ("l", (), "U"),
    "point_keyframe": ("t", (), "i"),
    "point_b_p_m": ("t", (3,), "f"),
    "point_views": ("t", (), "i"),
    "point_std_m": ("t", (3,), "f"),
}
"""Map of a name to the size of its first axis, the shape of a row, and the kind of number."""
NO_POINTS = FloorPoints.joined(())
POINTS = {
    "point_keyframe": NO_POINTS.keyframe,
    "point_b_p_m": NO_POINTS.b_p_m,
    "point_views": NO_POINTS.views,
    "point_std_m": NO_POINTS.std_m,
}
LATER = {
    **POINTS,
    "ground_covariances": np.zeros((0, 6, 6)),
    "joint_errors": np.zeros((0, 6, 0)),
    "row_motion": np.zeros((0, 3)),
    "row_turn": np.zeros((0, 3)),
}
"""Arrays that files of earlier versions lack -> what stands for them; an empty one for what is not known."""


def unpacked(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file, those of `LATER` where it lacks them.

    Raises what ``zipfile`` and ``numpy`` raise, and ``ValueError`` where an array is missing, has another
    shape, or expands out of proportion.
    """
    size = os.path.getsize(path)
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        if len(entries) > 2 * len(SHAPES):
            raise ValueError(f"{len(entries)} entries")
        missing = [name for name in (*SHAPES, "record") if name not in entries and name not in LATER]
        if missing:
            raise ValueError(f"{missing[0]} is missing")
        wanted = {name: entries[name] for name in (*SHAPES, "record") if name in entries}
        total = sum(entry.file_size for entry in wanted.values())
        if total > max(_MIN_LIMIT_BYTES, _LARGEST_EXPANSION * size):
            raise ValueError(f"unpacks to {total} bytes from {size}")
        # Reading an entry completely makes zipfile compare the checksum.
        arrays = {name: _array(archive.read(entry)) for name, entry in wanted.items()}
    if not POINTS.keys() <= arrays.keys():
        arrays |= POINTS
    arrays = {**LATER, **arrays}
    _check(arrays)
    return arrays


def _array(content: bytes) -> NDArray[Any]:
    file = io.BytesIO(content)
    version = npy.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"array format {version}")
    shape, _, dtype = (
        npy.read_array_header_1_0(file) if version == (1, 0) else npy.read_array_header_2_0(file)
    )
    # The declared size is compared with the actual one before an array of that size is allocated.
    if dtype.hasobject or dtype.itemsize * int(np.prod(shape, dtype=object)) != len(content) - file.tell():
        raise ValueError("an array has another length than declared, or is pickled")
    file.seek(0)
    return npy.read_array(file, allow_pickle=False)


def _check(arrays: dict[str, NDArray[Any]]) -> None:
    rows = {
        "n": len(arrays["stamps"]),
        "m": len(arrays["edge_ij"]),
        "l": len(arrays["loop_ij"]),
        "t": len(arrays["point_keyframe"]),
        "g": len(arrays["stamps"]) if len(arrays["ground_covariances"]) else 0,
        "s": len(arrays["stamps"]) if len(arrays["joint_errors"]) else 0,
        "r": len(arrays["stamps"]) if len(arrays["row_motion"]) else 0,
        "u": len(arrays["stamps"]) if len(arrays["row_turn"]) else 0,
    }
    for name, (per, row, kind) in SHAPES.items():
        found = arrays[name]
        row = tuple(
            found.shape[k] if size == ANY and k < found.ndim else size for k, size in enumerate(row, 1)
        )
        if found.shape != (rows[per], *row) or found.dtype.kind != kind:
            raise ValueError(f"{name} has shape {found.shape} and type {found.dtype}")
    for name in ("w_T_b", "chain_w_T_b", "odometry_w_T_b", "edge_i_T_j"):
        if not _is_rigid(arrays[name]):
            raise ValueError(f"{name} contains an invalid pose")
    for name in ("edge_ij", "loop_ij", "point_keyframe"):
        if len(arrays[name]) and not (arrays[name].min() >= 0 and arrays[name].max() < rows["n"]):
            raise ValueError(f"{name} refers to a missing keyframe")


def _is_rigid(T: Array) -> bool:
    """Return whether every finite (n, 4, 4) transform is a rotation and a translation."""
    T = T[np.isfinite(T).all(axis=(1, 2))]
    if np.abs(T).max(initial=0.0) > _MAX_COORDINATE_M or not (T[:, 3] == (0, 0, 0, 1)).all():
        return False
    R = T[:, :3, :3]
    return np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), rtol=0, atol=_RIGID_TOLERANCE)
