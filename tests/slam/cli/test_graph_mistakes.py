"""What the command tells of mistakes in the rows of a pose graph."""

from __future__ import annotations

from slam.cli.graph import solve_graph
from slam.core.progress import silent
from slam.core.summary import summarise
from tests.backend.pose_graph.checks.test_row_mistakes import graph_of, solved_from_file


def test_the_summary_lists_the_mistakes(tmp_path):
    graph = graph_of(2)
    _, line = solved_from_file(graph, tmp_path, lambda ends, v: (ends[::-1], v))
    estimate, solved = solve_graph(tmp_path / "graph.g2o", silent)
    (record,) = summarise(estimate, graph_alone=True).to_json()["row_mistakes"]
    assert record["line"] == line
    assert record["mistake"] == "vertices exchanged"
    assert len(solved.i) == len(graph.i) - 1
