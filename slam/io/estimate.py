"""Files of an estimate: trajectory.tum, estimate.npz and loops.csv.

``estimate.npz`` contains the complete estimate; the other two files are for other tools and readers. Its
arrays for n keyframes, m edges, l loops and t points of the ground are:

| name | shape, type | what |
|---|---|---|
| stamps | (n,) int64 | nanoseconds on the recorder's clock |
| w_T_b, chain_w_T_b, odometry_w_T_b | (n, 4, 4) | NaN where not placed |
| covariances | (n, 6, 6) | rotation first, right perturbation; NaN where unknown |
| component, frame_index | (n,) int64 | |
| frame_names | (n,) text | |
| edge_ij, edge_i_T_j, edge_covariance, edge_kind | (m, 2) int64, (m, 4, 4), (m, 6, 6), (m,) text | |
| loop_ij, loop_verdict, loop_reason | (l, 2) int64, (l,) text, (l,) text | |
| point_keyframe, point_views | (t,) int64 | points of the ground; none in files of earlier versions |
| point_b_p_m, point_std_m | (t, 3) | in the body axes of that keyframe; along the axes of the world |
| record | () text | JSON: name, status, epoch_ns, camera, floor, origin, counts, warnings |

Objects are never pickled, and pickled content is refused.
"""

from __future__ import annotations

import io
import json
import os
import tokenize
import zipfile
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from backend.measurements import RelativePose
from backend.pose_graph.solution import RangeErrors
from backend.triple import triple
from frontend.camera import Camera
from slam.core.control_points import ControlReport, PointResidual
from slam.core.errors import InputError
from slam.core.estimate import MAP_TRAJECTORIES, Estimate, GroundFacts, LoopVerdict
from slam.core.floor_points import FloorPoints
from slam.core.geodesy import GeoOrigin
from slam.core.messages import by_kind, with_notes
from slam.io.atomic import write_whole
from slam.io.estimate_text import loops_text, trajectory_text
from slam.io.files import brief

Array = NDArray[np.float64]

_LARGEST_EXPANSION = 20
"""Largest ratio of unpacked to file size. We store without compression, so a larger ratio is an attack."""
_MIN_LIMIT_BYTES = 1 << 26
_MAX_COORDINATE_M = 1e12
"""Largest coordinate. At larger ones, squares lose all digits of near points; no flight reaches them."""
_RIGID_TOLERANCE = 1e-6

_SHAPES: dict[str, tuple[str, tuple[int, ...], str]] = {
    "stamps": ("n", (), "i"),
    "w_T_b": ("n", (4, 4), "f"),
    "covariances": ("n", (6, 6), "f"),
    "over_floor_covariances": ("n", (6, 6), "f"),
    "ground_covariances": ("g", (6, 6), "f"),
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
_NO_POINTS = FloorPoints.joined(())
_POINTS = {
    "point_keyframe": _NO_POINTS.keyframe,
    "point_b_p_m": _NO_POINTS.b_p_m,
    "point_views": _NO_POINTS.views,
    "point_std_m": _NO_POINTS.std_m,
}
_LATER = {**_POINTS, "ground_covariances": np.zeros((0, 6, 6))}
"""Arrays that files of earlier versions lack -> what stands for them; an empty one for what is not known."""


def write_estimate(estimate: Estimate, out_dir: str | Path, loops: bool = True) -> tuple[Path, ...]:
    """Write the three files into a folder (two without a search for loops) and return their paths.

    Raises ``InputError`` if the folder cannot be written.
    """
    out_dir = Path(out_dir)
    contents = {
        "trajectory.tum": trajectory_text(estimate).encode(),
        "estimate.npz": _pack(estimate),
    }
    if loops:
        contents["loops.csv"] = loops_text(estimate).encode("utf-8")
    for name, content in contents.items():
        write_whole(out_dir / name, content)
    return tuple(out_dir / name for name in contents)


def _pack(estimate: Estimate) -> bytes:
    edges, loops, points = estimate.relative_poses, estimate.loops, estimate.floor_points or _NO_POINTS
    ground = estimate.ground_covariances
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        stamps=estimate.stamps_ns,
        w_T_b=estimate.w_T_b,
        covariances=estimate.covariances,
        over_floor_covariances=estimate.over_floor_covariances,
        ground_covariances=_LATER["ground_covariances"] if ground is None else ground,
        chain_w_T_b=estimate.chain_w_T_b,
        odometry_w_T_b=estimate.odometry_w_T_b,
        component=np.asarray(estimate.component, dtype=np.int64),
        frame_index=np.asarray(estimate.frame_index, dtype=np.int64),
        frame_names=np.array(estimate.frame_names, dtype=np.str_),
        edge_ij=np.array([(e.i, e.j) for e in edges], dtype=np.int64).reshape(-1, 2),
        edge_i_T_j=np.array([e.i_T_j for e in edges], dtype=float).reshape(-1, 4, 4),
        edge_covariance=np.array([e.covariance for e in edges], dtype=float).reshape(-1, 6, 6),
        edge_kind=np.array([e.kind for e in edges], dtype=np.str_),
        loop_ij=np.array([(v.i, v.j) for v in loops], dtype=np.int64).reshape(-1, 2),
        loop_verdict=np.array([v.verdict for v in loops], dtype=np.str_),
        loop_reason=np.array([v.reason for v in loops], dtype=np.str_),
        point_keyframe=points.keyframe,
        point_b_p_m=points.b_p_m,
        point_views=points.views,
        point_std_m=points.std_m,
        record=np.array(json.dumps(_record(estimate))),
    )
    return content.getvalue()


