"""Reading and writing pose graphs in g2o's text format, planar and spatial.

g2o writes the information of a spatial edge with translation before rotation; this project and gtsam put
rotation first. The order is swapped here and nowhere else. Source of the format: g2o's ``types/slam2d`` and
``types/slam3d``; as gtsam does, rotational information is taken per radian of the rotation vector.
"""

from __future__ import annotations

import stat
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TextIO

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.arguments import check_type
from backend.errors import BackendError, format_ranges
from backend.pose_graph.checks.unlike_information import unlike_information
from backend.pose_graph.graph import MAX_INFORMATION, EdgeRows, PoseGraph, repeated_edges, too_certain
from backend.wording import counted

Array = NDArray[np.float64]

_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
_TORO = {"VERTEX2": "VERTEX_SE2", "EDGE2": "EDGE_SE2"}
"""Planar lines of TORO, and those of g2o that say the same."""
_FROM_TORO = (0, 1, 4, 2, 5, 3)
"""Place in TORO's information (xx, xy, yy, hh, xh, yh; h is the heading) of each element of g2o's upper
triangle (xx, xy, xh, yy, yh, hh). Source: the format's definition at OpenSLAM, as gtsam reads it."""
_QUATERNION_RANGE = (1e-6, 1e6)
"""Range of a quaternion's largest component; beyond it is a damaged line, not one without normalisation."""
_UNIT_TOLERANCE = 1e-3
MAX_COORDINATE_M = 1e13
"""Limit of coordinates: beyond it a double does not resolve a millimetre, and squares soon overflow."""


@dataclass(frozen=True)
class _Tag:
    dimension: Literal[2, 3]
    ids: int
    figures: int


_TAGS = {
    "VERTEX_SE2": _Tag(2, 1, 3),
    "EDGE_SE2": _Tag(2, 2, 9),
    "VERTEX_SE3:QUAT": _Tag(3, 1, 7),
    "EDGE_SE3:QUAT": _Tag(3, 2, 28),
}


@dataclass(frozen=True)
class _Block:
    """All lines with one tag."""

    lines: NDArray[np.int64]
    ids: NDArray[np.int64]
    figures: Array


def read_g2o(path: str | Path) -> PoseGraph:
    """Read a planar or spatial pose graph.

    Unknown tags, self edges and a truncated last line are listed in ``warnings`` and ``dropped``.
    Raises ``BackendError`` with file, line and what to do for everything else that is not a pose graph.
    """
    name = str(path)
    text = _text(Path(path))
    warnings: list[str] = []
    dropped: Counter[str] = Counter()
    rows, fixed_rows, others = _rows(text, name, warnings, dropped)
    dimensions = {_TAGS[tag].dimension for tag in rows if rows[tag]}
    if len(dimensions) == 2:
        raise BackendError(f"{name}: holds planar (SE2) and spatial (SE3) lines; split it into two files")
    if not dimensions:
        toro = "VERTEX3" in text or "EDGE3" in text
        raise BackendError(
            f"{name}: no VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT or EDGE_SE3:QUAT line in it"
            + ("; spatial lines of TORO (VERTEX3, EDGE3) are not read: convert them to g2o" if toro else "")
        )
    dimension = dimensions.pop()
    blocks = {tag: _block(rows[tag], tag, name) for tag in rows if _TAGS[tag].dimension == dimension}
    vertex, edge = (blocks[tag] for tag in _TAGS if tag in blocks)
    edge = _without_self_edges(edge, warnings, dropped)
    if len(edge.ids) == 0:
        raise BackendError(f"{name}: has no edge between two vertices; there is nothing to optimize")
    ids, poses = _vertices(vertex, edge, dimension, name, warnings)
    index = np.searchsorted(ids, edge.ids)
    fixed = np.zeros(len(ids), dtype=bool)
    for line, number in fixed_rows:
        if number in others and number not in ids:
            warnings.append(
                f"line {line}: FIX names vertex {number}, which is of a kind that is not used here"
            )
            continue
        if number not in ids:
            raise BackendError(f"{name}:{line}: FIX names vertex {number}, which the file does not hold")
        fixed[np.searchsorted(ids, number)] = True
    information = _information(edge, dimension, name)
    warnings += unlike_information(edge.lines, information)
    if not text.endswith("\n") and not dropped["line without an end"]:
        warnings.append("the last line has no line break: the file may be cut, digits may be missing there")
    graph = PoseGraph(
        dimension=dimension,
        ids=ids,
        poses=poses,
        i=index[:, 0],
        j=index[:, 1],
        ij_T=_transforms(edge, dimension, name, warnings),
        information=information,
        fixed=fixed,
        dropped=dict(dropped),
        rows=EdgeRows(edge.lines, edge.figures[:, 2] if dimension == 2 else np.zeros(len(edge.lines))),
    )
    return replace(graph, warnings=(*warnings, *repeated_edges(graph)))


