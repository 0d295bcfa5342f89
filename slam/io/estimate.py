"""Files of an estimate: trajectory.tum, estimate.npz and loops.csv.

``estimate.npz`` contains the complete estimate; the other two files are for other tools and readers. Its
arrays for n keyframes, m edges, l loops and t points of the ground are:

| name | shape, type | what |
|---|---|---|
| stamps | (n,) int64 | nanoseconds on the recorder's clock |
| w_T_b, chain_w_T_b, odometry_w_T_b | (n, 4, 4) | NaN where not placed |
| covariances, over_floor_covariances | (n, 6, 6) | rotation first, right perturbation; NaN where unknown |
| ground_covariances | (n, 6, 6) | of the ground in a picture; none where the lens was fixed |
| joint_errors | (n, 6, s) | right perturbation by each error that poses share; none without a refinement |
| row_motion | (n, 3) | motion in body axes from the first row to the last; none for a global shutter |
| row_turn | (n, 3) | turn meanwhile, as a rotation vector in body axes |
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
import tokenize
import zipfile
import zlib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Rejection, RelativePose
from backend.pose_graph.solution import RangeErrors
from backend.triple import triple
from frontend.camera import Camera
from frontend.obstacles import Obstacle, ObstacleList
from slam.core.arguments import check_estimate
from slam.core.control_points import ControlReport, PointResidual
from slam.core.errors import InputError
from slam.core.estimate import MAP_TRAJECTORIES, Estimate, GroundFacts, LoopVerdict
from slam.core.floor_points import FloorPoints
from slam.core.geodesy import GeoOrigin
from slam.core.messages import Kind, Message, clauses_of, joined, parsed, recorded
from slam.io.atomic import write_whole
from slam.io.estimate_arrays import LATER, NO_POINTS, POINTS, unpacked
from slam.io.estimate_text import loops_text, trajectory_text
from slam.io.files import brief

Array = NDArray[np.float64]


def write_estimate(estimate: Estimate, out_dir: str | Path, loops: bool = True) -> tuple[Path, ...]:
    """Write the three files into a folder (two without a search for loops) and return their paths.

    Raises ``InputError`` if the folder cannot be written, and ``TypeError`` for another object.
    """
    check_estimate(estimate)
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
    edges, loops, points = estimate.relative_poses, estimate.loops, estimate.floor_points or NO_POINTS
    ground, shared, rows = estimate.ground_covariances, estimate.joint_errors, estimate.row_motion_m
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        stamps=estimate.stamps_ns,
        w_T_b=estimate.w_T_b,
        covariances=estimate.covariances,
        over_floor_covariances=estimate.over_floor_covariances,
        ground_covariances=LATER["ground_covariances"] if ground is None else ground,
        joint_errors=LATER["joint_errors"] if shared is None else shared.astype(np.float32),
        row_motion=LATER["row_motion"] if rows is None else rows,
        row_turn=LATER["row_turn"] if estimate.row_turn_rad is None else estimate.row_turn_rad,
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
        "length_stds": [[float(each) for each in row] for row in estimate.length_stds],
        "metric": bool(estimate.metric),
        "range_errors": None if estimate.range_errors is None else asdict(estimate.range_errors),
        "antenna_m": None if estimate.antenna_m is None else list(estimate.antenna_m),
        "origin": None if estimate.origin is None else asdict(estimate.origin),
        "frames": int(estimate.frames),
        "rejected": estimate.rejected,
        "not_placed": estimate.not_placed,
        "not_drawn": estimate.not_drawn,
        "partly_drawn": estimate.partly_drawn,
        "timing_s": estimate.timing_s,
        "warnings": list(estimate.warnings),
        "messages": [{**asdict(message), "text": message.text} for message in estimate.messages],
        "graph_error": float(estimate.graph_error),
        "iterations": int(estimate.iterations),
        "ways": list(estimate.trajectory_names),
        "accuracy_basis": estimate.accuracy_basis,
        "information_shares": {name: dict(shares) for name, shares in estimate.information_shares.items()},
        "control": None if estimate.control is None else asdict(estimate.control),
        "ground": None if estimate.ground is None else asdict(estimate.ground),
        "obstacles": None if estimate.obstacles is None else asdict(estimate.obstacles),
    }


def read_estimate(out_dir: str | Path) -> Estimate:
    """Rebuild an estimate from a folder written by ``write_estimate``. Only estimate.npz is read.

    Raises ``InputError`` if the file is missing, damaged, of another shape, or expands out of proportion.
    """
    path = Path(out_dir) / "estimate.npz"
    if not path.is_file():
        raise InputError(f"{path}: does not exist; name the folder that `slam optimize --out` wrote")
    try:
        arrays = unpacked(path)
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
        epoch_ns=epoch_ns,
        stamps_s=(arrays["stamps"] - epoch_ns) / 1e9,
        frame_names=tuple(arrays["frame_names"].tolist()),
        frame_index=arrays["frame_index"],
        w_T_b=arrays["w_T_b"],
        covariances=arrays["covariances"],
        over_floor_covariances=arrays["over_floor_covariances"],
        ground_covariances=arrays["ground_covariances"] if len(arrays["ground_covariances"]) else None,
        joint_errors=arrays["joint_errors"].astype(float) if len(arrays["joint_errors"]) else None,
        row_motion_m=arrays["row_motion"] if len(arrays["row_motion"]) else None,
        row_turn_rad=arrays["row_turn"] if len(arrays["row_turn"]) else None,
        component=arrays["component"],
        camera=None if camera is None else _camera(camera),
        floor_z_m=float(record["floor_z_m"]),
        floor_slope_rad=(float(record["floor_slope_rad"][0]), float(record["floor_slope_rad"][1])),
        scale_std=_number(record, "scale_std"),
        middle_std_m=_number(record, "middle_std_m"),
        length_stds=tuple(triple(np.array(row, dtype=float)) for row in record.get("length_stds", ())),
        metric=bool(record.get("metric", True)),
        range_errors=_range_errors(record),
        antenna_m=_antenna_m(record),
        origin=None if origin is None else GeoOrigin(**origin),
        relative_poses=tuple(RelativePose(i, j, T, P, kind) for (i, j), T, P, kind in edges),
        loops=tuple(
            LoopVerdict(i, j, None if verdict == "kept" else Rejection.read(reason))
            for (i, j), verdict, reason in loops
        ),
        chain_w_T_b=arrays["chain_w_T_b"],
        odometry_w_T_b=arrays["odometry_w_T_b"],
        frames=int(record["frames"]),
        rejected=dict(record["rejected"]),
        not_placed=dict(record.get("not_placed", {})),
        not_drawn=dict(record.get("not_drawn", {})),
        partly_drawn=dict(record.get("partly_drawn", {})),
        timing_s=dict(record["timing_s"]),
        messages=_messages(record),
        graph_error=float(record["graph_error"]),
        iterations=int(record["iterations"]),
        trajectory_names=_trajectory_names(record),
        accuracy_basis=str(record.get("accuracy_basis", "")),
        information_shares=_shares(record),
        ground=_ground(record),
        obstacles=_obstacles(record),
        control=_control(record),
        floor_points=_points(arrays),
    )


def _message(record: dict[str, Any]) -> Message:
    # Earlier versions wrote the text alone.
    clauses = tuple(map(str, record["clauses"])) if "clauses" in record else clauses_of(str(record["text"]))
    return Message(clauses, Kind(record["kind"]), str(record["about"]))


def _messages(record: dict[str, Any]) -> tuple[Message, ...]:
    if "messages" in record:
        return tuple(map(_message, record["messages"]))
    # Earlier versions wrote the status and the texts.
    status = None if record["status"] == "ok" else parsed(str(record["status"])).as_reason()
    return joined(status, *(recorded(str(text), record.get("notes", ())) for text in record["warnings"]))


def _points(arrays: dict[str, NDArray[Any]]) -> FloorPoints | None:
    found = [arrays[name] for name in POINTS]
    keyframe, b_p_m, views, std_m = found
    return FloorPoints(keyframe, b_p_m, views, std_m) if len(keyframe) else None


def _obstacles(record: dict[str, Any]) -> ObstacleList | None:
    value = record.get("obstacles")
    if value is None:
        return None
    found = (
        Obstacle(**{**one, "measured_by": tuple(map(str, one["measured_by"]))}) for one in value["found"]
    )
    return ObstacleList(float(value["above_m"]), tuple(found))


def _number(record: dict[str, Any], name: str) -> float | None:
    value = record.get(name)
    return None if value is None else float(value)


def _antenna_m(record: dict[str, Any]) -> tuple[float, float, float] | None:
    value = record.get("antenna_m")
    return None if value is None else triple(np.array(value, dtype=float))


def _range_errors(record: dict[str, Any]) -> RangeErrors | None:
    value = record.get("range_errors")
    return None if value is None else RangeErrors(**value)


def _shares(record: dict[str, Any]) -> dict[str, dict[str, float]]:
    return {
        str(direction): {str(name): float(share) for name, share in shares.items()}
        for direction, shares in record.get("information_shares", {}).items()
    }


def _ground(record: dict[str, Any]) -> GroundFacts | None:
    value = record.get("ground")
    if value is None:
        return None
    lists = {name: tuple(found) for name, found in value.items() if isinstance(found, list)}
    return GroundFacts(**{**value, **lists})


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
    # A map of another version may have further fields.
    known = {field.name: record[field.name] for field in fields(Camera) if field.name in record}
    return Camera(**{**known, **tuples, "b_T_c": np.array(record["b_T_c"], dtype=float).reshape(4, 4)})
