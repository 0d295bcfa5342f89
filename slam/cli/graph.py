"""Solves a pose graph from a file with the back end alone."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from backend.measurements import RelativePose
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.messages import Message, joined, parsed, warning
from slam.core.progress import Progress

if TYPE_CHECKING:
    from backend.pose_graph.graph import PoseGraph
    from backend.pose_graph.solution import Solution
    from slam.core.figure_table import FigureTable

_MAX_STAMP_S = 9_000_000_000
"""Largest number that is a stamp in seconds: its nanoseconds fit 64 bits."""

_LINEAR_RAD = 0.5
"""Deviation of an attitude up to which covariances hold to a few percent: sin x is 4 % off x there."""


def solve_graph(path: Path, progress: Progress) -> tuple[Estimate, PoseGraph]:
    """Read and solve a g2o graph; return the estimate and the solved graph with its kept edges.

    The stamps are the numbers of the vertices, or 0, 1, 2 and so on where these are too large for a stamp.
    Raises ``BackendError``.
    """
    from threadpoolctl import threadpool_limits

    from backend.g2o import read_g2o
    from backend.pose_graph.certificate import certify
    from backend.pose_graph.lower_minimum import lower_minimum
    from backend.pose_graph.solve import solve_pose_graph

    start = time.perf_counter()
    graph = read_g2o(path)
    read_s = time.perf_counter() - start
    # The blocks of a pose graph are too small for the threads of BLAS, which would wait for each other.
    with threadpool_limits(1, "blas"):
        solution = solve_pose_graph(graph, on_step=lambda done, error: progress("solve", done, 0))
        solved_s = time.perf_counter() - start
        progress("certify", 0, 0)
        certificate = certify(graph, solution)
        # A gap is known where the graph is small enough for it, and so for more descents.
        doubted = not certificate.certified and np.isfinite(certificate.gap)
        lower = lower_minimum(graph, solution) if doubted else None
        if lower is not None:
            graph = replace(graph, poses=lower)
            solution = solve_pose_graph(graph, on_step=lambda done, error: progress("solve", done, 0))
            certificate = certify(graph, solution)
    certify_s = time.perf_counter() - start - solved_s
    timing_s = {"read": read_s, "solve": solved_s - read_s, "certify": certify_s}
    kept = solution.edge_kept
    solved = replace(
        graph,
        poses=solution.w_T_b,
        i=graph.i[kept],
        j=graph.j[kept],
        ij_T=graph.ij_T[kept],
        information=graph.information[kept],
        rows=None,
    )
    estimate = _estimate(path.stem, graph, solution, timing_s)
    if not certificate.certified:
        doubt = _other_arrangement(solution) if np.isfinite(certificate.gap) else None
        said = (doubt and doubt.as_reason(), parsed(certificate.sentence(solution.error)))
        estimate = replace(estimate, messages=joined(*estimate.messages, *said))
    return replace(estimate, certificate=certificate), solved


def _other_arrangement(solution: Solution) -> Message | None:
    """Return a sentence if attitudes are so uncertain that the graph may have another minimum; else None."""
    if solution.covariances is None:
        return None
    known = solution.covariances[np.isfinite(solution.covariances).all(axis=(1, 2))]
    turn = float(np.sqrt(np.linalg.eigvalsh(known[:, :3, :3]).max(initial=0.0)))
    if turn < _LINEAR_RAD:
        return None
    return warning(
        f"attitudes are uncertain by up to {np.degrees(turn):.0f} deg, and nothing certifies that no other"
        " arrangement of the poses fits better: standard deviations hold to first order only, poses may be"
        " further off",
        "add edges, or ones of smaller deviations",
    )


def graph_record(path: Path) -> dict[str, Any]:
    """Return the figures of a g2o file for ``slam info``."""
    from backend.g2o import read_g2o
    from backend.pose_graph.graph import rank_deficient_warning

    graph = read_g2o(path)
    loops = int(np.count_nonzero(~graph.is_odometry))
    return {
        "name": str(path),
        "dimension": graph.dimension,
        "vertices": len(graph.ids),
        "vertices_with_pose": int(graph.has_pose.sum()),
        "vertices_fixed": int(graph.fixed.sum()),
        "edges_between_neighbours": len(graph.i) - loops,
        "other_edges": loops,
        "warnings": [*graph.warnings, *rank_deficient_warning(graph)],
    }


def graph_table(record: Mapping[str, Any]) -> FigureTable:
    """Return the table of ``graph_record`` for the terminal."""
    from slam.core.figure_table import FigureTable

    rows = [
        ("pose graph", f"{record['dimension']}-D"),
        ("vertices", str(record["vertices"])),
        ("vertices with a given pose", str(record["vertices_with_pose"])),
        ("vertices held in place", str(record["vertices_fixed"])),
        ("edges between neighbours", str(record["edges_between_neighbours"])),
        ("other edges", str(record["other_edges"])),
        *(("warning", warning) for warning in record["warnings"]),
    ]
    return FigureTable(record["name"], (), tuple(rows))


def _estimate(name: str, graph: PoseGraph, solution: Solution, timing_s: dict[str, float]) -> Estimate:
    count = len(graph.ids)
    unknown = np.full((count, 6, 6), np.nan)
    is_loop = ~graph.is_odometry
    covariance = _covariances(graph)
    edges = zip(graph.i.tolist(), graph.j.tolist(), graph.ij_T, covariance, is_loop.tolist(), strict=True)
    verdicts = zip(graph.i.tolist(), graph.j.tolist(), solution.edge_reason, is_loop.tolist(), strict=True)
    empty = int((~solution.edge_informative).sum())
    rejected = {
        "edge without information": empty,
        "edge disagrees with the rest of the graph": int((~solution.edge_kept).sum()) - empty,
    }
    stamps_s, stamp_warning = _stamps(graph)
    return Estimate(
        name=name,
        epoch_ns=0,
        stamps_s=stamps_s,
        frame_names=tuple(str(number) for number in graph.ids.tolist()),
        frame_index=np.arange(count),
        w_T_b=solution.w_T_b,
        covariances=unknown if solution.covariances is None else solution.covariances,
        over_floor_covariances=unknown,
        component=solution.component,
        camera=None,
        floor_z_m=0.0,
        origin=None,
        relative_poses=tuple(
            RelativePose(i, j, T, P, "loop" if loop else "odometry")
            for (i, j, T, P, loop), kept in zip(edges, solution.edge_kept.tolist(), strict=True)
            if kept
        ),
        loops=tuple(
            LoopVerdict(min(i, j), max(i, j), reason) for i, j, reason, loop in verdicts if loop or reason
        ),
        chain_w_T_b=graph.poses,
        odometry_w_T_b=np.full((count, 4, 4), np.nan),
        frames=count,
        rejected=graph.dropped | {why: count for why, count in rejected.items() if count},
        timing_s=timing_s,
        messages=joined(
            *(parsed(text).as_reason() for text in solution.reasons),
            *map(parsed, graph.warnings),
            *stamp_warning,
            *map(parsed, (*solution.warnings, *solution.unobserved)),
        ),
        graph_error=solution.error,
        row_mistakes=solution.row_mistakes,
        iterations=solution.iterations,
    )


def _stamps(graph: PoseGraph) -> tuple[np.ndarray, list[Message]]:
    """Return a stamp for each vertex, and a warning if it is not the vertex's number."""
    largest = int(graph.ids.max(initial=0))
    if largest <= _MAX_STAMP_S:
        return graph.ids.astype(np.float64), []
    said = warning(
        f"vertex numbers up to {largest} are too large for stamps: the stamps count the vertices from 0 on, "
        "in order of their numbers"
    )
    return np.arange(len(graph.ids), dtype=np.float64), [said]


def _covariances(graph: PoseGraph) -> np.ndarray:
    """Return (m, 6, 6) covariances of the edges; NaN for edges that do not measure every direction.

    No planar edge does.
    """
    covariance = np.full((len(graph.i), 6, 6), np.nan)
    if graph.dimension == 3:
        covariance[~graph.is_rank_deficient] = np.linalg.inv(graph.information[~graph.is_rank_deficient])
    return covariance