def _record(estimate: Estimate) -> dict[str, Any]:
    camera = estimate.camera
    return {
        "name": estimate.name,
        "status": estimate.status,
        "epoch_ns": int(estimate.epoch_ns),
        "camera": None if camera is None else {**asdict(camera), "b_T_c": camera.b_T_c.tolist()},
        "floor_z_m": float(estimate.floor_z_m),
        "floor_slope_rad": [float(angle) for angle in estimate.floor_slope_rad],
        "scale_std": None if estimate.scale_std is None else float(estimate.scale_std),
        "middle_std_m": None if estimate.middle_std_m is None else float(estimate.middle_std_m),
        "metric": bool(estimate.metric),
        "range_errors": None if estimate.range_errors is None else asdict(estimate.range_errors),
        "antenna_m": None if estimate.antenna_m is None else list(estimate.antenna_m),
        "origin": None if estimate.origin is None else asdict(estimate.origin),
        "frames": int(estimate.frames),
        "rejected": estimate.rejected,
        "not_placed": estimate.not_placed,
        "not_drawn": estimate.not_drawn,
        "timing_s": estimate.timing_s,
        "warnings": list(estimate.warnings),
        "notes": list(by_kind(estimate.warnings).notes),
        "graph_error": float(estimate.graph_error),
        "iterations": int(estimate.iterations),
        "ways": list(estimate.trajectory_names),
        "accuracy_basis": estimate.accuracy_basis,
        "information_shares": {name: dict(shares) for name, shares in estimate.information_shares.items()},
        "control": None if estimate.control is None else asdict(estimate.control),
        "ground": None if estimate.ground is None else asdict(estimate.ground),
    }


def read_estimate(out_dir: str | Path) -> Estimate:
    """Rebuild an estimate from a folder written by ``write_estimate``. Only estimate.npz is read.

    Raises ``InputError`` if the file is missing, damaged, of another shape, or expands out of proportion.
    """
    path = Path(out_dir) / "estimate.npz"
    if not path.is_file():
        raise InputError(f"{path}: does not exist; name the folder that `slam optimize --out` wrote")
    try:
        arrays = _unpack(path)
        return replace(_estimate(arrays, json.loads(str(arrays["record"]))), folder=Path(out_dir))
    except (OSError, EOFError, MemoryError, OverflowError, RecursionError) as error:
        raise _damaged_error(path, error) from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise _damaged_error(path, error) from None
    except (ValueError, LookupError, TypeError, AttributeError, SyntaxError, tokenize.TokenError) as error:
        raise _damaged_error(path, error) from None


def _damaged_error(path: Path, error: Exception) -> InputError:
    detail = brief(" ".join(str(error).split())) or type(error).__name__
    return InputError(f"{path}: damaged or not an estimate ({detail}); run `slam optimize` again")


def _unpack(path: Path) -> dict[str, NDArray[Any]]:
    size = os.path.getsize(path)
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        if len(entries) > 2 * len(_SHAPES):
            raise ValueError(f"{len(entries)} entries")
        missing = [name for name in (*_SHAPES, "record") if name not in entries and name not in _LATER]
        if missing:
            raise ValueError(f"{missing[0]} is missing")
        wanted = {name: entries[name] for name in (*_SHAPES, "record") if name in entries}
        total = sum(entry.file_size for entry in wanted.values())
        if total > max(_MIN_LIMIT_BYTES, _LARGEST_EXPANSION * size):
            raise ValueError(f"unpacks to {total} bytes from {size}")
        # Reading an entry completely makes zipfile compare the checksum.
        arrays = {name: _array(archive.read(entry)) for name, entry in wanted.items()}
    if not _POINTS.keys() <= arrays.keys():
        arrays |= _POINTS
    arrays = {**_LATER, **arrays}
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
    }
    for name, (per, row, kind) in _SHAPES.items():
        found = arrays[name]
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