def _text(path: Path) -> str:
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise BackendError(f"{path}: is not a file; name a .g2o file")
        raw = path.read_bytes()
    except OSError as error:
        raise BackendError(f"{path}: cannot be read ({error.strerror}); name a .g2o file") from error
    if not raw.strip():
        raise BackendError(f"{path}: is empty; name a .g2o file")
    if b"\0" in raw[:4096]:
        raise BackendError(f"{path}: is a binary file; name a .g2o text file")
    return raw.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def _rows(
    text: str, name: str, warnings: list[str], dropped: Counter[str]
) -> tuple[dict[str, list[tuple[int, list[str]]]], list[tuple[int, int]], set[int]]:
    """Return lines by tag as (line number, fields), the vertices that FIX names, and the vertices of kinds
    that are not used, such as landmarks."""
    rows: dict[str, list[tuple[int, list[str]]]] = {tag: [] for tag in _TAGS}
    fixed: list[tuple[int, int]] = []
    others: set[int] = set()
    unknown: Counter[str] = Counter()
    lines = text.split("\n")
    for number, line in enumerate(lines, 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        words = fields[0].count("_")
        if fields[0] in _TORO:
            fields = _of_toro(fields)
        tag = _TAGS.get(fields[0])
        if (tag is not None or fields[0] == "FIX") and line.count("_") > words:
            # Python's numbers may hold one, those of the format may not.
            raise BackendError(f"{name}:{number}: a number of {fields[0]} holds '_'; correct the line")
        if tag is None and fields[0] != "FIX":
            unknown[fields[0][:40]] += 1
            if fields[0].startswith("VERTEX") and len(fields) > 1 and fields[1].isdecimal():
                others.add(int(fields[1]))
        elif tag is None:
            fixed += [(number, _integer(field, name, number)) for field in fields[1:]]
        elif len(fields) == 1 + tag.ids + tag.figures:
            rows[fields[0]].append((number, fields))
        elif number == len(lines) and len(fields) < 1 + tag.ids + tag.figures:
            warnings.append(f"line {number} ends in mid-line: the file is truncated, that line is dropped")
            dropped["line without an end"] += 1
        else:
            raise BackendError(
                f"{name}:{number}: {fields[0]} has {len(fields) - 1} fields instead of"
                f" {tag.ids + tag.figures}; mend or remove the line"
            )
    if unknown:
        dropped["line of another kind"] += unknown.total()
        listed = ", ".join(f"{count} {tag}" for tag, count in unknown.most_common(5))
        warnings.append(
            f"{counted(unknown.total(), 'line')} of kinds that are not used here skipped: {listed}"
        )
    return rows, fixed, others


def _of_toro(fields: list[str]) -> list[str]:
    """Return the fields of a planar TORO line as g2o has them."""
    information = fields[6:]
    if fields[0] == "EDGE2" and len(information) == len(_FROM_TORO):
        information = [information[k] for k in _FROM_TORO]
    return [_TORO[fields[0]], *fields[1:6], *information]


def _integer(field: str, name: str, line: int) -> int:
    try:
        number = int(field)
    except ValueError:
        number = -1
    if not 0 <= number < 2**63:
        raise BackendError(
            f"{name}:{line}: vertex {field[:40]!r} is not a whole number from 0 to 2^63 - 1; mend the line"
        )
    return number


def _block(rows: list[tuple[int, list[str]]], tag: str, name: str) -> _Block:
    """Convert all lines of one tag to arrays; raise ``BackendError`` for the first bad line."""
    shape = _TAGS[tag]
    lines = np.array([number for number, _ in rows], dtype=np.int64)
    ids = np.array(
        [[_integer(f, name, n) for f in fields[1 : 1 + shape.ids]] for n, fields in rows], dtype=np.int64
    )
    try:
        figures = np.array([fields[1 + shape.ids :] for _, fields in rows], dtype=np.float64)
    except ValueError:
        figures = np.array([[_float(f) for f in fields[1 + shape.ids :]] for _, fields in rows])
    figures = figures.reshape(len(rows), shape.figures)
    bad = np.flatnonzero(~np.isfinite(figures).all(axis=1))
    if len(bad):
        raise BackendError(f"{name}:{lines[bad[0]]}: {tag} has a field that is not finite; correct it")
    far = np.flatnonzero((np.abs(figures[:, :3]) > MAX_COORDINATE_M).any(axis=1))
    if len(far):
        raise BackendError(
            f"{name}:{lines[far[0]]}: {tag} has a coordinate beyond {MAX_COORDINATE_M:.0e} m;"
            " correct or remove the line"
        )
    return _Block(lines, ids.reshape(len(rows), shape.ids), figures)


def _float(field: str) -> float:
    try:
        return float(field)
    except ValueError:
        return float("nan")


def _without_self_edges(edge: _Block, warnings: list[str], dropped: Counter[str]) -> _Block:
    ok = edge.ids[:, 0] != edge.ids[:, 1]
    if not ok.all():
        dropped["edge from a vertex to itself"] += int((~ok).sum())
        warnings.append(
            f"{counted(int((~ok).sum()), 'edge')} from a vertex to itself dropped (first: line "
            f"{edge.lines[~ok][0]})"
        )
    return _Block(edge.lines[ok], edge.ids[ok], edge.figures[ok])


def _vertices(
    vertex: _Block, edge: _Block, dimension: int, name: str, warnings: list[str]
) -> tuple[NDArray[np.int64], Array]:
    """Return sorted vertex numbers and their poses; all NaN if the file has edges only."""
    used = np.unique(edge.ids)
    if len(vertex.ids) == 0:
        warnings.append(f"no vertices in the file: the {len(used)} that the edges name start from the edges")
        return used, np.full((len(used), 4, 4), np.nan)
    order = np.argsort(vertex.ids[:, 0], kind="stable")
    ids = vertex.ids[order, 0]
    twice = np.flatnonzero(ids[1:] == ids[:-1])
    if len(twice):
        a, b = vertex.lines[order[twice[0]]], vertex.lines[order[twice[0] + 1]]
        raise BackendError(f"{name}:{b}: vertex {ids[twice[0]]} stands there and on line {a}; remove one")
    missing = np.setdiff1d(used, ids)
    if len(missing):
        line = edge.lines[np.isin(edge.ids, missing).any(axis=1)][0]
        raise BackendError(
            f"{name}:{line}: an edge names a vertex that the file does not hold"
            f" (missing: {format_ranges(missing.tolist())}); add the vertices or remove the edges"
        )
    return ids, _transforms(vertex, dimension, name, warnings)[order]


def _transforms(block: _Block, dimension: int, name: str, warnings: list[str]) -> Array:
    if dimension == 2:
        return se3.from_planar(block.figures[:, :3])
    T = np.tile(np.eye(4), (len(block.figures), 1, 1))
    quaternion = block.figures[:, 3:7]
    largest = np.abs(quaternion).max(axis=1)
    none = np.flatnonzero((largest < _QUATERNION_RANGE[0]) | (largest > _QUATERNION_RANGE[1]))
    if len(none):
        what = "zero" if largest[none[0]] < 1 else f"of length {largest[none[0]]:.3g} or more"
        raise BackendError(f"{name}:{block.lines[none[0]]}: the quaternion is {what}; mend the line")
    length = np.linalg.norm(quaternion, axis=1)
    off = np.abs(length - 1) > _UNIT_TOLERANCE
    if off.any():
        warnings.append(
            f"{counted(int(off.sum()), 'quaternion')} not of length 1 normalised (first: line "
            f"{block.lines[off][0]},"
            f" length {length[off][0]:.4g})"
        )
    if len(T):
        T[:, :3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[:, :3, 3] = block.figures[:, :3]
    return T


def _information(edge: _Block, dimension: int, name: str) -> Array:
    """Return (m, d, d) symmetric matrices from upper triangles, in this project's tangent order."""
    d = 3 if dimension == 2 else 6
    upper = np.triu_indices(d)
    matrix = np.zeros((len(edge.figures), d, d))
    matrix[:, upper[0], upper[1]] = matrix[:, upper[1], upper[0]] = edge.figures[:, -len(upper[0]) :]
    huge = np.flatnonzero(too_certain(matrix))
    if len(huge):
        raise BackendError(
            f"{name}:{edge.lines[huge[0]]}: the information is beyond {MAX_INFORMATION:.0e} ({len(huge)} such"
            " edges), a deviation that no double resolves; state less"
        )
    lowest = np.linalg.eigvalsh(matrix)
    bad = np.flatnonzero((lowest[:, 0] < -1e-9 * lowest[:, -1]) | (lowest[:, -1] <= 0))
    if len(bad):
        raise BackendError(
            f"{name}:{edge.lines[bad[0]]}: the information matrix is not positive"
            f" (smallest eigenvalue {lowest[bad[0], 0]:.3g}; {len(bad)} such edges); mend or remove the line"
        )
    return matrix if d == 3 else matrix[:, _ROTATION_FIRST[:, None], _ROTATION_FIRST]


def write_g2o(stream: TextIO, graph: PoseGraph) -> None:
    """Write vertices that have a pose, fixed vertices and edges, with full precision.

    Raises ``TypeError`` for another object.
    """
    check_type(graph, PoseGraph, "graph")
    vertex, edge = [tag for tag, shape in _TAGS.items() if shape.dimension == graph.dimension]
    information = graph.information
    if graph.dimension == 3:
        inverse = np.argsort(_ROTATION_FIRST)
        information = information[:, inverse[:, None], inverse]
    upper = np.triu_indices(information.shape[-1])
    placed = np.flatnonzero(graph.has_pose)
    out = _format(vertex, graph.ids[placed, None], _figures(graph.poses[placed], graph.dimension))
    out += [f"FIX {number}" for number in graph.ids[graph.fixed]]
    pairs = np.column_stack([graph.ids[graph.i], graph.ids[graph.j]])
    figures = np.hstack([_figures(graph.ij_T, graph.dimension), information[:, upper[0], upper[1]]])
    out += _format(edge, pairs, figures)
    stream.write("\n".join(out) + "\n")


def _figures(T: Array, dimension: int) -> Array:
    if dimension == 2:
        return se3.to_planar(T)
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat() if len(T) else np.zeros((0, 4))
    return np.hstack([T[:, :3, 3], quaternion])


def _format(tag: str, ids: NDArray[np.int64], figures: Array) -> list[str]:
    pattern = tag + " %d" * ids.shape[1] + " %.17g" * figures.shape[1]
    return [pattern % (*a, *b) for a, b in zip(ids.tolist(), figures.tolist(), strict=True)]