def _estimate(arrays: dict[str, NDArray[Any]], record: dict[str, Any]) -> Estimate:
    epoch_ns, camera, origin = int(record["epoch_ns"]), record["camera"], record["origin"]
    edges = zip(
        arrays["edge_ij"].tolist(),
        arrays["edge_i_T_j"],
        arrays["edge_covariance"],
        arrays["edge_kind"].tolist(),
        strict=True,
    )
    loops = zip(
        arrays["loop_ij"].tolist(),
        arrays["loop_verdict"].tolist(),
        arrays["loop_reason"].tolist(),
        strict=True,
    )
    return Estimate(
        name=str(record["name"]),
        status=str(record["status"]),
        epoch_ns=epoch_ns,
        stamps_s=(arrays["stamps"] - epoch_ns) / 1e9,
        frame_names=tuple(arrays["frame_names"].tolist()),
        frame_index=arrays["frame_index"],
        w_T_b=arrays["w_T_b"],
        covariances=arrays["covariances"],
        over_floor_covariances=arrays["over_floor_covariances"],
        ground_covariances=arrays["ground_covariances"] if len(arrays["ground_covariances"]) else None,
        component=arrays["component"],
        camera=None if camera is None else _camera(camera),
        floor_z_m=float(record["floor_z_m"]),
        floor_slope_rad=(float(record["floor_slope_rad"][0]), float(record["floor_slope_rad"][1])),
        scale_std=_number(record, "scale_std"),
        middle_std_m=_number(record, "middle_std_m"),
        metric=bool(record.get("metric", True)),
        range_errors=_range_errors(record),
        antenna_m=_antenna_m(record),
        origin=None if origin is None else GeoOrigin(**origin),
        relative_poses=tuple(RelativePose(i, j, T, P, kind) for (i, j), T, P, kind in edges),
        loops=tuple(LoopVerdict(i, j, verdict, reason) for (i, j), verdict, reason in loops),
        chain_w_T_b=arrays["chain_w_T_b"],
        odometry_w_T_b=arrays["odometry_w_T_b"],
        frames=int(record["frames"]),
        rejected=dict(record["rejected"]),
        not_placed=dict(record.get("not_placed", {})),
        not_drawn=dict(record.get("not_drawn", {})),
        timing_s=dict(record["timing_s"]),
        warnings=with_notes(record["warnings"], record.get("notes", ())),
        graph_error=float(record["graph_error"]),
        iterations=int(record["iterations"]),
        trajectory_names=_trajectory_names(record),
        accuracy_basis=str(record.get("accuracy_basis", "")),
        information_shares=_shares(record),
        ground=_ground(record),
        control=_control(record),
        floor_points=_points(arrays),
    )


def _points(arrays: dict[str, NDArray[Any]]) -> FloorPoints | None:
    found = [arrays[name] for name in _POINTS]
    keyframe, b_p_m, views, std_m = found
    return FloorPoints(keyframe, b_p_m, views, std_m) if len(keyframe) else None


def _number(record: dict[str, Any], name: str) -> float | None:
    value = record.get(name)
    return None if value is None else float(value)


def _antenna_m(record: dict[str, Any]) -> tuple[float, float, float] | None:
    value = record.get("antenna_m")
    return None if value is None else triple(np.array(value, dtype=float))


def _range_errors(record: dict[str, Any]) -> RangeErrors | None:
    value = record.get("range_errors")
    return None if value is None else RangeErrors(**{key: float(value) for key, value in value.items()})


def _shares(record: dict[str, Any]) -> dict[str, dict[str, float]]:
    return {
        str(direction): {str(name): float(share) for name, share in shares.items()}
        for direction, shares in record.get("information_shares", {}).items()
    }


def _ground(record: dict[str, Any]) -> GroundFacts | None:
    value = record.get("ground")
    if value is None:
        return None
    pairs = {name: tuple(map(float, value[name])) for name in ("misregistration_px", "over_floor_px")}
    return GroundFacts(**{**value, **pairs})


def _control(record: dict[str, Any]) -> ControlReport | None:
    value = record.get("control")
    if value is None:
        return None
    points = tuple(PointResidual(**_with_tuples(point)) for point in value["points"])
    return ControlReport(**{**_with_tuples(value), "points": points})


def _with_tuples(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with tuples of numbers for lists of them."""
    return {key: tuple(map(float, x)) if _is_numbers(x) else x for key, x in record.items()}


def _is_numbers(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(x, (int, float)) for x in value)


def _trajectory_names(record: dict[str, Any]) -> tuple[str, str, str]:
    chain, odometry, result = (str(name) for name in record.get("ways", MAP_TRAJECTORIES))
    return chain, odometry, result


def _camera(record: dict[str, Any]) -> Camera:
    tuples = {name: tuple(record[name]) for name in ("focal_px", "center_px", "size_px", "distortion")}
    return Camera(**{**record, **tuples, "b_T_c": np.array(record["b_T_c"], dtype=float).reshape(4, 4)})
